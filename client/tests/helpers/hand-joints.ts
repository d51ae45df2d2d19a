import { Matrix4, Quaternion, Vector3 } from "three";
import type { HandJoints } from "../../src/body/bare-hands";
import type { Side } from "../../src/body/body-solver";

/** Each finger of a right hand from its base on: where that is, where the finger points, and the lengths of its bones. */
const FINGERS = [
  { base: [-0.03, 0.02, 0], way: [-0.6, 0.7, -0.3], bones: [0.045, 0.035, 0.025] },
  { base: [-0.02, 0.03, 0], way: [-0.08, 1, 0], bones: [0.06, 0.04, 0.025, 0.02] },
  { base: [-0.005, 0.03, 0], way: [0, 1, 0], bones: [0.062, 0.045, 0.028, 0.022] },
  { base: [0.01, 0.03, 0], way: [0.06, 1, 0], bones: [0.057, 0.04, 0.027, 0.021] },
  { base: [0.023, 0.03, 0], way: [0.14, 1, 0], bones: [0.052, 0.032, 0.02, 0.018] },
] as const;
/** About this axis the fingers bend, towards the palm that faces −z. */
const BENDS_ABOUT = new Vector3(-1, 0, 0);

/**
 * The joints of a hand in its own axes: fingers up, the palm facing −z. `bent` is by how much each joint of a finger
 * bends, radians. A left hand is a right one in a mirror.
 */
export function handJoints(side: Side, bent = 0): Vector3[] {
  const joints = [new Vector3()];
  FINGERS.forEach(({ base, way, bones }, finger) => {
    const place = new Vector3(...base);
    const along = new Vector3(...way).normalize();
    joints.push(place.clone());
    bones.forEach((bone, at) => {
      if (finger > 0 && at > 0) along.applyAxisAngle(BENDS_ABOUT, bent);
      joints.push(place.addScaledVector(along, bone).clone());
    });
  });
  return side === "right" ? joints : joints.map(({ x, y, z }) => new Vector3(-x, y, z));
}

/** The joints of a hand whose wrist is somewhere. */
export function placed(joints: readonly Vector3[], wrist: Vector3, turn: Quaternion): HandJoints {
  const matrices = new Float32Array(16 * joints.length);
  joints.forEach((joint, at) => {
    const place = joint.clone().applyQuaternion(turn).add(wrist);
    new Matrix4().makeTranslation(place).toArray(matrices, 16 * at);
  });
  return { matrices, radii: new Float32Array(joints.length).fill(0.01) };
}

/** An open hand before the right or left shoulder, its palm away from the eyes, who look along −z. */
export function raisedHand(side: Side, eyes: Vector3, turn = new Quaternion(), bent = 0): HandJoints {
  const wrist = new Vector3(side === "right" ? 0.18 : -0.18, -0.25, -0.35).add(eyes);
  return placed(handJoints(side, bent), wrist, turn);
}
