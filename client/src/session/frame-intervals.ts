import type { HeadsetFrames } from "../generated/messages";

const SEND_INTERVAL_MS = 1000;
/** What one message holds. */
const MAX_INTERVALS = 512;

/** What frames are drawn on. */
export type Headset = Pick<HeadsetFrames, "device" | "emulated" | "profiles" | "display_hz">;

/** Notes when frames are drawn while the headset is checked, to tell it once a second. */
export class FrameIntervals {
  private lastMs = NaN;
  private sentMs = 0;
  private intervalsMs: number[] = [];

  /** A frame is drawn; what to tell of those of the last second, when that is due. */
  drawn(timeMs: number, headset: () => Headset): HeadsetFrames | null {
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

  /** What was drawn before tells nothing of what comes. */
  forget(): void {
    this.lastMs = NaN;
    this.intervalsMs = [];
  }
}
