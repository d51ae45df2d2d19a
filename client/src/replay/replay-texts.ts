import { createElement } from "../page/dom";
import { latest, phasesOf, type TimelineEvent, type Timeline } from "./replay-data";

/** Labels of compared trials; empty for a single one. */
export function labels(count: number): string[] {
  return count < 2 ? [""] : ["A", "B"];
}

/** The title, end and facts of a trial. */
export function description(timeline: Timeline, label: string): Node[] {
  const { title, complete, result, seconds, facts } = timeline;
  const length = `${seconds.toFixed(1)}\u00a0s`;
  const ending = complete
    ? `Complete recording: ${result} after ${length}.`
    : `Incomplete recording: it ends after ${length}.`;
  const list = createElement("dl");
  for (const [name, words] of Object.entries(facts)) list.append(createElement("dt", name), createElement("dd", words));
  const more = createElement("details");
  more.append(createElement("summary", label ? `About trial ${label}` : "About this trial"), list);
  const heading = createElement("p", label ? `${label}: ${title}` : title);
  heading.className = "subtitle";
  return [heading, createElement("p", ending), more];
}

/** Which trials have simulated participants, as text; empty if none has. */
export function simulatedText(timelines: readonly Timeline[]): string {
  const named = labels(timelines.length).filter((_, at) => timelines[at]!.simulated);
  if (named.length === timelines.length) {
    return named.length > 1 ? "Simulated participants" : "Simulated participant";
  }
  return named.map((label) => `${label}: simulated participant`).join();
}

/** The values of a trial at a time, by the ids of the table's rows. */
export function figures(timeline: Timeline, timeS: number): Record<string, string> {
  const { steps } = timeline;
  const at = latest(steps.time_s, timeS);
  const given = (values: readonly number[], digits: number, unit: string) =>
    at < 0 ? "–" : `${values[at]!.toFixed(digits)}${unit}`;
  return {
    "phase-name": phasesOf(timeline).findLast(({ from }) => from <= timeS)?.name ?? "–",
    step: `${at + 1} of ${steps.time_s.length}`,
    reward: given(steps.reward, 1, ""),
    force: given(steps.force_n, 1, " N"),
    distance: given(steps.distance_m, 3, " m"),
    success: at < 0 ? "–" : steps.success[at] ? "yes" : "not yet",
  };
}

/** A row of the list of events. */
export interface Entry extends TimelineEvent {
  label: string;
}

/** The events of all trials, sorted by time. */
export function timelineEntries(timelines: readonly Timeline[]): Entry[] {
  const named = labels(timelines.length);
  return timelines
    .flatMap(({ events }, at) => events.map((event) => ({ ...event, label: named[at]! })))
    .sort((one, other) => one.time_s - other.time_s);
}
