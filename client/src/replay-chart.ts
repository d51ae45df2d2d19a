import { phasesOf, type Timeline } from "./replay-data";

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 1000;
const HEIGHT = 100;

/** The points of a line from values at times, in a box of 1000 × 100; low values lie low. */
export function points(times: readonly number[], values: readonly number[], endS: number): string {
  const low = Math.min(0, ...values);
  const span = Math.max(0, ...values) - low || 1;
  return times
    .map((timeS, at) => {
      const x = (WIDTH * timeS) / endS;
      const y = HEIGHT - 4 - ((HEIGHT - 8) * (values[at]! - low)) / span;
      return `${x.toFixed(1)},${y.toFixed(1)}`;
    })
    .join(" ");
}

/** Fills the chart above the time line: when the robot helped, the reward so far, the force on the person. */
export function drawChart(chart: Element, timeline: Timeline): void {
  const { steps, seconds } = timeline;
  const helped = phasesOf(timeline).filter(({ name }) => name === "trial");
  chart.replaceChildren(
    ...helped.map(({ from, to }) => band((WIDTH * from) / seconds, (WIDTH * (to - from)) / seconds)),
    line("force", points(steps.time_s, steps.force_n, seconds)),
    line("reward", points(steps.time_s, steps.reward, seconds)),
  );
}

function band(x: number, width: number): Element {
  return element("rect", { class: "helped", x, y: 0, width, height: HEIGHT });
}

function line(name: string, at: string): Element {
  return element("polyline", { class: name, points: at });
}

function element(name: string, attributes: Record<string, string | number>): Element {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}
