/** The seconds that are left of a phase, in whole numbers. */
export class Countdown {
  secondsLeft: number | null = null;
  private endsMs = Infinity;

  /** Begins with a phase of so many seconds; null: it has no end. */
  begin(seconds: number | null, nowMs: number): void {
    this.endsMs = seconds === null ? Infinity : nowMs + seconds * 1000;
    this.secondsLeft = this.secondsUntilEnd(nowMs);
  }

  /** Whether another number is shown than before. */
  advance(nowMs: number): boolean {
    const before = this.secondsLeft;
    this.secondsLeft = this.secondsUntilEnd(nowMs);
    return this.secondsLeft !== before;
  }

  private secondsUntilEnd(nowMs: number): number | null {
    return this.endsMs > nowMs && this.endsMs < Infinity ? Math.ceil((this.endsMs - nowMs) / 1000) : null;
  }
}
