import { phasesOf, type Timeline } from "./replay-data";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 1000;
const HEIGHT = 100;

/** From the lowest to the highest value that a chart shows, nought included. */
export type Range = readonly [low: number, high: number];

export function rangeOf(values: readonly number[]): Range {
  return [Math.min(0, ...values), Math.max(0, ...values)];
}

/** The points of a line from values at times, in a box of 1000 × 100; low values lie low. */
export function points(
  times: readonly number[],
  values: readonly number[],
  endS: number,
  [low, high]: Range,
): string {
  const span = high - low || 1;
  return times
    .map((timeS, at) => {
      const x = (WIDTH * timeS) / endS;
      const y = HEIGHT - 4 - ((HEIGHT - 8) * (values[at]! - low)) / span;
      return `${x.toFixed(1)},${y.toFixed(1)}`;
    })
    .join(" ");
}

/** When the robot had succeeded: from one control step to where a later one says otherwise, or to the end. */
export function successes({ steps }: Timeline, endS: number): { from: number; to: number }[] {
  const begins = steps.success.flatMap((now, at) => (now && !steps.success[at - 1] ? [at] : []));
  return begins.map((at) => {
    const end = steps.success.indexOf(false, at);
    return { from: steps.time_s[at]!, to: end < 0 ? endS : steps.time_s[end]! };
  });
}

/** One chart for each trial, all of one scale: reward so far, force, success, the robot's help, and what happened. */
export function drawCharts(timelines: readonly Timeline[], endS: number): Element[] {
  const reward = rangeOf(timelines.flatMap(({ steps }) => steps.reward));
  const force = rangeOf(timelines.flatMap(({ steps }) => steps.force_n));
  return timelines.map((timeline) => {
    const { steps, seconds, happenings } = timeline;
    const helped = phasesOf(timeline).filter(({ name }) => name === "trial");
    const marks = happenings.filter(({ kind }) => kind === "event" || kind === "answer");
    const across = (timeS: number) => (WIDTH * timeS) / endS;
    return svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none" }, [
      ...helped.map(({ from, to }) => band("helped", across(from), across(to), HEIGHT)),
      ...successes(timeline, seconds).map(({ from, to }) => band("success", across(from), across(to), 8)),
      ...marks.map(({ kind, time_s }) => mark(kind, across(time_s))),
      line("force", points(steps.time_s, steps.force_n, endS, force)),
      line("reward", points(steps.time_s, steps.reward, endS, reward)),
    ]);
  });
}

function band(name: string, x: number, end: number, height: number): Element {
  return svg("rect", { class: name, x, y: 0, width: end - x, height });
}

function mark(kind: string, x: number): Element {
  return svg("line", { class: kind, x1: x, x2: x, y1: 0, y2: HEIGHT });
}

function line(name: string, at: string): Element {
  return svg("polyline", { class: name, points: at });
}

function svg(name: string, attributes: Record<string, string | number>, within: Element[] = []): Element {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  made.append(...within);
  return made;
}
