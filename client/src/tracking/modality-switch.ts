import { Quaternion, Vector3 } from "three";
import { DEVICES, SWITCHES } from "../generated/body-model";
import type { Side } from "../body/body-solver";
import type { Modality, XRPose } from "../generated/messages";
import { poseOf, type Poses } from "./pose-reader";

/** A pose as three.js objects. */
interface Place {
  at: Vector3;
  turn: Quaternion;
}

const STRAIGHT = new Quaternion();
const GRIP_FROM_WRIST: Record<Side, Place> = { left: gripFromWrist("left"), right: gripFromWrist("right") };

function gripFromWrist(side: Side): Place {
  const bodyFromDevice = quaternionOf(DEVICES.body_from_device_q);
  const turn = quaternionOf(DEVICES.hand_from_wrist_q[side]).multiply(bodyFromDevice.conjugate());
  return { at: new Vector3(...DEVICES.hand_centre_from_wrist), turn };
}

/** A hand whose tracking device may change; implements `vr/tracking/switches.py`, which explains the method. */
export class HandFollower {
  private modality: Modality = "none";
  private followed: Place | null = null;
  private seenMs = 0;
  /** Correction from the present device's grip to the followed grip. */
  private correction: Place | null = null;
  private readonly rested = new Vector3();

  constructor(private readonly side: Side) {}

  /** The grip to follow for a new pose. */
  grip(pose: XRPose, modality: Modality, nowMs: number): XRPose {
    const grip = modality === "hand" ? moved(placeOf(pose), GRIP_FROM_WRIST[this.side]) : placeOf(pose);
    if (modality !== this.modality && this.followed) this.switch(grip, this.followed, (nowMs - this.seenMs) / 1000);
    else if (this.correction) this.fade(grip, this.correction);
    this.modality = modality;
    this.seenMs = nowMs;
    this.followed = this.correction ? moved(grip, this.correction) : grip;
    return poseOf(this.followed.at, this.followed.turn);
  }

  private switch(grip: Place, followed: Place, gapS: number): void {
    const found = moved(inverse(grip), followed);
    const same = found.at.length() <= SWITCHES.same_m && found.turn.angleTo(STRAIGHT) <= SWITCHES.same_rad;
    this.correction = same && gapS <= SWITCHES.max_switch_gap_s ? found : null;
    this.rested.copy(grip.at);
  }

  private fade(grip: Place, { at, turn }: Place): void {
    const distance = grip.at.distanceTo(this.rested);
    if (distance <= SWITCHES.rest_radius_m) return;
    this.rested.copy(grip.at);
    const size = Math.max(at.length(), SWITCHES.metres_per_radian * turn.angleTo(STRAIGHT));
    const left = size > 0 ? 1 - (SWITCHES.fading_per_metre * distance) / size : 0;
    if (left > 0) this.correction = { at: at.multiplyScalar(left), turn: turn.slerp(STRAIGHT, 1 - left) };
    else this.correction = null;
  }
}

/** Both hands. */
export class Hands {
  private readonly left = new HandFollower("left");
  private readonly right = new HandFollower("right");

  /** The poses with the hands replaced by the grips to follow. */
  follow(poses: Poses, nowMs: number): Poses {
    const { head, left, right, left_modality, right_modality } = poses;
    return {
      head,
      left: left && this.left.grip(left, left_modality, nowMs),
      right: right && this.right.grip(right, right_modality, nowMs),
      left_modality: held(left_modality),
      right_modality: held(right_modality),
    };
  }
}

/** The modality of a hand that is followed as a grip. */
function held(modality: Modality): Modality {
  return modality === "hand" ? "controller" : modality;
}

function placeOf([at, turn]: XRPose): Place {
  return { at: new Vector3(...at), turn: new Quaternion(...turn).normalize() };
}

function moved({ at, turn }: Place, inside: Place): Place {
  return { at: inside.at.clone().applyQuaternion(turn).add(at), turn: turn.clone().multiply(inside.turn) };
}

function inverse({ at, turn }: Place): Place {
  const back = turn.clone().conjugate();
  return { at: at.clone().negate().applyQuaternion(back), turn: back };
}

function quaternionOf([w, x, y, z]: readonly [number, number, number, number]): Quaternion {
  return new Quaternion(x, y, z, w);
}
