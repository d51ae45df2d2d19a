import { blend, type Frame } from "../scene/state-interpolation";
import { latest } from "./replay-data";

/** All recorded poses of a trial, with interpolation. */
export class Frames {
  private readonly frames: Frame[];

  /** `poses` contains equally many numbers for each of the ascending `times`. */
  constructor(
    private readonly times: readonly number[],
    poses: Float32Array,
  ) {
    const size = poses.length / times.length;
    this.frames = times.map((timeS, at) => ({ timeS, poses: poses.subarray(at * size, (at + 1) * size) }));
  }

  /** Writes the poses at a time into `out`; outside the recording, those of the nearest frame. */
  sample(timeS: number, out: Float32Array): void {
    const at = latest(this.times, timeS);
    const before = this.frames[Math.max(at, 0)]!;
    const after = this.frames[at + 1];
    if (at < 0 || !after) out.set(before.poses);
    else blend(before, after, timeS, out);
  }
}
