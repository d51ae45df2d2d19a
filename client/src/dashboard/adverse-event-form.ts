import { localTime } from "./tables";
import type { AdverseEvent, Report, Trial } from "./study-api";

const NEW = "";

/** The form for adverse events: a new event, or a follow-up with the present report filled in. */
export class AdverseEventForm {
  private events: AdverseEvent[] = [];

  constructor(private readonly form: HTMLFormElement) {
    this.select("follows").addEventListener("change", () => this.begin());
    form.addEventListener("reset", () => setTimeout(() => this.begin()));
  }

  /** Sets the grades of each scale. */
  offerScales(scales: Record<string, string[]>): void {
    for (const [name, grades] of Object.entries(scales)) {
      this.offer(name, [["", "Choose"], ...grades.map((grade): [string, string] => [grade, grade])]);
    }
  }

  /** Sets the participant's events for follow-ups, and their trials. */
  offerEvents(events: AdverseEvent[], trials: Trial[]): void {
    this.events = events;
    this.offer("follows", [
      [NEW, "A new event"],
      ...events.map(({ number }): [string, string] => [String(number), `Follow-up of event ${number}`]),
    ]);
    this.offer("trial", [
      ["", "Outside trials"],
      ...trials.map(({ position }): [string, string] => [String(position), String(position)]),
    ]);
    if (!this.field("began_at").value) this.begin();
  }

  /** The report to store. */
  body(): { report: Report; follows: number | null } {
    const text = (name: string) => this.field(name).value.trim();
    const number = (name: string) => (text(name) ? Number(text(name)) : null);
    const report = {
      began_at: new Date(text("began_at")).toISOString(),
      trial: number("trial"),
      description: text("description"),
      severity: text("severity"),
      seriousness: text("seriousness"),
      relatedness: text("relatedness"),
      action: text("action"),
      outcome: text("outcome"),
    };
    return { report, follows: number("follows") };
  }

  /** Fills in the present report of the chosen event; a new event begins now. */
  private begin(): void {
    const chosen = this.events.find(({ number }) => String(number) === this.select("follows").value);
    if (chosen) {
      for (const [name, value] of Object.entries(chosen.report)) this.field(name).value = String(value ?? "");
    }
    this.field("began_at").value = localTime(chosen?.report.began_at ?? new Date().toISOString());
  }

  private offer(name: string, options: [string, string][]): void {
    const select = this.select(name);
    const chosen = select.value;
    const offered = [...select.options].map(({ value, text }) => [value, text]);
    if (JSON.stringify(offered) === JSON.stringify(options)) return;
    select.replaceChildren(...options.map(([value, text]) => new Option(text, value)));
    if (options.some(([value]) => value === chosen)) select.value = chosen;
  }

  private select(name: string): HTMLSelectElement {
    return this.form.elements.namedItem(name) as HTMLSelectElement;
  }

  private field(name: string): HTMLInputElement {
    return this.form.elements.namedItem(name) as HTMLInputElement;
  }
}
