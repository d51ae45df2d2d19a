import type { FrameIntervals } from "../generated/messages";

const SEND_INTERVAL_MS = 1000;
/** Maximum number of intervals in a message. */
const MAX_INTERVALS = 512;

/** The properties of the device. */
export type Headset = Pick<FrameIntervals, "device" | "emulated" | "profiles" | "display_hz">;

/** Measures the intervals between frames during the headset check, for one message a second. */
export class FrameIntervalCollector {
  private lastMs = NaN;
  private sentMs = 0;
  private intervalsMs: number[] = [];

  /** Notes a frame; returns the message of the last second when it is due. */
  drawn(timeMs: number, headset: () => Headset): FrameIntervals | null {
    const intervalMs = timeMs - this.lastMs;
    this.lastMs = timeMs;
    if (!(intervalMs > 0)) {
      this.sentMs = timeMs;
      return null;
    }
    this.intervalsMs.push(intervalMs);
    if (timeMs < this.sentMs + SEND_INTERVAL_MS) return null;
    const intervals_ms = this.intervalsMs.slice(-MAX_INTERVALS);
    this.forget();
    this.lastMs = this.sentMs = timeMs;
    return { type: "headset_frames", ...headset(), intervals_ms };
  }

  /** Discards earlier frames. */
  forget(): void {
    this.lastMs = NaN;
    this.intervalsMs = [];
  }
}
