import { PerspectiveCamera, Quaternion, Vector3, type Object3D } from "three";
import { POSE } from "./state-interpolation";
import type { Scene } from "../generated/messages";

/** A camera at the simulated person's eyes. */
export class ParticipantCamera {
  /** Looks along −z, as cameras in three.js; the head's axes are x left, −y forward, z up. */
  readonly camera = new PerspectiveCamera(undefined, 1, 0.03, 30);
  private headAt = -1;
  private readonly inHead = new Vector3();

  onScene({ bodies, head_bodies, eyes }: Scene): void {
    this.headAt = bodies.indexOf(head_bodies[0]!) * POSE;
    this.inHead.set(...eyes);
  }

  /** Moves the camera to the eyes in these poses. */
  follow(poses: Float32Array, root: Object3D): void {
    if (this.headAt < 0) return;
    const at = (index: number) => poses[this.headAt + index]!;
    const head = new Quaternion(at(4), at(5), at(6), at(3));
    const { position, quaternion } = this.camera;
    position.copy(this.inHead).applyQuaternion(head).add(new Vector3(at(0), at(1), at(2)));
    root.localToWorld(position);
    quaternion.copy(root.quaternion).multiply(head).multiply(CAMERA_IN_HEAD);
  }
}

/** Rotation from a camera's axes (x right, y up, −z forward) to the head's (x left, −y forward, z up). */
const CAMERA_IN_HEAD = new Quaternion(0, Math.SQRT1_2, Math.SQRT1_2, 0);
