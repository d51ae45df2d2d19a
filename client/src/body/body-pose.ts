import { Quaternion, Vector3 } from "three";
import { DEVICES } from "../generated/body-model";
import type { BodyPose, Pose, Side } from "./body-solver";
import type { Modality, XRPose } from "../generated/messages";
import type { Poses } from "../tracking/pose-reader";

interface Offset {
  position: Vector3;
  turn: Quaternion;
}

const BODY_AXES = quaternionOf(DEVICES.body_from_device_q);
const HEAD: Offset = { position: new Vector3(...DEVICES.head_centre_from_headset), turn: BODY_AXES };
const GRIP: Offset = { position: new Vector3(), turn: BODY_AXES };
const WRIST: Record<Side, Offset> = { left: wrist("left"), right: wrist("right") };

function wrist(side: Side): Offset {
  const position = new Vector3(...DEVICES.hand_centre_from_wrist);
  return { position, turn: quaternionOf(DEVICES.hand_from_wrist_q[side]) };
}

/** Head and hand poses in the world frame from device poses; `xrFromWorld` is the world's pose in `local-floor`. */
export function bodyPose({ head, left, right, ...modalities }: Poses, xrFromWorld: XRPose): BodyPose | null {
  if (!head) return null;
  const hand = (side: Side, pose: XRPose | null, modality: Modality) =>
    pose && inWorld(pose, xrFromWorld, modality === "hand" ? WRIST[side] : GRIP);
  return {
    head: inWorld(head, xrFromWorld, HEAD),
    left: hand("left", left, modalities.left_modality),
    right: hand("right", right, modalities.right_modality),
  };
}

const position = new Vector3();
const turn = new Quaternion();
const back = new Quaternion();

/** The pose of a body part in its own axes, from that of the device on it. */
function inWorld([at, orientation]: XRPose, [origin, upright]: XRPose, offset: Offset): Pose {
  turn.set(...orientation).normalize();
  position.copy(offset.position).applyQuaternion(turn);
  position.set(position.x + at[0], position.y + at[1], position.z + at[2]);
  position.set(position.x - origin[0], position.y - origin[1], position.z - origin[2]);
  back.set(...upright).conjugate();
  position.applyQuaternion(back);
  const { x, y, z, w } = turn.premultiply(back).multiply(offset.turn);
  return { position: position.toArray(), q: [w, x, y, z] };
}

function quaternionOf([w, x, y, z]: readonly [number, number, number, number]): Quaternion {
  return new Quaternion(x, y, z, w);
}
