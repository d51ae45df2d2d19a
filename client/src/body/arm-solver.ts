import { ARM } from "../generated/body-model";
import { axis, cross, fromEulerXYZ, addScaled, multiplyTransposed, multiply, rotationVector, type Axes, type Vector } from "./linear-algebra";
import { solveSymmetric } from "./linear-algebra";

/** Distances from shoulder to elbow, elbow to wrist, and wrist to the centre of the hand, metres. */
export interface ArmLengths {
  upper: number;
  fore: number;
  hand: number;
}

/** The target pose of a right hand in the shoulder's frame, which has the axes of the torso. */
export interface Hand {
  position: Vector;
  axes: Axes;
}

/** Angles of shoulder y, x, z, elbow x, forearm z, wrist x, y. */
export type ArmAngles = number[];

const JOINTS = ARM.lower_rad.length;
const TURN = 2 * Math.PI;
/** Range of angles for which the equivalent angle within half a turn lies in the joint's range or covers it. */
const FIRST = ARM.lower_rad.map((lower, joint) => Math.min(lower + Math.PI, ARM.upper_rad[joint]! - Math.PI));
const LAST = ARM.lower_rad.map((lower, joint) => Math.max(lower + Math.PI, ARM.upper_rad[joint]! - Math.PI));
const SWIVELS = Math.round(TURN / ARM.swivel_step_rad);
const SWIVEL_COS = Float64Array.from({ length: SWIVELS }, (_, n) => Math.cos(n * ARM.swivel_step_rad));
const SWIVEL_SIN = Float64Array.from({ length: SWIVELS }, (_, n) => Math.sin(n * ARM.swivel_step_rad));

/**
 * Inverse kinematics of a right arm; implements `vr/tracking/arm.py`, which explains the method.
 *
 * ParticipantTargets out of reach are projected to the reachable range. No joint moves by more than `turn` from `start`.
 */
export function solveArm(lengths: ArmLengths, hand: Hand, start: ArmAngles, turn: number): ArmAngles {
  const reached = { position: withinReach(lengths, hand), axes: hand.axes };
  const aim = comfortableAngles(lengths, reached, start);
  const lower = start.map((angle, joint) => Math.max(ARM.lower_rad[joint]!, angle - turn));
  const upper = start.map((angle, joint) => Math.min(ARM.upper_rad[joint]!, angle + turn));
  let angles = aim.map((angle, joint) => clip(angle, lower[joint]!, upper[joint]!));
  if (!isShort(aim, angles, start)) return angles;
  for (let step = 0; step < ARM.least_squares_steps; step++) {
    const turns = leastSquaresStep(lengths, reached, angles, lower, upper);
    angles = angles.map((angle, joint) => clip(angle + turns[joint]!, lower[joint]!, upper[joint]!));
  }
  return angles;
}

/** Whether limits clip the angles of a target that is close to the start. */
function isShort(aim: ArmAngles, angles: ArmAngles, start: ArmAngles): boolean {
  let [largest, missing] = [0, 0];
  for (let joint = 0; joint < JOINTS; joint++) {
    const within = clip(aim[joint]!, ARM.lower_rad[joint]!, ARM.upper_rad[joint]!);
    largest = Math.max(largest, Math.abs(within - start[joint]!));
    missing = Math.max(missing, Math.abs(angles[joint]! - aim[joint]!));
  }
  return largest < ARM.detour_rad && missing > ARM.exact_rad;
}

/** The hand's centre, moved on the line from shoulder to wrist into the reach of the elbow. */
function withinReach({ upper, fore, hand }: ArmLengths, { position, axes }: Hand): Vector {
  const wrist = addScaled(position, axis(axes, 2), hand);
  const distance = Math.max(Math.hypot(...wrist), 1e-6);
  const nearest = Math.sqrt(upper ** 2 + fore ** 2 + 2 * upper * fore * Math.cos(ARM.lower_rad[ELBOW]!));
  const share = clip(distance, nearest / ARM.reached, ARM.reached * (upper + fore)) / distance;
  return addScaled([share * wrist[0], share * wrist[1], share * wrist[2]], axis(axes, 2), -hand);
}

const ELBOW = 3;

/** Angles of a reachable hand pose, without the ranges of shoulder and wrist. */
export function comfortableAngles(lengths: ArmLengths, hand: Hand, start: ArmAngles): ArmAngles {
  const swivelling = new Swivelling(lengths, hand, start);
  let [best, least] = [0, Infinity];
  for (let candidate = 0; candidate < 2 * SWIVELS; candidate++) {
    const cost = swivelling.cost(candidate);
    if (cost < least) [best, least] = [candidate, cost];
  }
  return swivelling.finest(best);
}

/** All elbow swivels for a fixed hand, each with both solutions of the shoulder. */
class Swivelling {
  private readonly elbow: number;
  private readonly below: number;
  private readonly upperArm: Axes;
  private readonly forearm: Axes;
  private readonly around: ArmAngles;
  private readonly favoured: ArmAngles;
  private readonly angles: ArmAngles = new Array<number>(JOINTS).fill(0);
  private rests = 0;
  private readonly costs = new Float64Array(2 * SWIVELS);

  constructor(
    lengths: ArmLengths,
    { position, axes }: Hand,
    private readonly start: ArmAngles,
  ) {
    const wrist = addScaled(position, axis(axes, 2), lengths.hand);
    [this.elbow, this.below] = elbowOf(lengths, Math.hypot(...wrist));
    this.upperArm = towards(wrist, start);
    this.forearm = multiplyTransposed(axes, this.upperArm);
    this.around = start.map((angle, joint) => clip(angle, FIRST[joint]!, LAST[joint]!));
    this.favoured = start.map(
      (angle, joint) => (ARM.stay * angle + ARM.ease[joint]! * ARM.at_ease_rad[joint]!) / STIFFNESS[joint]!,
    );
  }

  cost(candidate: number): number {
    const swivel = candidate % SWIVELS;
    this.hold(SWIVEL_COS[swivel]!, SWIVEL_SIN[swivel]!, candidate >= SWIVELS);
    let cost = 0;
    for (let joint = 0; joint < JOINTS; joint++) {
      const angle = this.angles[joint]!;
      const outside = angle - clip(angle, ARM.lower_rad[joint]!, ARM.upper_rad[joint]!);
      const away = angle - this.favoured[joint]!;
      cost += ARM.outside * outside * outside + STIFFNESS[joint]! * away * away;
    }
    return (this.costs[candidate] = cost + ARM.lift * this.rests);
  }

  /** The angles at the minimum of a parabola through the costs of a candidate and its neighbours. */
  finest(candidate: number): ArmAngles {
    const first = candidate - (candidate % SWIVELS);
    const at = (swivel: number) => this.costs[first + ((swivel + SWIVELS) % SWIVELS)]!;
    const swivel = candidate - first;
    const [before, here, after] = [at(swivel - 1), at(swivel), at(swivel + 1)];
    const curvature = before - 2 * here + after;
    const vertex = curvature > 1e-12 ? (0.5 * (before - after)) / curvature : 0;
    const angle = ARM.swivel_step_rad * (swivel + vertex);
    this.hold(Math.cos(angle), Math.sin(angle), first > 0);
    return [...this.angles];
  }

  /** Computes the angles of one swivel from the axes of the upper arm, and of the forearm relative to the hand. */
  private hold(c: number, s: number, otherWay: boolean): void {
    const { upperArm: u, forearm: f, below, elbow, angles } = this;
    const [cu, su] = [Math.cos(below), Math.sin(below)];
    const [cf, sf] = [Math.cos(below + elbow), Math.sin(below + elbow)];
    const ahead = -(su * (u[3]! * s - u[4]! * c) + cu * u[5]!);
    const zx = su * (u[0]! * s - u[1]! * c) + cu * u[2]!;
    const zz = su * (u[6]! * s - u[7]! * c) + cu * u[8]!;
    const fz = sf * (f[3]! * s - f[4]! * c) + cf * f[5]!;
    angles[0] = Math.atan2(zx, zz);
    angles[1] = Math.asin(clip(ahead, -1, 1));
    angles[2] = Math.atan2(u[3]! * c + u[4]! * s, cu * (u[4]! * c - u[3]! * s) + su * u[5]!);
    angles[3] = elbow;
    angles[4] = Math.atan2(-(f[3]! * c + f[4]! * s), cf * (f[4]! * c - f[3]! * s) + sf * f[5]!);
    angles[5] = Math.asin(clip(fz, -1, 1));
    angles[6] = Math.atan2(
      -(sf * (f[0]! * s - f[1]! * c) + cf * f[2]!),
      sf * (f[6]! * s - f[7]! * c) + cf * f[8]!,
    );
    const [rx, ry, rz] = ARM.elbow_rests;
    this.rests = rx * zx - ry * ahead + rz * zz;
    if (otherWay) turnTheOtherWay(angles);
    this.unwind();
    restNearPole(angles, ahead, this.start[0]!);
  }

  /** Adds multiples of a full turn to come closest to the present angles. */
  private unwind(): void {
    for (let joint = 0; joint < JOINTS; joint++)
      this.angles[joint]! -= TURN * halfEven((this.angles[joint]! - this.around[joint]!) / TURN);
  }
}

const STIFFNESS = ARM.ease.map((ease) => ARM.stay + ease);

function turnTheOtherWay(angles: ArmAngles): void {
  angles[0] = Math.PI + angles[0]!;
  angles[1] = Math.PI - angles[1]!;
  angles[2] = Math.PI + angles[2]!;
}

/** Near the singularity (upper arm forward), keeps shoulder y where it is, as far as the hand hardly moves. */
function restNearPole(angles: ArmAngles, ahead: number, startY: number): void {
  const slack = Math.PI * Math.min(ARM.pole_rad ** 2 / (1 + 1e-12 - ahead * ahead), 1);
  const rest = clip(startY - angles[0]!, -slack, slack);
  angles[0]! += rest;
  angles[2]! -= rest;
}

/** The elbow angle for a wrist distance, and the angle of the upper arm below the direction to the wrist. */
function elbowOf({ upper, fore }: ArmLengths, distance: number): [number, number] {
  const cosine = (distance ** 2 - upper ** 2 - fore ** 2) / (2 * upper * fore);
  const angle = -Math.acos(clip(cosine, -1, 1));
  return [angle, Math.atan2(-fore * Math.sin(angle), upper + fore * Math.cos(angle))];
}

/** Axes whose −z points to the wrist and whose x is closest to the elbow's hinge. */
function towards(wrist: Vector, [y, x, z]: ArmAngles): Axes {
  const scale = -1 / Math.max(Math.hypot(...wrist), 1e-6);
  const back: Vector = [scale * wrist[0], scale * wrist[1], scale * wrist[2]];
  const hinge = upperArmX(y!, x!, z!);
  const along = hinge[0] * back[0] + hinge[1] * back[1] + hinge[2] * back[2];
  const across = addScaled(hinge, back, -along);
  const length = Math.hypot(...across);
  if (length < 1e-6) return towards(wrist, [y!, x!, z! + 0.5 * Math.PI]);
  const ax: Vector = [across[0] / length, across[1] / length, across[2] / length];
  const ay = cross(back, ax);
  return [ax[0], ay[0], back[0], ax[1], ay[1], back[1], ax[2], ay[2], back[2]];
}

/** The axis of the elbow's hinge, which is the x axis of the upper arm. */
function upperArmX(y: number, x: number, z: number): Vector {
  const [across, along] = [Math.sin(x) * Math.sin(z), Math.cos(z)];
  const [c, s] = [Math.cos(y), Math.sin(y)];
  return [c * along + s * across, Math.cos(x) * Math.sin(z), c * across - s * along];
}

/** A damped least-squares step. Joints at a limit that the error pushes outwards are fixed. */
function leastSquaresStep(
  lengths: ArmLengths,
  hand: Hand,
  angles: ArmAngles,
  lower: ArmAngles,
  upper: ArmAngles,
): number[] {
  const now = kinematics(lengths, angles);
  const turn = rotationVector(now.axes, hand.axes);
  const metres = ARM.metres_per_radian;
  const error = [...addScaled(hand.position, now.position, -1), ...turn.map((angle) => metres * angle)];
  const columns = now.hinges.map(({ along, at }, joint) => {
    const column = [...cross(along, addScaled(now.position, at, -1)), ...along.map((part) => metres * part)];
    const pull = dot(column, error);
    const stuck = pull < 0 ? angles[joint]! <= lower[joint]! : pull > 0 && angles[joint]! >= upper[joint]!;
    return stuck ? column.fill(0) : column;
  });
  const gram = error.map((_, i) =>
    error.map((_, j) => columns.reduce((sum, column) => sum + column[i]! * column[j]!, damping(i, j))),
  );
  const weights = solveSymmetric(gram, error);
  return columns.map((column) => dot(column, weights));
}

function damping(row: number, column: number): number {
  return row === column ? ARM.damping_m ** 2 : 0;
}

interface Kinematics extends Hand {
  /** The joint axes, and points on them. */
  hinges: { along: Vector; at: Vector }[];
}

/** Forward kinematics: the pose of a right hand in the shoulder's frame. */
export function kinematics(lengths: ArmLengths, angles: ArmAngles): Kinematics {
  const [y, x, z, elbow, forearm, wristX, wristY] = angles as [number, number, number, number, number, number, number];
  const shoulderY = fromEulerXYZ(0, y, 0);
  const upperArm = multiply(shoulderY, fromEulerXYZ(x, 0, z));
  const fore = multiply(upperArm, fromEulerXYZ(elbow, 0, forearm));
  const axes = multiply(fore, fromEulerXYZ(wristX, wristY, 0));
  const shoulder: Vector = [0, 0, 0];
  const elbowAt = addScaled(shoulder, axis(upperArm, 2), -lengths.upper);
  const wristAt = addScaled(elbowAt, axis(fore, 2), -lengths.fore);
  const hinges = [
    { along: axis(shoulderY, 1), at: shoulder },
    { along: axis(shoulderY, 0), at: shoulder },
    { along: axis(upperArm, 2), at: shoulder },
    { along: axis(upperArm, 0), at: elbowAt },
    { along: axis(fore, 2), at: elbowAt },
    { along: axis(fore, 0), at: wristAt },
    { along: axis(axes, 1), at: wristAt },
  ];
  return { position: addScaled(wristAt, axis(axes, 2), -lengths.hand), axes, hinges };
}

function dot(a: readonly number[], b: readonly number[]): number {
  return a.reduce((sum, value, index) => sum + value * b[index]!, 0);
}

function clip(value: number, lower: number, upper: number): number {
  return Math.min(Math.max(value, lower), upper);
}

/** Rounds to the nearest integer, halves to the even one. */
function halfEven(value: number): number {
  const floor = Math.floor(value);
  if (value - floor !== 0.5) return Math.round(value);
  return floor % 2 ? floor + 1 : floor;
}
