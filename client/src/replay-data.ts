import type { Scene } from "./messages";

/** The control steps, one entry each: when they ended, the reward so far, and what they gave. */
export interface Steps {
  time_s: number[];
  reward: number[];
  force_n: number[];
  distance_m: number[];
  success: boolean[];
}

/** A phase that begins, an event or an answer, in words. */
export interface Happening {
  time_s: number;
  kind: string;
  words: string;
}

/** A recorded trial as the server tells it; times count from its beginning. */
export interface Timeline {
  title: string;
  simulated: boolean;
  complete: boolean;
  result: string | null;
  seconds: number;
  scene: Scene;
  frames_s: number[];
  steps: Steps;
  happenings: Happening[];
}

/** The timeline, and the poses of its frames one after another. */
export async function loadReplay(token: string): Promise<[Timeline, Float32Array]> {
  const headers = { Authorization: `Bearer ${token}` };
  const [timeline, poses] = await Promise.all(
    ["timeline", "poses"].map(async (path) => {
      const response = await fetch(path, { headers });
      if (!response.ok) throw new Error(`the server answered ${response.status}`);
      return response;
    }),
  );
  return [(await timeline!.json()) as Timeline, new Float32Array(await poses!.arrayBuffer())];
}

/** The index of the last of ascending times that is not after `timeS`; -1 before the first. */
export function latest(times: readonly number[], timeS: number): number {
  let low = 0;
  let high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle]! <= timeS) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** The names of the phases with the times that each begins and ends at. */
export function phasesOf({ happenings, seconds }: Timeline): { name: string; from: number; to: number }[] {
  const entered = happenings.filter(({ kind }) => kind !== "event" && kind !== "answer");
  return entered.map(({ words, time_s }, at) => ({
    name: words,
    from: time_s,
    to: entered[at + 1]?.time_s ?? seconds,
  }));
}
