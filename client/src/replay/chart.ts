import type { Span } from "./replay-clock";
import { helpOf, type Timeline } from "./replay-data";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 1000;
const HEIGHT = 100;

/** The range of a chart's values, including 0. */
export type Range = readonly [low: number, high: number];

export function rangeOf(values: readonly number[]): Range {
  return [Math.min(0, ...values), Math.max(0, ...values)];
}

/** The horizontal position of a time within a part, as a share. */
function across(timeS: number, { from, to }: Span): number {
  return (WIDTH * (timeS - from)) / (to - from);
}

/** The points of a line in a box of 1000 × 100; low values are at the bottom. */
export function points(
  times: readonly number[],
  values: readonly number[],
  part: Span,
  [low, high]: Range,
): string {
  const span = high - low || 1;
  return times
    .map((timeS, at) => {
      const y = HEIGHT - 4 - ((HEIGHT - 8) * (values[at]! - low)) / span;
      return `${across(timeS, part).toFixed(1)},${y.toFixed(1)}`;
    })
    .join(" ");
}

/** The spans of time in which the success criterion was met. */
export function successes({ steps }: Timeline, endS: number): Span[] {
  const begins = steps.success.flatMap((now, at) => (now && !steps.success[at - 1] ? [at] : []));
  return begins.map((at) => {
    const end = steps.success.indexOf(false, at);
    return { from: steps.time_s[at]!, to: end < 0 ? endS : steps.time_s[end]! };
  });
}

/** One chart for each trial on a common scale: reward, force, success, robot phase and events. */
export function drawCharts(timelines: readonly Timeline[], part: Span): Element[] {
  const reward = rangeOf(timelines.flatMap(({ steps }) => steps.reward));
  const force = rangeOf(timelines.flatMap(({ steps }) => steps.force_n));
  return timelines.map((timeline) => {
    const { steps, seconds, events } = timeline;
    const marks = events.filter(({ kind }) => kind === "event" || kind === "answer");
    const spread = (name: string, { from, to }: Span, height: number) =>
      band(name, across(from, part), across(to, part), height);
    return svg("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, preserveAspectRatio: "none" }, [
      ...helpOf(timeline).map((helped) => spread("helped", helped, HEIGHT)),
      ...successes(timeline, seconds).map((success) => spread("success", success, 8)),
      ...marks.map(({ kind, time_s }) => mark(kind, across(time_s, part))),
      line("force", points(steps.time_s, steps.force_n, part, force)),
      line("reward", points(steps.time_s, steps.reward, part, reward)),
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
