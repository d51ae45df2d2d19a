import {
  ACESFilmicToneMapping,
  PCFShadowMap,
  PMREMGenerator,
  PerspectiveCamera,
  Scene,
  Vector3,
  WebGLRenderer,
  type Object3D,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

/** Position of the spectator's camera in the world frame; the person sits at its origin and faces −y. */
const EYE_W = new Vector3(0.93, -1.57, 1.4);
/** Field of view of the first-person view across the shorter side of the page. */
const EYES_ANGLE = 75;
/** Vertical and minimum horizontal field of view of the part that the card leaves free, degrees. */
const SCENE_ANGLE = 45;
const SCENE_WIDTH_ANGLE = 70;
const REFLECTION = 0.5;
/** Maximum difference of two cameras that count as equal. */
const ALIKE_M = 1e-6;
const CENTRE = new Vector3(0, 1, 0);
const CHEST_W = new Vector3(0, 0.05, 0.88);

/** Rendering quality. */
export interface Detail {
  antialias: boolean;
  /** Whether the sun casts shadows and surfaces reflect the room. */
  lighting: boolean;
  anisotropy: number;
}

export const FULL_DETAIL: Detail = { antialias: true, lighting: true, anisotropy: 8 };
/** For emulated headsets, which render on the processor. */
export const LIGHT_DETAIL: Detail = { antialias: false, lighting: false, anisotropy: 1 };

/** WebGL is not available. */
export class CannotDrawError extends Error {}

function rendererOf(antialias: boolean): WebGLRenderer {
  try {
    return new WebGLRenderer({ antialias });
  } catch (cause) {
    throw new CannotDrawError("this browser cannot draw in 3D: turn on its graphics acceleration, or use another browser", {
      cause,
    });
  }
}

/** The renderer, and the page's third-person view. */
export class View {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  /** The camera in VR; the spectator's camera is separate. */
  private readonly eyes = new PerspectiveCamera(70, 1, 0.03, 30);
  private readonly spectator = new PerspectiveCamera(45, 1, 0.05, 30);
  private readonly controls: OrbitControls;
  private borrowed: PerspectiveCamera | null = null;
  private borrowedAngle = EYES_ANGLE;
  private pictures = 0;

  constructor(
    private readonly holder: HTMLElement,
    private readonly card: HTMLElement,
    { antialias, lighting }: Detail,
  ) {
    const renderer = rendererOf(antialias);
    this.renderer = renderer;
    renderer.toneMapping = ACESFilmicToneMapping;
    renderer.shadowMap.enabled = lighting;
    renderer.shadowMap.type = PCFShadowMap;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.xr.enabled = true;
    renderer.xr.setReferenceSpaceType("local-floor");
    holder.append(renderer.domElement);
    this.controls = new OrbitControls(this.spectator, renderer.domElement);
    this.controls.listenToKeyEvents(window);
    Object.assign(this.controls, { minDistance: 0.4, maxDistance: 2.9, maxPolarAngle: 1.7 });
    const sizes = new ResizeObserver(() => this.fit());
    for (const sized of [holder, card]) sizes.observe(sized);
  }

  /** Fits the canvas to its container, with the scene's centre in the part that the card leaves free. */
  fit(): void {
    if (this.renderer.xr.isPresenting) return;
    const area = this.holder.getBoundingClientRect();
    const { width, height } = area;
    this.renderer.setSize(width, height);
    this.controls.enabled = !this.borrowed;
    const free = freeOf(area, this.card.getBoundingClientRect());
    const [x, y] = offset(area, free);
    this.spectator.fov = Math.max(
      timesAsHigh(height / (free.bottom - free.top), SCENE_ANGLE),
      timesAsHigh(height / (free.right - free.left), SCENE_WIDTH_ANGLE),
    );
    if (this.borrowed) this.borrowed.fov = timesAsHigh(Math.max(height / width, 1), this.borrowedAngle);
    for (const camera of [this.spectator, this.borrowed]) {
      if (!camera) continue;
      camera.aspect = width / height;
      camera.setViewOffset(width, height, x, y, width, height);
    }
  }

  /** Links the cameras of two views. */
  linkCamera(other: View): void {
    this.controls.stopListenToKeyEvents();
    this.controls.addEventListener("change", () => other.copyCamera(this));
    other.controls.addEventListener("change", () => this.copyCamera(other));
  }

  private copyCamera({ spectator, controls }: View): void {
    const away =
      this.spectator.position.distanceTo(spectator.position) + this.controls.target.distanceTo(controls.target);
    if (away < ALIKE_M) return;
    this.spectator.position.copy(spectator.position);
    this.controls.target.copy(controls.target);
    this.controls.update();
  }

  /** Shows the view of this camera, or the spectator's (null). `angle`: field of view across the shorter side, degrees. */
  useCamera(camera: PerspectiveCamera | null, angle = EYES_ANGLE): void {
    this.borrowed = camera;
    this.borrowedAngle = angle;
    this.fit();
  }

  /** Moves the spectator to the front left of the person. */
  placeSpectator(root: Object3D): void {
    this.spectator.position.copy(root.localToWorld(EYE_W.clone()));
    this.controls.target.copy(root.localToWorld(CHEST_W.clone()));
    this.controls.update();
  }

  /** Sets the environment map to the room as seen from the person's seat. */
  reflect(world: Object3D): void {
    const generator = new PMREMGenerator(this.renderer);
    const target = generator.fromScene(new Scene().add(world), 0.02, 0.1, 10, {
      size: 128,
      position: CENTRE,
    });
    this.scene.environment = target.texture;
    this.scene.environmentIntensity = REFLECTION;
    generator.dispose();
  }

  /** The camera of the page. */
  get camera(): PerspectiveCamera {
    return this.borrowed ?? this.spectator;
  }

  /** Renders a frame. In VR, shadows are updated only in every second frame, to save time. */
  render(): void {
    const { xr, shadowMap } = this.renderer;
    this.pictures++;
    shadowMap.autoUpdate = !xr.isPresenting;
    shadowMap.needsUpdate ||= this.pictures % 2 === 0;
    this.renderer.render(this.scene, xr.isPresenting ? this.eyes : this.camera);
  }
}

/** The field of view, degrees, for a picture that is so many times higher. */
function timesAsHigh(times: number, angle: number): number {
  return (Math.atan(Math.tan((angle * Math.PI) / 360) * times) * 360) / Math.PI;
}

export type Rectangle = Pick<DOMRect, "left" | "right" | "top" | "bottom">;

/** The largest part of an area beside, above or below a card. */
export function freeOf(area: Rectangle, card: Rectangle): Rectangle {
  const { left, top, right, bottom } = area;
  if (card.right <= left || card.left >= right || card.bottom <= top || card.top >= bottom) return { left, top, right, bottom };
  const parts = [
    { left: card.right, top, right, bottom },
    { left, top, right: card.left, bottom },
    { left, top: card.bottom, right, bottom },
    { left, top, right, bottom: card.top },
  ];
  return parts.reduce((largest, part) => (sizeOf(part) > sizeOf(largest) ? part : largest));
}

function sizeOf({ left, top, right, bottom }: Rectangle): number {
  return Math.max(right - left, 0) * Math.max(bottom - top, 0);
}

/** The offset of the view, px, that centres it in the free part of an area. */
export function offset(area: Rectangle, free: Rectangle): [x: number, y: number] {
  const x = (area.left + area.right - free.left - free.right) / 2;
  const y = (area.top + area.bottom - free.top - free.bottom) / 2;
  return [x, y];
}
