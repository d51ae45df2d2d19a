import { Vector3 } from "three";
import type { Side } from "../body/body-solver";

/** Joints of WebXR Hand Input: the wrist, and of each finger its knuckle and the joints from there to the tip. */
const WRIST = 0;
const FINGERS = [
  [6, 7, 8, 9],
  [11, 12, 13, 14],
  [16, 17, 18, 19],
  [21, 22, 23, 24],
] as const;
const [INDEX, MIDDLE, , LITTLE] = FINGERS.map(([knuckle]) => knuckle) as [number, number, number, number];

/** The distance from knuckle to tip, as a share of the finger's length: fists have half of it. */
const STRAIGHT = 0.9;
/** The cosines of the largest angles: of the fingers from vertical, and of the palm's normal from the gaze. */
const UPRIGHT = Math.cos((40 * Math.PI) / 180);
const FACING = Math.cos((50 * Math.PI) / 180);
/** The palm is no deeper below the eyes, and no nearer to them in the plane of the floor, metres. */
const DEEPEST_M = 0.3;
const NEAREST_M = 0.15;

const UP = new Vector3(0, 1, 0);
const [along, across, out, ahead, palm] = Array.from({ length: 5 }, () => new Vector3()) as [Vector3, Vector3, Vector3, Vector3, Vector3];

/**
 * Whether a bare hand makes the stop gesture: its fingers are straight and point up, its palm is raised and faces away from the eyes.
 *
 * `joints` are the matrices of all its joints in `local-floor`. With the wrist at the origin the palm's normal is the
 * cross product of the ways to the knuckles of index and little finger; the left hand is the right one in a mirror.
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
  const way = along.copy(places.at(-1)!).sub(places[0]!);
  return way.length() > STRAIGHT * length && way.normalize().dot(UP) > UPRIGHT;
}

function at(joints: Float32Array, joint: number, into: Vector3): Vector3 {
  return into.fromArray(joints, 16 * joint + 12);
}
