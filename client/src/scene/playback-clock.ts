import { TICK_S } from "../generated/messages";

/** By so many pictures the delay is chosen: two seconds of a headset's. */
const HISTORY = 180;
/** The share of pictures for which the state that they want may not have come yet. */
const MISSED_SHARE = 0.02;
/** However the network jitters, no more than this behind the states that came without delay. */
export const MAX_DELAY_S = 0.2;
/** Farther behind than this the way is not made good but left out. */
export const SKIP_DELAY_S = 0.25;
/** How much faster or slower than time pictures may go to come nearer to the delay that is wanted. */
export const MAX_RATE_CHANGE = 0.1;
/** An error this small is made good within about this time, so that haste fades away. */
const SETTLING_TIME_S = 0.1;

/**
 * The clock by which the simulation is drawn: as close behind the newest state as these come evenly.
 *
 * What counts is not when states come but what a picture finds: at each picture the clock notes by how much its newest
 * state is ahead of local time. Drawn so far ahead, nearly all of the latest pictures had a state on either side of what
 * they drew. The clock never goes back, nor beyond the newest state: where that is too old, it stands still.
 */
export class Playback {
  /** How far the newest state was ahead of local time, at the latest pictures; the oldest is overwritten. */
  private readonly ahead = new Float64Array(HISTORY);
  private readonly sorted = new Float64Array(HISTORY);
  private pictures = 0;
  private atS = 0;
  /** The simulation time that is drawn. */
  drawnS = -Infinity;

  /** The simulation time to draw at local time `nowS`, where the newest state is that of `newestS`. */
  advance(nowS: number, newestS: number): number {
    if (this.pictures === 0) this.note(newestS - nowS - TICK_S);
    this.note(newestS - nowS);
    const elapsedS = Math.max(nowS - this.atS, 0);
    this.atS = nowS;
    const wantedS = nowS + this.wantedAheadS();
    const errorS = wantedS - (this.drawnS + elapsedS);
    const rate = 1 + Math.min(Math.max(errorS / SETTLING_TIME_S, -MAX_RATE_CHANGE), MAX_RATE_CHANGE);
    const next = errorS > SKIP_DELAY_S ? wantedS : this.drawnS + elapsedS * rate;
    this.drawnS = Math.max(Math.min(next, newestS), this.drawnS);
    return this.drawnS;
  }

  private note(aheadS: number): void {
    this.ahead[this.pictures++ % HISTORY] = aheadS;
  }

  /** How far ahead of local time nearly all pictures had a state. */
  private wantedAheadS(): number {
    const count = Math.min(this.pictures, HISTORY);
    const sorted = this.sorted.subarray(0, count);
    sorted.set(this.ahead.subarray(0, count));
    sorted.sort();
    return Math.max(sorted[Math.floor(MISSED_SHARE * count)]!, sorted[count - 1]! - MAX_DELAY_S);
  }
}
