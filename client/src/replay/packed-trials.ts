import type { Replayed, Timeline } from "./replay-data";

/** The data of a page in one file: deflated and base64-encoded. */
export interface Packed {
  /** The step of the quantised poses. */
  step: number;
  trials: { timeline: Timeline; poses: string }[];
  /** GLB files by their address in the timelines. */
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
 * Decodes the poses of all frames, frame by frame.
 *
 * `planes` contains the lowest bytes of all numbers, then the second ones, up to the fourth. The numbers are
 * differences between frames in multiples of `step`: all of a frame's first number, then all of the second.
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
