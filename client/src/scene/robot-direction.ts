import { ConeGeometry, Matrix4, Mesh, MeshBasicMaterial, type Object3D, type PerspectiveCamera, Quaternion, Vector3 } from "three";
import { element } from "../page/dom";
import type { XRPose } from "../generated/messages";
import { OVERLAY_ORDER } from "../panel/canvas-plane";
import { freeOf, type Rectangle } from "./view";

/** Distance of the arrow from the edge, px. */
const MARGIN = 56;
/** Maximum angle from the viewing direction at which the robot is in view in VR. */
const IN_VIEW_RAD = (40 * Math.PI) / 180;
const AHEAD_M = 0.7;
const ASIDE_M = 0.24;
const UP = new Vector3(0, 1, 0);

/** An arrow on the screen: position in px, and direction in radians clockwise from the right. */
export interface Arrow {
  x: number;
  y: number;
  turn: number;
}

/** The arrow at the edge of the `clear` area to a place out of view or behind the card; null if it is visible. */
export function arrowTo(
  place: Vector3,
  camera: PerspectiveCamera,
  area: Rectangle,
  card: Rectangle,
  clear: Rectangle,
): Arrow | null {
  const seen = place.clone().applyMatrix4(camera.matrixWorldInverse);
  const ahead = seen.z < 0;
  const onScreen = seen.clone().applyMatrix4(camera.projectionMatrix);
  const at = {
    x: area.left + ((onScreen.x + 1) / 2) * (area.right - area.left),
    y: area.top + ((1 - onScreen.y) / 2) * (area.bottom - area.top),
  };
  if (ahead && isIn(at, area) && !isIn(at, card)) return null;
  const middle = { x: (clear.left + clear.right) / 2, y: (clear.top + clear.bottom) / 2 };
  const away = ahead ? { x: at.x - middle.x, y: at.y - middle.y } : { x: seen.x || 1, y: -seen.y };
  const across = Math.max((clear.right - clear.left) / 2 - MARGIN, 1);
  const down = Math.max((clear.bottom - clear.top) / 2 - MARGIN, 1);
  const share = 1 / Math.max(Math.abs(away.x) / across, Math.abs(away.y) / down);
  return { x: middle.x + away.x * share, y: middle.y + away.y * share, turn: Math.atan2(away.y, away.x) };
}

function isIn({ x, y }: { x: number; y: number }, { left, top, right, bottom }: Rectangle): boolean {
  return x >= left && x <= right && y >= top && y <= bottom;
}

/** An area without the strip above or below that a control occupies. */
export function without(part: Rectangle, control: Rectangle): Rectangle {
  const isThere = control.bottom > control.top && control.left < part.right && control.right > part.left;
  if (!isThere || control.bottom <= part.top || control.top >= part.bottom) return part;
  const isAbove = control.top - part.top < part.bottom - control.bottom;
  return isAbove ? { ...part, top: control.bottom } : { ...part, bottom: control.top };
}

/** An arrow with the robot's name at the edge of the page's view, while the robot is out of view. */
export class RobotArrow {
  private readonly mark = element("whereabouts");
  private readonly controls = [element("emergency"), element("hand")];

  constructor(
    private readonly view: HTMLElement,
    private readonly card: HTMLElement,
  ) {}

  update(camera: PerspectiveCamera, place: Vector3 | null): void {
    const arrow = place && this.arrow(camera, place);
    if (this.mark.hidden !== !arrow) this.mark.hidden = !arrow;
    if (!arrow) return;
    this.mark.style.setProperty("--x", `${arrow.x.toFixed(0)}px`);
    this.mark.style.setProperty("--y", `${arrow.y.toFixed(0)}px`);
    this.mark.style.setProperty("--turn", `${arrow.turn.toFixed(2)}rad`);
  }

  private arrow(camera: PerspectiveCamera, place: Vector3): Arrow | null {
    camera.updateMatrixWorld();
    const [area, card] = [this.view, this.card].map((each) => each.getBoundingClientRect());
    const controls = this.controls.map((each) => each.getBoundingClientRect());
    return arrowTo(place, camera, area!, card!, controls.reduce(without, freeOf(area!, card!)));
  }
}

/** The pose of a pointer towards a place; null if the place is in view. */
export function pointerTo(place: Vector3, [position, orientation]: XRPose): { position: Vector3; turn: Quaternion } | null {
  const head = new Matrix4().compose(
    new Vector3(...position),
    new Quaternion(...orientation),
    new Vector3(1, 1, 1),
  );
  const seen = place.clone().applyMatrix4(head.clone().invert());
  if (seen.angleTo(new Vector3(0, 0, -1)) < IN_VIEW_RAD) return null;
  const aside = new Vector3(seen.x, seen.y, 0);
  if (aside.length() < 1e-6) aside.set(1, 0, 0);
  aside.normalize();
  const turn = new Quaternion(...orientation).multiply(new Quaternion().setFromUnitVectors(UP, aside));
  return { position: aside.multiplyScalar(ASIDE_M).setZ(-AHEAD_M).applyMatrix4(head), turn };
}

/** A pointer in VR towards the robot while it is out of view, with a size of 6°. */
export class RobotPointer {
  readonly mesh = new Mesh(
    new ConeGeometry(0.02, 0.07, 16),
    new MeshBasicMaterial({ color: 0xff6d00, depthTest: false, transparent: true, toneMapped: false }),
  );

  /** Adds the pointer to a scene. */
  constructor(scene: Object3D) {
    this.mesh.renderOrder = OVERLAY_ORDER + 1;
    this.mesh.visible = false;
    scene.add(this.mesh);
  }

  update(head: XRPose | null, place: Vector3 | null): void {
    const pointer = head && place ? pointerTo(place, head) : null;
    this.mesh.visible = pointer !== null;
    if (!pointer) return;
    this.mesh.position.copy(pointer.position);
    this.mesh.quaternion.copy(pointer.turn);
  }
}
