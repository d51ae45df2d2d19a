import type { Replayed, Timeline } from "./replay-data";

/** Trials as a page in one file holds them; what is packed is deflated and in base64. */
export interface Packed {
  /** What the numbers of the poses are multiples of. */
  step: number;
  trials: { timeline: Timeline; poses: string }[];
  /** GLB files by the addresses that the timelines name. */
  scenes: Record<string, string>;
}

export async function unpack({ step, trials, scenes }: Packed): Promise<Replayed[]> {
  return Promise.all(
    trials.map(async ({ timeline, poses }) => ({
      timeline,
      poses: unpackPoses(new Uint8Array(await inflate(poses)), timeline.frames_s.length, step),
      glb: inflate(scenes[timeline.scene.url]!),
    })),
  );
}

async function inflate(base64: string): Promise<ArrayBuffer> {
  const packed = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/**
 * The poses of so many frames, one frame after another.
 *
 * `planes` holds the lowest bytes of all numbers, then the next ones, up to the fourth. The numbers are differences
 * from frame to frame in multiples of `step`: first all of the first number of a frame, then all of the second.
 */
export function unpackPoses(planes: Uint8Array, frames: number, step: number): Float32Array {
  const count = planes.length / 4;
  const size = count / frames;
  const poses = new Float32Array(count);
  for (let number = 0; number < size; number++) {
    let multiple = 0;
    for (let frame = 0; frame < frames; frame++) {
      multiple += assemble(planes, number * frames + frame, count);
      poses[frame * size + number] = multiple * step;
    }
  }
  return poses;
}

function assemble(planes: Uint8Array, at: number, count: number): number {
  return (
    planes[at]! | (planes[at + count]! << 8) | (planes[at + 2 * count]! << 16) | (planes[at + 3 * count]! << 24)
  );
}
