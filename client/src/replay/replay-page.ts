import { createElement, element } from "../page/dom";
import { drawCharts } from "./chart";
import { SPEEDS, type Clock, type Span } from "./replay-clock";
import { latest, robotsPart, type Timeline } from "./replay-data";
import {
  description,
  timelineEntries,
  figures,
  labels,
  simulatedText,
  type Entry,
} from "./replay-texts";

const STEP_S = 1;
const FRAME_S = 0.02;

/** The texts, timeline and keys of a replay. */
export class ReplayPage {
  readonly card = element("card");
  /** The container of each trial's view. */
  readonly holders: HTMLElement[];
  private readonly slider = element<HTMLInputElement>("time");
  private readonly speed = element<HTMLSelectElement>("speed");
  private readonly inside = element<HTMLInputElement>("from-inside");
  private readonly robotOnly = element<HTMLInputElement>("robot-only");
  private readonly whole: Span;
  private readonly robotsPart: Span | null;
  private charts: Element[] = [];
  private readonly labels: string[];
  private readonly happened: Entry[];
  private readonly entries: HTMLElement[];
  private readonly cells: Map<string, HTMLElement>[];
  private current = -1;

  constructor(
    private readonly timelines: readonly Timeline[],
    private readonly clock: Clock,
    private readonly viewChanged: (firstPerson: boolean) => void,
  ) {
    this.labels = labels(timelines.length);
    this.whole = clock.part;
    this.robotsPart = robotsPart(timelines);
    this.holders = timelines.map((_, at) => this.holder(at));
    this.describe();
    this.cells = timelines.map((timeline) => addColumn(figures(timeline, 0)));
    this.happened = timelineEntries(timelines);
    this.entries = this.happened.map((entry) => this.entry(entry));
    element("events").append(...this.entries);
    this.speed.append(...SPEEDS.map((speed) => new Option(`${speed} ×`, String(speed))));
    element("robot-choice").hidden = this.robotsPart === null;
    this.showPart(this.whole);
    this.listen();
  }

  /** Shows the time of the clock. */
  show(): void {
    const { timeS, playing, speed, part } = this.clock;
    const passedS = timeS - part.from;
    const lastsS = part.to - part.from;
    this.slider.value = String(timeS);
    this.slider.setAttribute("aria-valuetext", `${passedS.toFixed(1)} seconds`);
    this.speed.value = String(speed);
    element("play").textContent = playing ? "Pause" : "Play";
    element("clock").textContent = `${passedS.toFixed(1)} / ${lastsS.toFixed(1)} s`;
    element("now").style.left = `${(100 * passedS) / lastsS}%`;
    this.timelines.forEach((timeline, at) => {
      for (const [row, text] of Object.entries(figures(timeline, timeS))) {
        this.cells[at]!.get(row)!.textContent = text;
      }
    });
    this.markEntry(latest(this.happened.map(({ time_s }) => time_s), timeS));
  }

  private describe(): void {
    const { timelines, labels } = this;
    document.title = `${timelines.map(({ title }) => title).join(" | ")} – AVR Gym`;
    document.body.classList.toggle("comparing", timelines.length > 1);
    element("title").append(...timelines.flatMap((timeline, at) => description(timeline, labels[at]!)));
    const simulated = simulatedText(timelines);
    element("simulated").textContent = simulated;
    element("simulated").hidden = !simulated;
    for (const label of labels) element("columns").append(headingCell(label));
    element("columns").hidden = timelines.length < 2;
  }

  /** Restricts the timeline to a part. */
  private showPart(part: Span): void {
    this.clock.confine(part);
    for (const chart of this.charts) chart.remove();
    this.charts = drawCharts(this.timelines, part);
    element("charts").prepend(...this.charts);
    Object.assign(this.slider, { min: part.from, max: part.to });
    this.happened.forEach(({ time_s }, at) => {
      const entry = this.entries[at]!;
      entry.hidden = time_s < part.from || time_s > part.to;
      entry.querySelector("span")!.textContent = `${(time_s - part.from).toFixed(1)} s`;
    });
  }

  private holder(at: number): HTMLElement {
    const holder = createElement("div");
    holder.role = "img";
    holder.dataset["label"] = this.labels[at]!;
    element("view").append(holder);
    return holder;
  }

  /** Marks the latest entry and scrolls to it. */
  private markEntry(at: number): void {
    if (at === this.current) return;
    this.entries[this.current]?.removeAttribute("aria-current");
    this.entries[at]?.setAttribute("aria-current", "true");
    const list = element("events");
    list.scrollTop = (this.entries[at]?.offsetTop ?? 0) - list.clientHeight / 2;
    this.current = at;
  }

  private entry({ time_s, kind, text, label }: Entry): HTMLElement {
    const button = createElement("button");
    button.type = "button";
    button.dataset["kind"] = kind === "event" || kind === "answer" ? kind : "phase";
    button.append(createElement("span"), label ? `${label}: ${text}` : text);
    button.addEventListener("click", () => this.clock.seek(time_s));
    const item = createElement("li");
    item.append(button);
    return item;
  }

  private listen(): void {
    element("play").addEventListener("click", () => this.clock.toggle());
    this.slider.addEventListener("input", () => this.clock.seek(this.slider.valueAsNumber));
    this.speed.addEventListener("change", () => (this.clock.speed = Number(this.speed.value)));
    this.inside.addEventListener("change", () => this.viewChanged(this.inside.checked));
    this.robotOnly.addEventListener("change", () =>
      this.showPart(this.robotOnly.checked && this.robotsPart ? this.robotsPart : this.whole),
    );
    document.addEventListener("keydown", (event) => this.key(event));
  }

  /** Handles keys for playback. They do not reach the view, which uses Shift and arrow keys. */
  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target === this.speed) return;
    if (event.shiftKey && event.key.startsWith("Arrow")) return;
    if (event.key === " " && isPressed(event.target)) return;
    const action = this.actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    event.stopPropagation();
    action();
  }

  private readonly actions: Record<string, () => void> = {
    " ": () => this.clock.toggle(),
    ArrowLeft: () => this.clock.seek(this.clock.timeS - STEP_S),
    ArrowRight: () => this.clock.seek(this.clock.timeS + STEP_S),
    ",": () => this.clock.seek(this.clock.timeS - FRAME_S),
    ".": () => this.clock.seek(this.clock.timeS + FRAME_S),
    Home: () => this.clock.seek(this.clock.part.from),
    End: () => this.clock.seek(this.clock.part.to),
    "+": () => this.clock.change(1),
    "-": () => this.clock.change(-1),
    v: () => this.inside.click(),
    r: () => this.robotOnly.click(),
  };
}

/** Whether Space activates the focused element. */
function isPressed(target: EventTarget | null): boolean {
  return target instanceof Element && target.closest("button, summary, input[type=checkbox]") !== null;
}

/** Adds a cell to each row of the table of values. */
function addColumn(values: Record<string, string>): Map<string, HTMLElement> {
  const cells = new Map(Object.keys(values).map((row) => [row, createElement("td")]));
  for (const [row, cell] of cells) element(row).append(cell);
  return cells;
}

function headingCell(label: string): HTMLElement {
  const cell = createElement("th", label);
  cell.scope = "col";
  return cell;
}
