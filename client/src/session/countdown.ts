/** The remaining whole seconds of a phase. */
export class Countdown {
  secondsLeft: number | null = null;
  private endsMs = Infinity;

  /** Starts with the duration of a phase; null: unlimited. */
  begin(seconds: number | null, nowMs: number): void {
    this.endsMs = seconds === null ? Infinity : nowMs + seconds * 1000;
    this.secondsLeft = this.secondsUntilEnd(nowMs);
  }

  /** Updates the seconds; returns whether they changed. */
  advance(nowMs: number): boolean {
    const before = this.secondsLeft;
    this.secondsLeft = this.secondsUntilEnd(nowMs);
    return this.secondsLeft !== before;
  }

  private secondsUntilEnd(nowMs: number): number | null {
    return this.endsMs > nowMs && this.endsMs < Infinity ? Math.ceil((this.endsMs - nowMs) / 1000) : null;
  }
}
