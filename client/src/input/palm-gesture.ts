import { Vector3 } from "three";
import type { Side } from "../body/body-solver";

/** Joints of WebXR Hand InputProfileMessage: the wrist, and for each finger the joints from knuckle to tip. */
const WRIST = 0;
const FINGERS = [
  [6, 7, 8, 9],
  [11, 12, 13, 14],
  [16, 17, 18, 19],
  [21, 22, 23, 24],
] as const;
const [INDEX, MIDDLE, , LITTLE] = FINGERS.map(([knuckle]) => knuckle) as [number, number, number, number];

/** Minimum distance from knuckle to tip, relative to the length of the finger. In fists it is about 0.5. */
const STRAIGHT = 0.9;
/** Cosines of the maximum angles of the fingers to the vertical, and of the palm's normal to the gaze. */
const UPRIGHT = Math.cos((40 * Math.PI) / 180);
const FACING = Math.cos((50 * Math.PI) / 180);
/** Maximum depth of the palm below the eyes, and minimum horizontal distance, metres. */
const DEEPEST_M = 0.3;
const NEAREST_M = 0.15;

const UP = new Vector3(0, 1, 0);
const [along, across, out, ahead, palm] = Array.from({ length: 5 }, () => new Vector3()) as [Vector3, Vector3, Vector3, Vector3, Vector3];

/**
 * Whether a bare hand makes the stop gesture: fingers straight and up, palm raised and away from the eyes.
 *
 * `joints`: matrices of all joints in `local-floor`. The palm's normal is the cross product of the vectors from the
 * wrist to the knuckles of index and little finger; its sign is reversed for the left hand.
 */
export function isPalmRaised(side: Side, joints: Float32Array, eyes: Vector3): boolean {
  const wrist = at(joints, WRIST, new Vector3());
  at(joints, MIDDLE, palm).add(wrist).multiplyScalar(0.5);
  ahead.copy(palm).sub(eyes).setY(0);
  if (palm.y < eyes.y - DEEPEST_M || ahead.length() < NEAREST_M) return false;
  at(joints, INDEX, along).sub(wrist);
  at(joints, LITTLE, across).sub(wrist);
  out.crossVectors(along, across).multiplyScalar(side === "right" ? 1 : -1).setY(0);
  const facing = out.normalize().dot(ahead.normalize());
  return facing > FACING && FINGERS.every((finger) => isStraightUp(joints, finger));
}

function isStraightUp(joints: Float32Array, finger: readonly number[]): boolean {
  const places = finger.map((joint) => at(joints, joint, new Vector3()));
  const length = places.slice(1).reduce((sum, place, before) => sum + place.distanceTo(places[before]!), 0);
  const span = along.copy(places.at(-1)!).sub(places[0]!);
  return span.length() > STRAIGHT * length && span.normalize().dot(UP) > UPRIGHT;
}

function at(joints: Float32Array, joint: number, into: Vector3): Vector3 {
  return into.fromArray(joints, 16 * joint + 12);
}
