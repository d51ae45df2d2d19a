import { CylinderGeometry, Group, Mesh, MeshBasicMaterial, SphereGeometry, Vector3 } from "three";
import { OVERLAY_ORDER } from "./canvasplane";
import type { Panel, PanelHit } from "./panel";

const FREE_LENGTH_M = 1.2;

/** A ray of one input source, with a dot where it meets the panel. */
export class Pointer {
  readonly group = new Group();
  /** The button that the ray meets, or null. */
  value: number | null = null;
  private readonly ray: Mesh;
  private readonly dot: Mesh;
  private readonly direction = new Vector3();
  private readonly hit: PanelHit = { distance: 0, value: null };

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
    this.value = null;
  }

  /** Points along a target ray, which is drawn or only its end. */
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
    this.value = met ? this.hit.value : null;
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
