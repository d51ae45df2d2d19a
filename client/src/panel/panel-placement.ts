import { Vector3 } from "three";

/** Half the width and height of the panel, metres. */
export interface HalfSize {
  x: number;
  y: number;
}

const DEGREE = Math.PI / 180;
/** The preferred place: distance from the eyes, and angle to the right of straight ahead. */
export interface PreferredPlace {
  distance: number;
  turn: number;
}

const PREFERRED: PreferredPlace = { distance: 1.25, turn: 0 };
/** Distances relative to the preferred one, the most comfortable first. */
const DISTANCES = [1, 1.12, 0.88, 0.8];
export const FARTHEST_M = PREFERRED.distance * Math.max(...DISTANCES);
const ELEVATIONS = [-5, 8, 20, 32].map((angle) => angle * DEGREE);
const TURNS = [0, -15, 15, -30, 30, -45, 45, -60, 60].map((angle) => angle * DEGREE);
/** Weight of vertical relative to horizontal eye movements. */
const UP_COSTS = 1.5;
/** Clearance around and behind the panel. */
const MARGIN_M = 0.06;
/** Points closer than this to the plane of the eyes are ignored. */
const LEAST_DEPTH_M = 0.05;

/** A place relative to the preferred one. */
interface Candidate {
  distance: number;
  turn: number;
  elevation: number;
}

const CANDIDATES: Candidate[] = DISTANCES.flatMap((distance) =>
  ELEVATIONS.flatMap((elevation) => TURNS.map((turn) => ({ distance, turn, elevation }))),
).sort((a, b) => effort(a) - effort(b));

function effort({ distance, turn, elevation }: Candidate): number {
  return Math.abs(turn) + UP_COSTS * Math.abs(elevation - ELEVATIONS[0]!) + 0.01 * DISTANCES.indexOf(distance);
}

/**
 * The middle of a free place for a panel that faces the eyes, without obstacles before, in or close behind it.
 *
 * The place is as close to the preferred one as possible; if none is free, it is that with the fewest obstacles.
 * `forward` is horizontal; `points` are x, y, z of a dense sample of the surrounding surfaces. `reclineRad`: angle by
 * which the participant leans back. All angles are relative to this view, so that people in bed see the panel upright.
 */
export function findFreePlace(
  eyes: Vector3,
  forward: Vector3,
  points: Float32Array,
  half: HalfSize,
  reclineRad = 0,
  preferred: PreferredPlace = PREFERRED,
): Vector3 {
  const places = CANDIDATES.map(({ distance, turn, elevation }) => ({
    ...{ distance: distance * preferred.distance, turn: turn + preferred.turn, elevation },
  }));
  const up = upOfView(forward, reclineRad);
  let [best, least] = [places[0]!, Infinity];
  for (const candidate of places) {
    const axes = facing(directionOf(candidate, forward, up), up);
    const count = countObstacles(eyes, axes, candidate.distance, points, half);
    if (count < least) [best, least] = [candidate, count];
    if (least === 0) break;
  }
  return directionOf(best, forward, up).multiplyScalar(best.distance).add(eyes);
}

/** Whether a panel at `middle` that faces the eyes has no obstacles before, in or close behind it. */
export function isFree(eyes: Vector3, middle: Vector3, points: Float32Array, half: HalfSize, up: Vector3 = UP): boolean {
  const ahead = middle.clone().sub(eyes);
  const distance = ahead.length();
  return countObstacles(eyes, facing(ahead.divideScalar(distance), up), distance, points, half) === 0;
}

/** The upward direction in the view of a participant who leans back by an angle and faces `forward`. */
export function upOfView(forward: Vector3, reclineRad: number): Vector3 {
  const back = forward.clone().setY(0).normalize().multiplyScalar(-Math.sin(reclineRad));
  return back.addScaledVector(UP, Math.cos(reclineRad));
}

interface Axes {
  ahead: Vector3;
  right: Vector3;
  up: Vector3;
}

function directionOf({ turn, elevation }: Candidate, forward: Vector3, up: Vector3): Vector3 {
  const level = forward.clone().addScaledVector(up, -forward.dot(up)).normalize().applyAxisAngle(up, -turn);
  return level.multiplyScalar(Math.cos(elevation)).addScaledVector(up, Math.sin(elevation));
}

function facing(ahead: Vector3, upOfView: Vector3): Axes {
  const right = new Vector3().crossVectors(ahead, upOfView).normalize();
  return { ahead, right, up: new Vector3().crossVectors(right, ahead) };
}

const UP = new Vector3(0, 1, 0);

/** The number of points between the eyes and the panel, in it or close to it. */
function countObstacles(eyes: Vector3, axes: Axes, distance: number, points: Float32Array, half: HalfSize): number {
  const { ahead, right, up } = axes;
  let count = 0;
  for (let at = 0; at < points.length; at += 3) {
    const [x, y, z] = [points[at]! - eyes.x, points[at + 1]! - eyes.y, points[at + 2]! - eyes.z];
    const depth = x * ahead.x + y * ahead.y + z * ahead.z;
    if (depth < LEAST_DEPTH_M || depth > distance + MARGIN_M) continue;
    const share = Math.max(depth / distance, 0.5) * MARGIN_M;
    const scale = Math.min(depth / distance, 1);
    if (Math.abs(x * right.x + y * right.y + z * right.z) > half.x * scale + share) continue;
    if (Math.abs(x * up.x + y * up.y + z * up.z) < half.y * scale + share) count++;
  }
  return count;
}
