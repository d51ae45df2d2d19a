import type { InputProfileMessage } from "../generated/messages";
import { switchOfButton, switchOfKey, type Switch } from "./input-profile";

/** Listens to the participant's switches: keys, and buttons of gamepads. Repeated and held presses count once. */
export class Switches {
  private readonly held = new Set<string>();

  constructor(
    private readonly profile: () => InputProfileMessage,
    private readonly pressed: (which: Switch) => void,
  ) {
    window.addEventListener("keydown", (event) => this.onKey(event), { capture: true });
    window.addEventListener("keyup", ({ code }) => this.held.delete(code), { capture: true });
    window.addEventListener("blur", () => this.held.clear());
  }

  /** Whether the profile has switches. Their presses then mean nothing else. */
  get used(): boolean {
    return switchOfKey(this.profile(), { key: "", code: "" }) !== null;
  }

  /** Checks the gamepads; call it in every frame. */
  poll(): void {
    if (!this.used) return;
    for (const pad of navigator.getGamepads?.() ?? [])
      pad?.buttons.forEach(({ pressed }, index) => this.onButton(`${pad.index} ${index}`, pressed, index));
  }

  private onKey(event: KeyboardEvent): void {
    const which = switchOfKey(this.profile(), event);
    if (!which || event.ctrlKey || event.altKey || event.metaKey || isWriting(event.target)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.repeat || this.held.has(event.code)) return;
    this.held.add(event.code);
    this.pressed(which);
  }

  private onButton(name: string, pressed: boolean, index: number): void {
    if (pressed && !this.held.has(name)) this.pressed(switchOfButton(this.profile(), index));
    if (pressed) this.held.add(name);
    else this.held.delete(name);
  }
}

function isWriting(target: EventTarget | null): boolean {
  return target instanceof HTMLElement && target.closest("input:not([type=range], [type=checkbox]), textarea") !== null;
}
