import { CylinderGeometry, Group, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { OVERLAY_ORDER } from "../panel/canvas-plane";
import type { Panel, PanelHit } from "../panel/panel";
import { Arrival } from "./arrival";

/** The pointer rays of all input sources. */
export class Pointers {
  readonly group = new Group();
  private readonly pointers = new Map<XRInputSource, Pointer>();
  private readonly spare: Pointer[] = [];
  private latest: Pointer | null = null;
  private readonly head = new Pointer();

  /** Updates all rays of the usable sources; returns the button that a ray reached last, or null. */
  point(frame: XRFrame, space: XRReferenceSpace, panel: Panel, usable: (source: XRInputSource) => boolean): number | null {
    const sources = Array.from(frame.session.inputSources).filter(usable);
    for (const source of this.pointers.keys()) if (!sources.includes(source)) this.release(source);
    for (const source of sources) if (pointsAlways(source)) this.aim(source, frame, space, panel);
    if (this.latest && this.latest.value !== null) return this.latest.value;
    return [...this.pointers.values()].find(({ value }) => value !== null)?.value ?? null;
  }

  /** The button at which a source points when it selects, or null. `rests`: the ray has not moved onto that button. */
  pointedAt(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace, panel: Panel): { value: number | null; rests: boolean } {
    const onto = this.aim(source, frame, space, panel);
    const { below } = this.of(source);
    if (pointsAlways(source)) return { value: below, rests: onto === null && below !== null };
    this.of(source).value = null;
    return { value: below, rests: false };
  }

  hide(): void {
    for (const source of [...this.pointers.keys()]) this.release(source);
    this.head.hide();
  }

  /** Updates the dot of the head's ray; returns the button at which the head points, or null. */
  look(viewer: XRViewerPose | undefined, panel: Panel): number | null {
    for (const source of [...this.pointers.keys()]) this.release(source);
    this.group.add(this.head.group);
    if (viewer) this.head.aim(viewer.transform, panel, false);
    else this.head.hide();
    return this.head.below;
  }

  private aim(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace, panel: Panel): number | null {
    const pointer = this.of(source);
    const before = pointer.value;
    const pose = frame.getPose(source.targetRaySpace, space);
    if (pose) pointer.aim(pose.transform, panel, beginsAtHand(source));
    else pointer.hide();
    if (pointer.value !== null && pointer.value !== before) this.latest = pointer;
    return pointer.value;
  }

  private of(source: XRInputSource): Pointer {
    const had = this.pointers.get(source);
    if (had) return had;
    const pointer = this.spare.pop() ?? new Pointer();
    this.group.add(pointer.group);
    this.pointers.set(source, pointer);
    return pointer;
  }

  private release(source: XRInputSource): void {
    const pointer = this.pointers.get(source)!;
    this.pointers.delete(source);
    pointer.hide();
    this.spare.push(pointer);
  }
}

/** Whether a source points continuously. Transient pointers and touches point only when they begin. */
function pointsAlways({ targetRayMode }: XRInputSource): boolean {
  return targetRayMode !== "transient-pointer" && targetRayMode !== "screen";
}

/** Whether the ray begins at the hand. Of other rays, which begin at the eyes, only the end is drawn. */
function beginsAtHand({ targetRayMode }: XRInputSource): boolean {
  return targetRayMode === "tracked-pointer";
}

const FREE_LENGTH_M = 1.2;

/** The ray of one input source, with a dot on the panel. */
class Pointer {
  readonly group = new Group();
  /** The button that the ray has moved onto, or null. */
  value: number | null = null;
  /** The button on the ray, or null. */
  below: number | null = null;
  private readonly arrival = new Arrival(true);
  private readonly ray: Mesh;
  private readonly dot: Mesh;
  private readonly direction = new Vector3();
  private readonly hit: PanelHit = { distance: 0, value: null, x: 0, y: 0 };

  constructor() {
    const geometry = new CylinderGeometry(0.0012, 0.0022, 1, 8).rotateX(-Math.PI / 2).translate(0, 0, -0.5);
    this.ray = new Mesh(geometry, overlayMaterial(0.65));
    this.dot = new Mesh(new SphereGeometry(0.006, 16, 12), overlayMaterial(1));
    this.ray.renderOrder = this.dot.renderOrder = OVERLAY_ORDER + 1;
    this.group.add(this.ray, this.dot);
    this.hide();
  }

  hide(): void {
    this.group.visible = false;
    this.value = this.below = null;
  }

  /** Updates the ray from a target ray pose; draws the whole ray or only its end. */
  aim(pose: XRRigidTransform, panel: Panel, drawsRay: boolean): void {
    const { position, orientation } = pose;
    this.group.visible = true;
    this.group.position.set(position.x, position.y, position.z);
    this.group.quaternion.set(orientation.x, orientation.y, orientation.z, orientation.w);
    this.direction.set(0, 0, -1).applyQuaternion(this.group.quaternion);
    const met = panel.hit(this.group.position, this.direction, this.hit);
    this.dot.visible = met;
    this.dot.position.z = -this.hit.distance;
    this.ray.visible = drawsRay;
    this.ray.scale.z = met ? this.hit.distance : FREE_LENGTH_M;
    this.below = met ? this.hit.value : null;
    this.value = this.arrival.update(panel.offer, this.below, this.hit);
  }
}

function overlayMaterial(opacity: number): MeshBasicMaterial {
  return new MeshBasicMaterial({
    color: 0xbfe9f0,
    opacity,
    transparent: true,
    depthWrite: false,
    toneMapped: false,
  });
}
