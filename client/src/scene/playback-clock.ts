import { TICK_S } from "../generated/messages";

/** Number of frames that determine the delay: two seconds. */
const HISTORY = 180;
/** Share of frames for which the needed state may be missing. */
const MISSED_SHARE = 0.02;
/** Maximum delay behind states that arrive without network delay. */
export const MAX_DELAY_S = 0.2;
/** Beyond this delay, the clock jumps instead of catching up. */
export const SKIP_DELAY_S = 0.25;
/** Maximum deviation of the playback rate from 1. */
export const MAX_RATE_CHANGE = 0.1;
/** Time constant for the correction of small errors. */
const SETTLING_TIME_S = 0.1;

/**
 * The playback clock of the simulation (a jitter buffer): as close behind the newest state as frames stay smooth.
 *
 * In each frame it records how far the newest state is ahead of local time. The delay is chosen so that nearly all
 * recent frames had a state on either side of the drawn time. The clock never runs backwards or beyond the newest
 * state; if that is too old, it stops.
 */
export class Playback {
  /** The lead of the newest state over local time in recent frames (ring buffer). */
  private readonly ahead = new Float64Array(HISTORY);
  private readonly sorted = new Float64Array(HISTORY);
  private pictures = 0;
  private atS = 0;
  /** The drawn simulation time. */
  drawnS = -Infinity;

  /** The simulation time to draw at local time `nowS`; `newestS`: that of the newest state. */
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

  /** The lead over local time that a state had in nearly all frames. */
  private wantedAheadS(): number {
    const count = Math.min(this.pictures, HISTORY);
    const sorted = this.sorted.subarray(0, count);
    sorted.set(this.ahead.subarray(0, count));
    sorted.sort();
    return Math.max(sorted[Math.floor(MISSED_SHARE * count)]!, sorted[count - 1]! - MAX_DELAY_S);
  }
}
