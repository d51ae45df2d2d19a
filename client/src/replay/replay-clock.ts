export const SPEEDS = [0.25, 0.5, 1, 2, 4] as const;

/** A part of a trial. */
export interface Span {
  readonly from: number;
  readonly to: number;
}

/** Where a replay stands; it moves on with the local clock while it plays, and rests at the end of its part. */
export class Clock {
  timeS = 0;
  speed = 1;
  private running = false;
  private lastMs: number | null = null;

  constructor(private shown: Span) {
    this.seek(shown.from);
  }

  /** What is played. */
  get part(): Span {
    return this.shown;
  }

  /** Plays nothing but this from now on. */
  confine(part: Span): void {
    this.shown = part;
    this.seek(this.timeS);
  }

  get playing(): boolean {
    return this.running;
  }

  /** Whoever plays at the end begins again. */
  toggle(): void {
    this.running = !this.running;
    if (this.running && this.timeS >= this.shown.to) this.timeS = this.shown.from;
  }

  seek(timeS: number): void {
    this.timeS = Math.min(Math.max(timeS, this.shown.from), this.shown.to);
  }

  /** The next faster speed, or the next slower one. */
  change(by: 1 | -1): void {
    const at = SPEEDS.findIndex((speed) => speed === this.speed) + by;
    this.speed = SPEEDS[Math.min(Math.max(at, 0), SPEEDS.length - 1)]!;
  }

  tick(nowMs: number): void {
    const passedS = this.lastMs === null ? 0 : (nowMs - this.lastMs) / 1000;
    this.lastMs = nowMs;
    if (!this.running) return;
    this.seek(this.timeS + passedS * this.speed);
    if (this.timeS >= this.shown.to) this.running = false;
  }
}
