import type { SelectionTarget } from "../generated/messages";
import type { InputKind } from "../input/input-kind";
import { element } from "./dom";

/** The page's controls that participants can select without pointing. */
const CONTROLS = "button, select";
/** Controls that participants need not select in a session. */
const OTHERS = "#watch, #entrance, #senses";

/**
 * The page's visible controls as targets. They are highlighted by dwell or scan, and are activated like with a click.
 *
 * A list goes to its next option.
 */
export class PageTargets {
  private controls: (HTMLButtonElement | HTMLSelectElement)[] = [];
  private hovered: Element | null = null;
  private shown: Element | null = null;
  private kind: InputKind = "trigger";
  private readonly ring = element("dwell-ring");

  constructor() {
    window.addEventListener("pointermove", ({ target, clientX, clientY }) => {
      this.hovered = target instanceof Element ? target.closest(CONTROLS) : null;
      this.ring.style.setProperty("--x", `${clientX}px`);
      this.ring.style.setProperty("--y", `${clientY}px`);
    });
    document.addEventListener("pointerleave", () => (this.hovered = null));
  }

  /** Highlights targets for this kind of input only. */
  use(kind: InputKind): void {
    this.kind = kind;
    if (!this.highlights) this.highlight(null, 0);
  }

  private get highlights(): boolean {
    return this.kind === "dwell" || this.kind === "scan" || this.kind === "step";
  }

  /** The visible and enabled controls now. */
  get offered(): SelectionTarget[] {
    const all = document.querySelectorAll<HTMLButtonElement | HTMLSelectElement>(`#card :is(${CONTROLS}), #stop`);
    this.controls = [...all].filter(
      (each) => !each.matches(":disabled") && !each.closest(OTHERS) && each.getClientRects().length > 0,
    );
    return this.controls.map((control, value) => ({ value, label: labelOf(control).slice(0, 256) }));
  }

  /** The control below the pointer, or null. */
  get pointed(): number | null {
    const at = this.controls.findIndex((control) => control === this.hovered);
    return at < 0 ? null : at;
  }

  highlight(value: number | null, progress: number): void {
    const control = this.highlights && value !== null ? (this.controls[value] ?? null) : null;
    this.ring.hidden = progress === 0 || control === null;
    this.ring.style.setProperty("--share", String(progress));
    if (control === this.shown) return;
    this.shown?.classList.remove("highlighted");
    this.shown = control;
    control?.classList.add("highlighted");
    control?.scrollIntoView({ block: "nearest" });
  }

  activate(value: number): void {
    const control = this.controls[value];
    if (!control) return;
    if (!(control instanceof HTMLSelectElement)) return control.click();
    control.selectedIndex = (control.selectedIndex + 1) % control.options.length;
    control.dispatchEvent(new Event("change"));
  }
}

function labelOf(control: HTMLButtonElement | HTMLSelectElement): string {
  if (control instanceof HTMLButtonElement) return control.textContent!.trim();
  return `${control.labels[0]?.querySelector("span")?.textContent ?? ""}: ${control.selectedOptions[0]?.text ?? ""}`;
}
