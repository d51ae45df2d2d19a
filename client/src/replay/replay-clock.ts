export const SPEEDS = [0.25, 0.5, 1, 2, 4] as const;

/** A part of a trial. */
export interface Span {
  readonly from: number;
  readonly to: number;
}

/** The time of a replay. It advances with the local clock during playback and stops at the end of the part. */
export class Clock {
  timeS = 0;
  speed = 1;
  private running = false;
  private lastMs: number | null = null;

  constructor(private shown: Span) {
    this.seek(shown.from);
  }

  /** The played part. */
  get part(): Span {
    return this.shown;
  }

  /** Restricts playback to a part. */
  confine(part: Span): void {
    this.shown = part;
    this.seek(this.timeS);
  }

  get playing(): boolean {
    return this.running;
  }

  /** Starts or pauses; at the end it starts again. */
  toggle(): void {
    this.running = !this.running;
    if (this.running && this.timeS >= this.shown.to) this.timeS = this.shown.from;
  }

  seek(timeS: number): void {
    this.timeS = Math.min(Math.max(timeS, this.shown.from), this.shown.to);
  }

  /** Selects the next higher or lower speed. */
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
