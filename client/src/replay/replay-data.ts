import { element, fetchBytes } from "../page/dom";
import type { Scene } from "../generated/messages";
import type { Span } from "./replay-clock";
import { unpack, type Packed } from "./packed-trials";

/** Columns of the control steps: end times, reward so far, and results. */
export interface Steps {
  time_s: number[];
  reward: number[];
  force_n: number[];
  distance_m: number[];
  success: boolean[];
}

/** The start of a phase, an event or an answer, as text. */
export interface TimelineEvent {
  time_s: number;
  kind: string;
  text: string;
}

/** A recorded trial; times are relative to its start. */
export interface Timeline {
  title: string;
  simulated: boolean;
  complete: boolean;
  result: string | null;
  seconds: number;
  /** Further information by heading. */
  facts: Record<string, string>;
  scene: Scene;
  frames_s: number[];
  steps: Steps;
  events: TimelineEvent[];
}

/** A trial with the poses of its frames and the file of its scene. */
export interface Replayed {
  timeline: Timeline;
  poses: Float32Array;
  glb: Promise<ArrayBuffer>;
}

/** The trials that the page contains, or else that of its server. */
export async function loadReplays(token: string): Promise<Replayed[]> {
  const written = element("recorded").textContent;
  return written ? unpack(JSON.parse(written) as Packed) : [await fetchReplay(token)];
}

async function fetchReplay(token: string): Promise<Replayed> {
  const [told, poses] = await Promise.all(["timeline", "poses"].map((path) => fetchBytes(path, token)));
  const timeline = JSON.parse(new TextDecoder().decode(told)) as Timeline;
  return { timeline, poses: new Float32Array(poses!), glb: fetchBytes(timeline.scene.url, token) };
}

/** The index of the last of ascending times up to `timeS`; −1 before the first. */
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

/** Names, starts and ends of the phases. */
export function phasesOf({ events, seconds }: Timeline): (Span & { name: string })[] {
  const entered = events.filter(({ kind }) => kind !== "event" && kind !== "answer");
  return entered.map(({ text, time_s }, at) => ({
    name: text,
    from: time_s,
    to: entered[at + 1]?.time_s ?? seconds,
  }));
}

/** The spans in which the robot acts. */
export function helpOf(timeline: Timeline): Span[] {
  return phasesOf(timeline).filter(({ name }) => name === "trial");
}

/** The span from the first start to the last end of the robot's phase in these trials; null without any. */
export function robotsPart(timelines: readonly Timeline[]): Span | null {
  const helped = timelines.flatMap(helpOf);
  if (helped.length === 0) return null;
  return { from: Math.min(...helped.map(({ from }) => from)), to: Math.max(...helped.map(({ to }) => to)) };
}
