import type { VelocityCommand, OperatorRole, SessionStatus } from "../generated/messages";

const EVERY_MS = 50;
const DEAD_ZONE = 0.15;

type Axis = [vector: "linear" | "angular", index: 0 | 1 | 2, sign: 1 | -1];

/** Axis of motion by key code. */
const KEYS: Record<string, Axis> = {
  KeyW: ["linear", 0, 1],
  KeyS: ["linear", 0, -1],
  KeyA: ["linear", 1, 1],
  KeyD: ["linear", 1, -1],
  KeyE: ["linear", 2, 1],
  KeyQ: ["linear", 2, -1],
  KeyX: ["angular", 0, 1],
  KeyZ: ["angular", 0, -1],
  ArrowDown: ["angular", 1, 1],
  ArrowUp: ["angular", 1, -1],
  ArrowLeft: ["angular", 2, 1],
  ArrowRight: ["angular", 2, -1],
};
const ENABLING_KEY = "Space";

const STICKS: [axis: number, ...Axis][] = [
  [1, "linear", 0, -1],
  [0, "linear", 1, -1],
  [3, "linear", 2, -1],
  [2, "angular", 2, -1],
];
const BUTTONS: [button: number, ...Axis][] = [
  [7, "angular", 0, 1],
  [6, "angular", 0, -1],
  [13, "angular", 1, 1],
  [12, "angular", 1, -1],
];
const SHOULDERS = [4, 5];

const RELEASED: VelocityCommand = { type: "drive", engaged: false, linear: [0, 0, 0], angular: [0, 0, 0], source: "operator" };

/** The velocity command of pressed keys. */
export function keyboardCommand(held: ReadonlySet<string>): VelocityCommand {
  const command = structuredClone(RELEASED);
  for (const key of held) add(command, KEYS[key], 1);
  return { ...command, engaged: held.has(ENABLING_KEY) };
}

/** The velocity command of a gamepad: sticks and triggers, enabled by a shoulder button. */
export function gamepadCommand({ axes, buttons }: Pick<Gamepad, "axes" | "buttons">): VelocityCommand {
  const command = structuredClone(RELEASED);
  for (const [stick, ...axis] of STICKS) add(command, axis, beyondDeadZone(axes[stick] ?? 0));
  for (const [button, ...axis] of BUTTONS) add(command, axis, buttons[button]?.value ?? 0);
  return { ...command, engaged: SHOULDERS.some((button) => buttons[button]?.pressed) };
}

function add(command: VelocityCommand, axis: Axis | undefined, amount: number): void {
  if (!axis) return;
  const [vector, index, sign] = axis;
  command[vector][index] = Math.max(-1, Math.min(1, command[vector][index] + sign * amount));
}

function beyondDeadZone(value: number): number {
  return (Math.sign(value) * Math.max(0, Math.abs(value) - DEAD_ZONE)) / (1 - DEAD_ZONE);
}

const DRIVEN_IN: SessionStatus["phase"][] = ["trial", "viewing"];

export function drivingText(status: SessionStatus): string {
  if (!DRIVEN_IN.includes(status.phase)) return "You drive in this trial. The robot holds still until it begins.";
  return status.idle ? "The robot holds still." : "You drive the robot.";
}

/**
 * Manual control of the robot by the experimenter or the demonstrator.
 *
 * Keys and gamepad move its hand while an enabling key is pressed.
 */
export class OperatorControl {
  private readonly held = new Set<string>();
  private operated = false;
  private engaged = false;

  /** `panel` is shown in trials that the experimenter drives; its first child displays the status. */
  constructor(
    private readonly panel: HTMLElement,
    private readonly send: (message: VelocityCommand) => void,
    private readonly source: OperatorRole = "operator",
  ) {
    this.listen(window);
    setInterval(() => this.tell(), EVERY_MS);
  }

  /** Also listens to the keys of this window. */
  listen(window: Window): void {
    window.addEventListener("keydown", (event) => this.pressed(event));
    window.addEventListener("keyup", (event) => this.released(event));
    window.addEventListener("blur", () => this.release());
  }

  onStatus(status: SessionStatus): void {
    this.operated = status.operated;
    this.panel.hidden = !status.operated;
    this.panel.firstElementChild!.textContent = drivingText(status);
    if (!status.operated) this.release();
  }

  /** Whether a key is used for driving now. */
  takes(event: KeyboardEvent): boolean {
    if (!this.operated || isWriting(event.target)) return false;
    return event.code === ENABLING_KEY || this.held.has(ENABLING_KEY);
  }

  private pressed(event: KeyboardEvent): void {
    if (!this.operated || isWriting(event.target)) return;
    this.held.add(event.code);
    if (this.takes(event) && event.key !== "Escape") event.preventDefault();
    if (event.code === ENABLING_KEY && !event.repeat) this.tell();
  }

  private released(event: KeyboardEvent): void {
    if (this.takes(event)) event.preventDefault();
    this.held.delete(event.code);
    if (event.code === ENABLING_KEY) this.release();
  }

  private release(): void {
    this.held.clear();
    this.tell();
  }

  private tell(): void {
    if (!this.operated && !this.engaged) return;
    const command = this.operated ? this.command() : RELEASED;
    if (command.engaged || this.engaged) this.send({ ...command, source: this.source });
    this.engaged = command.engaged;
  }

  private command(): VelocityCommand {
    const pads = navigator.getGamepads?.() ?? [];
    const commands = pads.filter((pad) => pad !== null).map(gamepadCommand);
    return [keyboardCommand(this.held), ...commands].find((command) => command.engaged) ?? RELEASED;
  }
}

function isWriting(target: EventTarget | null): boolean {
  const control = target instanceof HTMLElement ? target.closest("input, textarea, select") : null;
  return control !== null && !(control instanceof HTMLInputElement && control.type === "checkbox");
}
