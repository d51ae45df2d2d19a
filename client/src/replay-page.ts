import { element } from "./element";
import { drawChart } from "./replay-chart";
import type { Clock } from "./replay-clock";
import { SPEEDS } from "./replay-clock";
import { latest, phasesOf, type Happening, type Timeline } from "./replay-data";

const STEP_S = 1;
const FRAME_S = 0.02;

/** The words, the time line and the keys of a replay. */
export class ReplayPage {
  readonly view = element("view");
  readonly card = element("card");
  private readonly slider = element<HTMLInputElement>("time");
  private readonly speed = element<HTMLSelectElement>("speed");
  private readonly inside = element<HTMLInputElement>("from-inside");
  private readonly entries: HTMLElement[];
  private readonly phases;
  private current = -1;

  constructor(
    private readonly timeline: Timeline,
    private readonly clock: Clock,
    private readonly viewChanged: (fromInside: boolean) => void,
  ) {
    this.phases = phasesOf(timeline);
    this.describe();
    drawChart(element("chart"), timeline);
    this.entries = timeline.happenings.map((happening) => this.entry(happening));
    element("happenings").append(...this.entries);
    this.speed.append(...SPEEDS.map((speed) => new Option(`${speed} ×`, String(speed))));
    this.listen();
  }

  /** Shows where the clock stands. */
  show(): void {
    const { timeS, playing, speed } = this.clock;
    this.slider.value = String(timeS);
    this.slider.setAttribute("aria-valuetext", `${timeS.toFixed(1)} seconds`);
    this.speed.value = String(speed);
    element("play").textContent = playing ? "Pause" : "Play";
    element("clock").textContent = `${timeS.toFixed(1)} / ${this.timeline.seconds.toFixed(1)} s`;
    element("now").style.left = `${(100 * timeS) / this.timeline.seconds}%`;
    this.showStep(timeS);
    this.markEntry(latest(this.timeline.happenings.map(({ time_s }) => time_s), timeS));
  }

  private describe(): void {
    const { title, simulated, complete, result, seconds } = this.timeline;
    document.title = `${title} – AVR Gym`;
    element("title").textContent = title;
    element("simulated").hidden = !simulated;
    element("result").textContent = complete
      ? `Recorded whole: ${result} after ${seconds.toFixed(1)}\u00a0s.`
      : `Not complete: the recording breaks off after ${seconds.toFixed(1)}\u00a0s.`;
    this.slider.max = String(seconds);
  }

  private showStep(timeS: number): void {
    const { steps } = this.timeline;
    const at = latest(steps.time_s, timeS);
    const given = (values: readonly number[], digits: number, unit: string) =>
      at < 0 ? "–" : `${values[at]!.toFixed(digits)}${unit}`;
    element("phase-name").textContent = this.phases.findLast(({ from }) => from <= timeS)?.name ?? "–";
    element("step").textContent = `${at + 1} of ${steps.time_s.length}`;
    element("reward").textContent = given(steps.reward, 1, "");
    element("force").textContent = given(steps.force_n, 1, " N");
    element("distance").textContent = given(steps.distance_m, 3, " m");
    element("success").textContent = at < 0 ? "–" : steps.success[at] ? "yes" : "not yet";
  }

  /** The latest of what has happened is marked and kept in sight. */
  private markEntry(at: number): void {
    if (at === this.current) return;
    this.entries[this.current]?.removeAttribute("aria-current");
    this.entries[at]?.setAttribute("aria-current", "true");
    const list = element("happenings");
    list.scrollTop = (this.entries[at]?.offsetTop ?? 0) - list.clientHeight / 2;
    this.current = at;
  }

  private entry({ time_s, kind, words }: Happening): HTMLElement {
    const button = document.createElement("button");
    button.type = "button";
    button.dataset["kind"] = kind === "event" || kind === "answer" ? kind : "phase";
    const time = document.createElement("span");
    time.textContent = `${time_s.toFixed(1)} s`;
    button.append(time, words);
    button.addEventListener("click", () => this.clock.seek(time_s));
    const item = document.createElement("li");
    item.append(button);
    return item;
  }

  private listen(): void {
    element("play").addEventListener("click", () => this.clock.toggle());
    this.slider.addEventListener("input", () => this.clock.seek(this.slider.valueAsNumber));
    this.speed.addEventListener("change", () => (this.clock.speed = Number(this.speed.value)));
    this.inside.addEventListener("change", () => this.viewChanged(this.inside.checked));
    document.addEventListener("keydown", (event) => this.key(event));
  }

  /** Keys that move through time go no further: the view would turn with them. */
  private key(event: KeyboardEvent): void {
    if (event.ctrlKey || event.altKey || event.metaKey || event.target === this.speed) return;
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
    Home: () => this.clock.seek(0),
    End: () => this.clock.seek(this.clock.endS),
    "+": () => this.clock.change(1),
    "-": () => this.clock.change(-1),
    v: () => this.inside.click(),
  };
}

/** Whether Space presses what has the focus. */
function isPressed(target: EventTarget | null): boolean {
  return target instanceof Element && target.closest("button, summary, input[type=checkbox]") !== null;
}
