import { CONTROLLERS } from "../input/input-profile";
import { element } from "../page/dom";
import type { InputProfile } from "./study-api";

const STOP_TEXTS: Readonly<Record<string, string>> = {
  buttons: "buttons of a controller",
  palm: "a raised palm",
  gaze: "a look at the stop sign",
  switch: "a switch",
  experimenter: "a signal to the experimenter",
};

/** Font sizes in VR relative to those of items; see `paint-panel.ts`. */
const FONT_SIZES = { Instructions: 84 / 72, items: 1, "other texts and buttons up to": 64 / 72 };
const NUMBERS = ["text_deg", "panel_distance_m"] as const;
const CHOICES = ["contrast", "position"] as const;
const SWITCHES = ["reduced_motion", "read_aloud", "captions"] as const;

/** The font sizes in VR in words, from that of items in degrees. */
export function fontSizes(itemDeg: number): string {
  const sizes = Object.entries(FONT_SIZES).map(([name, share]) => `${name} ${(share * itemDeg).toFixed(1)}°`);
  return `${sizes.join(", ")}.`;
}

/** The fields of a form for a participant's input profile. A new form shows the default profile. */
export class InputFields {
  private stops: Readonly<Record<string, string[]>> = {};
  private shown = "";

  /** Adds the fields to a form. */
  constructor(private readonly form: HTMLFormElement) {
    const fields = element<HTMLTemplateElement>("input-template").content.cloneNode(true);
    form.querySelector(".input-fields")!.append(fields);
    this.part("font-sizes").id = `${form.id}-font-sizes`;
    this.field("text_deg").setAttribute("aria-describedby", this.part("font-sizes").id);
    this.field("text_deg").addEventListener("input", () => this.showFontSizes());
    this.method.addEventListener("change", () => this.changeMethod());
    form.addEventListener("reset", () => setTimeout(() => this.showDefaults()));
    form.addEventListener("invalid", ({ target }) => showField(target as Element), true);
    this.showDefaults();
  }

  /** Sets the ways to stop of each method. */
  offer(stops: Readonly<Record<string, string[]>>): void {
    const isFirst = Object.keys(this.stops).length === 0;
    this.stops = stops;
    if (isFirst) this.changeMethod();
  }

  private showDefaults(): void {
    this.fill(CONTROLLERS);
    this.shown = "";
  }

  /** Fills in a profile, unless it is shown already. */
  show(profile: InputProfile, participant: string): void {
    const key = JSON.stringify([profile, participant]);
    if (key === this.shown) return;
    this.shown = key;
    this.fill(profile);
  }

  private fill(profile: InputProfile): void {
    for (const name of ["method", "dwell_s", "scan_s", "select_key"] as const) this.field(name).value = String(profile[name]);
    for (const name of ["resting_arms", "absent_arms"] as const)
      for (const box of this.boxes(name)) box.checked = profile[name].includes(box.value as "left" | "right");
    this.showDurations();
    this.offerStops(profile.stops ?? []);
    const { presentation } = profile;
    for (const name of [...NUMBERS, ...CHOICES]) this.field(name).value = String(presentation[name]);
    for (const name of SWITCHES) this.field(name).checked = presentation[name];
    this.showFontSizes();
  }

  /** The profile in the form. */
  profile(): object {
    return {
      method: this.method.value,
      dwell_s: Number(this.field("dwell_s").value),
      scan_s: Number(this.field("scan_s").value),
      select_key: this.field("select_key").value,
      resting_arms: this.checked("resting_arms"),
      absent_arms: this.checked("absent_arms"),
      stops: this.checked("stops"),
      presentation: Object.fromEntries([
        ...NUMBERS.map((name) => [name, Number(this.field(name).value)]),
        ...CHOICES.map((name) => [name, this.field(name).value]),
        ...SWITCHES.map((name) => [name, this.field(name).checked]),
      ]),
    };
  }

  private showFontSizes(): void {
    this.part("font-sizes").textContent = fontSizes(Number(this.field("text_deg").value));
  }

  private changeMethod(): void {
    this.showDurations();
    const possible = this.stops[this.method.value] ?? [];
    this.offerStops(this.method.value === "experimenter" ? possible : possible.slice(0, 1));
  }

  /** Shows the fields of the chosen method only. */
  private showDurations(): void {
    for (const label of this.form.querySelectorAll<HTMLElement>("[data-method]"))
      label.hidden = label.dataset["method"] !== this.method.value;
  }

  private offerStops(chosen: readonly string[]): void {
    const choices = (this.stops[this.method.value] ?? []).map((way) => choice(way, chosen.includes(way)));
    const group = this.part("stops");
    group.replaceChildren(group.querySelector("legend")!, ...choices);
  }

  private checked(name: string): string[] {
    return this.boxes(name).filter(({ checked }) => checked).map(({ value }) => value);
  }

  private boxes(name: string): HTMLInputElement[] {
    return [...this.form.querySelectorAll<HTMLInputElement>(`input[name=${name}]`)];
  }

  private part(name: string): HTMLElement {
    return this.form.querySelector<HTMLElement>(`[data-part=${name}]`)!;
  }

  private get method(): HTMLSelectElement {
    return this.form.elements.namedItem("method") as HTMLSelectElement;
  }

  private field(name: string): HTMLInputElement {
    return this.form.elements.namedItem(name) as HTMLInputElement;
  }
}

function choice(value: string, checked: boolean): HTMLLabelElement {
  const label = document.createElement("label");
  label.className = "choice";
  const box = document.createElement("input");
  Object.assign(box, { type: "checkbox", name: "stops", value, checked });
  const words = document.createElement("span");
  words.textContent = STOP_TEXTS[value] ?? value;
  label.append(box, words);
  return label;
}

/** Opens the folded part of a form that contains a field. */
function showField(field: Element): void {
  const folded = field.closest("details");
  if (folded) folded.open = true;
}
