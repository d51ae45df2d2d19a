import { PERSON, TRUNK } from "../generated/body-model";
import { solveArm, type ArmAngles, type ArmLengths, type Hand } from "./arm-solver";
import { fromQuaternion, fromEulerXYZ, addScaled, multiplyTransposed, multiply, rotate, rotateInverse, toEulerXYZ, type Axes, type Vector } from "./linear-algebra";
import type { Quaternion, Skeleton } from "../generated/messages";

/** A pose in the world frame; the quaternion is w, x, y, z. */
export interface Pose {
  position: Vector;
  q: Quaternion;
}

export type Side = "left" | "right";

/** The poses of the participant's head and hands; null: not tracked. */
export type BodyPose = Record<"head", Pose> & Record<Side, Pose | null>;

/** Angles of the driven joints, in the server's order. */
export type JointAngles = Float64Array;

/** The frame of a body part: its origin, and its axes as columns. */
interface Frame {
  origin: Vector;
  axes: Axes;
}

/** Signs that mirror the angles and coordinates of a left arm to a right one. */
const ANGLE_SIGNS: Record<Side, ArmAngles> = {
  right: [1, 1, 1, 1, 1, 1, 1],
  left: [-1, 1, -1, 1, -1, 1, -1],
};
const SIGN: Record<Side, number> = { right: 1, left: -1 };

/** Inverse kinematics of one person; implements `vr/tracking/body.py`, which explains the method. */
export class BodySolver {
  private readonly hips: Frame;
  private readonly lengths: ArmLengths;

  constructor(private readonly skeleton: Skeleton) {
    this.hips = { origin: skeleton.hips_pos_w, axes: fromQuaternion(skeleton.hips_q_w) };
    this.lengths = { upper: skeleton.upper_arm_m, fore: skeleton.forearm_m, hand: skeleton.hand_m };
  }

  /** Joint angles for the poses of head and hands. No joint of an arm moves by more than `turn` from `start`. */
  solve(pose: BodyPose, start: JointAngles, turn: number): JointAngles {
    const angles = start.slice();
    angles.set(this.trunkAngles(pose.head));
    const torso = this.torso(angles);
    for (const side of ["right", "left"] as const) {
      const hand = pose[side];
      if (hand) this.bringHand(side, hand, torso, angles, turn);
    }
    return angles;
  }

  /** Waist x, y, z and head x, y, z: the waist tilts towards the head's joints, both share the yaw. */
  private trunkAngles(head: Pose): number[] {
    const { hips, skeleton } = this;
    const headAxes = multiplyTransposed(hips.axes, fromQuaternion(head.q));
    const centre = rotateInverse(hips.axes, addScaled(head.position, hips.origin, -1));
    const [x, y, z] = addScaled(centre, [headAxes[2]!, headAxes[5]!, headAxes[8]!], -skeleton.head_centre_m);
    const rise = z - skeleton.waist[2];
    const forward = -Math.atan2(y, rise);
    const sideways = Math.atan2(x * Math.cos(forward), rise);
    const [a, b] = limited(TRUNK.waist_ranges_rad, [forward, sideways, 0]);
    const yaw = TRUNK.waist_yaw_share * toEulerXYZ(multiplyTransposed(fromEulerXYZ(a, b, 0), headAxes))[2];
    const waist = limited(TRUNK.waist_ranges_rad, [a, b, yaw]);
    return [...waist, ...limited(TRUNK.head_ranges_rad, toEulerXYZ(multiplyTransposed(fromEulerXYZ(...waist), headAxes)))];
  }

  private torso(angles: JointAngles): Frame {
    const [x, y, z] = PERSON.joints.waist.map((joint) => angles[joint]!) as Vector;
    const { origin, axes } = this.hips;
    return { origin: addScaled(origin, rotate(axes, this.skeleton.waist)), axes: multiply(axes, fromEulerXYZ(x, y, z)) };
  }

  private bringHand(side: Side, hand: Pose, torso: Frame, angles: JointAngles, turn: number): void {
    const joints = PERSON.joints[side];
    const signs = ANGLE_SIGNS[side];
    const start = joints.map((joint, index) => signs[index]! * angles[joint]!);
    const solved = solveArm(this.lengths, this.seenFromShoulder(side, hand, torso), start, turn);
    joints.forEach((joint, index) => (angles[joint] = signs[index]! * solved[index]!));
  }

  /** The hand's pose in the shoulder's frame; a left hand is mirrored. */
  private seenFromShoulder(side: Side, hand: Pose, torso: Frame): Hand {
    const sign = SIGN[side];
    const [x, y, z] = rotateInverse(torso.axes, addScaled(hand.position, torso.origin, -1));
    const axes = multiplyTransposed(torso.axes, fromQuaternion(hand.q));
    const mirrored = axes.map((entry, index) => (MIXED.has(index) ? sign * entry : entry));
    return { position: addScaled([sign * x, y, z], this.skeleton.right_shoulder, -1), axes: mirrored };
  }
}

/** Matrix entries whose sign changes with a reflection of x. */
const MIXED = new Set([1, 2, 3, 6]);

function limited(ranges: readonly (readonly [number, number])[], angles: Vector): Vector {
  return angles.map((angle, n) => Math.min(Math.max(angle, ranges[n]![0]), ranges[n]![1])) as Vector;
}
