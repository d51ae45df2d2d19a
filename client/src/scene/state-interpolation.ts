import { Quaternion } from "three";
import { Playback } from "./playback-clock";
import type { State } from "../session/state-decoder";

/** Numbers per body: position x, y, z, then orientation w, x, y, z. */
export const POSE = 7;
/** A body that moves further than this within one state has been placed anew. */
export const TELEPORT_M = 0.5;

type Numbers = Float32Array;
const slerpFlat = Quaternion.slerpFlat as unknown as (
  ...of: [out: Numbers, at: number, from: Numbers, at: number, to: Numbers, at: number, t: number]
) => void;

const CAPACITY = 32;

interface Slot extends Frame {
  sequence: number;
}

/** The last states of one scene; draws the world between them by simulation time. */
export class StateBuffer {
  private readonly slots: Slot[];
  private count = 0;
  private last = -1;
  private playback = new Playback();

  constructor(private readonly bodies: number) {
    this.slots = Array.from({ length: CAPACITY }, () => emptySlot(bodies));
  }

  /** Takes a state; false when it is old or does not fit the scene. */
  push(state: State): boolean {
    const newest = this.newest();
    if (state.poses.length !== this.bodies * POSE) return false;
    if (newest && state.sequence <= newest.sequence) return false;
    if (newest && state.simulation_time_s < newest.timeS) this.reset();
    const samePlace = this.count > 0 && newest?.timeS === state.simulation_time_s;
    if (!samePlace) this.advance();
    this.store(this.slots[this.last]!, state);
    return true;
  }

  /** The simulation time of the picture that was drawn last. */
  get drawnTimeS(): number {
    return this.playback.drawnS;
  }

  /** The world to draw at local time `nowS`, into `out` (bodies × 7); false before the first state. */
  draw(nowS: number, out: Float32Array): boolean {
    const newest = this.newest();
    return newest !== null && this.sample(this.playback.advance(nowS, newest.timeS), out);
  }

  /** The world at a simulation time; outside the buffer, its nearest state. */
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

  /** The state that is `age` states older than the newest. */
  private slot(age: number): Slot {
    return this.slots[(this.last - age + CAPACITY) % CAPACITY]!;
  }

  private advance(): void {
    this.last = (this.last + 1) % CAPACITY;
    this.count = Math.min(this.count + 1, CAPACITY);
  }

  private store(slot: Slot, state: State): void {
    slot.sequence = state.sequence;
    slot.timeS = state.simulation_time_s;
    slot.poses.set(state.poses);
  }

  private reset(): void {
    this.count = 0;
    this.playback = new Playback();
  }
}

/** All bodies' poses at a time. */
export interface Frame {
  timeS: number;
  poses: Float32Array;
}

/** The poses between two frames, into `out`; what was placed anew stays until it is. */
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

/** three's slerp treats the four numbers alike, so it serves w, x, y, z as well as x, y, z, w. */
function slerp(out: Float32Array, from: Float32Array, to: Float32Array, at: number, t: number): void {
  slerpFlat(out, at, from, at, to, at, t);
}
