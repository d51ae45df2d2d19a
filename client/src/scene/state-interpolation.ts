import { Quaternion } from "three";
import { Playback } from "./playback-clock";
import type { WorldState } from "../session/state-decoder";

/** Numbers per body: position x, y, z, orientation w, x, y, z. */
export const POSE = 7;
/** A body that moves further within one state is not interpolated. */
export const TELEPORT_M = 0.5;

type Numbers = Float32Array;
const slerpFlat = Quaternion.slerpFlat as unknown as (
  ...of: [out: Numbers, at: number, from: Numbers, at: number, to: Numbers, at: number, t: number]
) => void;

const CAPACITY = 32;

interface Slot extends Frame {
  sequence: number;
}

/** Buffer of the last states of one scene; interpolates by simulation time. */
export class StateBuffer {
  private readonly slots: Slot[];
  private count = 0;
  private last = -1;
  private playback = new Playback();

  constructor(private readonly bodies: number) {
    this.slots = Array.from({ length: CAPACITY }, () => emptySlot(bodies));
  }

  /** Adds a state; returns false if it is old or does not match the scene. */
  push(state: WorldState): boolean {
    const newest = this.newest();
    if (state.poses.length !== this.bodies * POSE) return false;
    if (newest && state.sequence <= newest.sequence) return false;
    if (newest && state.simulation_time_s < newest.timeS) this.reset();
    const samePlace = this.count > 0 && newest?.timeS === state.simulation_time_s;
    if (!samePlace) this.advance();
    this.store(this.slots[this.last]!, state);
    return true;
  }

  /** The simulation time of the last frame. */
  get drawnTimeS(): number {
    return this.playback.drawnS;
  }

  /** Writes the poses at local time `nowS` into `out` (bodies × 7); false before the first state. */
  draw(nowS: number, out: Float32Array): boolean {
    const newest = this.newest();
    return newest !== null && this.sample(this.playback.advance(nowS, newest.timeS), out);
  }

  /** Writes the poses at a simulation time into `out`; outside the buffer, those of the nearest state. */
  sample(timeS: number, out: Float32Array): boolean {
    if (this.count === 0) return false;
    let age = 0;
    while (age < this.count - 1 && this.slot(age).timeS > timeS) age++;
    const before = this.slot(age);
    if (age === 0 || timeS <= before.timeS) out.set(before.poses);
    else blend(before, this.slot(age - 1), timeS, out);
    return true;
  }

  private newest(): Slot | null {
    return this.count > 0 ? this.slot(0) : null;
  }

  /** The state `age` states before the newest. */
  private slot(age: number): Slot {
    return this.slots[(this.last - age + CAPACITY) % CAPACITY]!;
  }

  private advance(): void {
    this.last = (this.last + 1) % CAPACITY;
    this.count = Math.min(this.count + 1, CAPACITY);
  }

  private store(slot: Slot, state: WorldState): void {
    slot.sequence = state.sequence;
    slot.timeS = state.simulation_time_s;
    slot.poses.set(state.poses);
  }

  private reset(): void {
    this.count = 0;
    this.playback = new Playback();
  }
}

/** The poses of all bodies at a time. */
export interface Frame {
  timeS: number;
  poses: Float32Array;
}

/** Interpolates the poses between two frames into `out`; bodies that were moved discontinuously are not interpolated. */
export function blend(before: Frame, after: Frame, timeS: number, out: Float32Array): void {
  const share = (timeS - before.timeS) / (after.timeS - before.timeS);
  for (let at = 0; at < out.length; at += POSE) {
    const t = isTeleport(before.poses, after.poses, at) ? 0 : share;
    for (let axis = at; axis < at + 3; axis++) {
      out[axis] = before.poses[axis]! + (after.poses[axis]! - before.poses[axis]!) * t;
    }
    slerp(out, before.poses, after.poses, at + 3, t);
  }
}

function emptySlot(bodies: number): Slot {
  return { sequence: -1, timeS: 0, poses: new Float32Array(bodies * POSE) };
}

function isTeleport(before: Float32Array, after: Float32Array, at: number): boolean {
  const x = after[at]! - before[at]!;
  const y = after[at + 1]! - before[at + 1]!;
  const z = after[at + 2]! - before[at + 2]!;
  return x * x + y * y + z * z > TELEPORT_M * TELEPORT_M;
}

/** three.js's slerp is symmetric in the components, so it works for w, x, y, z as well as x, y, z, w. */
function slerp(out: Float32Array, from: Float32Array, to: Float32Array, at: number, t: number): void {
  slerpFlat(out, at, from, at, to, at, t);
}
