/** Maximum interruption of a look that is ignored: heads tremble. */
export const FLICKER_MS = 150;

/** Selects the target at which the participant looks for a time. Each look selects at most once. */
export class Dwell {
  highlighted: number | null = null;
  private sinceMs = 0;
  private seenMs = 0;
  private selected = false;
  private nowMs = 0;

  constructor(private readonly dwellMs: number) {}

  /** The share of its time that the highlighted target has been looked at, 0 to 1. */
  get progress(): number {
    if (this.highlighted === null || this.selected) return 0;
    return Math.min(1, (this.nowMs - this.sinceMs) / this.dwellMs);
  }

  /** Discards a look that has begun: the targets have changed. */
  reset(): void {
    this.highlighted = null;
    this.selected = false;
  }

  /** Looks at a target, or at none (null). Returns the target once its time is over. */
  look(value: number | null, nowMs: number): number | null {
    this.nowMs = nowMs;
    if (value === this.highlighted) this.seenMs = nowMs;
    else if (value !== null || nowMs - this.seenMs > FLICKER_MS) this.begin(value, nowMs);
    if (value === null || this.selected || this.progress < 1) return null;
    this.selected = true;
    return value;
  }

  private begin(value: number | null, nowMs: number): void {
    this.highlighted = value;
    this.sinceMs = this.seenMs = nowMs;
    this.selected = false;
  }
}
