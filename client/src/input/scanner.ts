/** A press this soon after targets appear selects nothing: it was meant for earlier targets, or a tremor repeats it. */
export const GUARD_MS = 400;
/** The first target is highlighted for this many intervals, so that the participant can read. */
const FIRST_INTERVALS = 2;

/** Moves a highlight over the targets: by itself at an interval (one switch), or by steps (two switches). */
export class Scanner {
  private values: readonly number[] = [];
  private at = 0;
  private offeredMs = 0;
  private dueMs = Infinity;

  /** `intervalMs`: null for steps. */
  constructor(private readonly intervalMs: number | null) {}

  get highlighted(): number | null {
    return this.values[this.at] ?? null;
  }

  /** Begins with the first of new targets. */
  offer(values: readonly number[], nowMs: number): void {
    this.values = values;
    this.at = 0;
    this.offeredMs = nowMs;
    this.dueMs = this.intervalMs === null ? Infinity : nowMs + FIRST_INTERVALS * this.intervalMs;
  }

  /** Moves the highlight when it is due. */
  tick(nowMs: number): void {
    if (this.intervalMs === null || nowMs < this.dueMs) return;
    this.step();
    this.dueMs = nowMs + this.intervalMs;
  }

  /** Leaves the highlight where it is for at least another interval. */
  hold(nowMs: number): void {
    if (this.intervalMs !== null) this.dueMs = Math.max(this.dueMs, nowMs + this.intervalMs);
  }

  /** Moves the highlight to the next target; after the last one to the first. */
  step(): void {
    if (this.values.length > 0) this.at = (this.at + 1) % this.values.length;
  }

  /** The highlighted target, or null without targets or too soon after they appeared. */
  select(nowMs: number): number | null {
    return nowMs - this.offeredMs < GUARD_MS ? null : this.highlighted;
  }
}
