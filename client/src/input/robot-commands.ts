import type { ParticipantMessage, ClientCommandSource, CommandLabel, WatcherMessage, AvailableRobotCommands } from "../generated/messages";
import { createElement } from "../page/dom";

type Given = Extract<ParticipantMessage | WatcherMessage, { type: "robot_command" }>;
type Name = Given["name"];
type Key = Pick<KeyboardEvent, "key" | "repeat" | "ctrlKey" | "altKey" | "metaKey">;

/** The command of a number key: 1 gives the first command. */
export function commandOfKey(event: Key, offered: readonly CommandLabel[]): Name | null {
  const isOther = event.repeat || event.ctrlKey || event.altKey || event.metaKey || !/^\d$/.test(event.key);
  return (isOther ? null : offered[Number(event.key) - 1]?.name) ?? null;
}

/** The indices of the pressed buttons of all gamepads. */
export function pressedButtons(gamepads: Iterable<Pick<Gamepad, "buttons"> | null>): Set<number> {
  const pressed = new Set<number>();
  for (const gamepad of gamepads) gamepad?.buttons.forEach((button, index) => button.pressed && pressed.add(index));
  return pressed;
}

/** Commands to the robot by buttons, number keys and gamepad buttons, while the server offers commands. */
export class RobotCommandInput {
  private offered: readonly CommandLabel[] = [];
  private sources: AvailableRobotCommands["sources"] = [];
  private buttonSource: Exclude<ClientCommandSource, "key"> = "button";
  private pressed = new Set<number>();

  /** `group`: element for the buttons. `watcher`: the source of every input on the page of another person. */
  constructor(
    private readonly group: HTMLElement,
    private readonly send: (message: Given) => void,
    private readonly watcher: "caregiver" | "experimenter" | null = null,
  ) {}

  show({ commands, sources, mode }: AvailableRobotCommands): void {
    if (commands.map(({ name }) => name).join() !== this.offered.map(({ name }) => name).join())
      this.group.replaceChildren(...commands.map((command, index) => this.button(command, index)));
    this.offered = commands;
    this.sources = sources;
    this.group.dataset["mode"] = mode;
    this.showButtons();
  }

  /** The source of pressed buttons: `dwell` or `switch` for participants who select with these. */
  press(source: Exclude<ClientCommandSource, "key">): void {
    this.buttonSource = source;
    this.showButtons();
  }

  /** The commands that a source may give now. */
  offeredTo(source: ClientCommandSource): readonly CommandLabel[] {
    return this.sources.includes(source) ? this.offered : [];
  }

  private showButtons(): void {
    const source = this.watcher ?? this.buttonSource;
    this.group.hidden = !this.offered.length || !this.sources.includes(source);
  }

  /** Whether a number key gives a command. It gives none in text fields, and none on pages that may not command. */
  takesKey(event: KeyboardEvent): boolean {
    const isTyping = event.target instanceof Element && event.target.closest("input, textarea, select") !== null;
    const isRefused = this.watcher !== null && !this.sources.includes(this.watcher);
    const name = isTyping || isRefused ? null : commandOfKey(event, this.offered);
    if (name) this.give(name, "key");
    return name !== null;
  }

  /** Gives the commands of newly pressed buttons: the first button gives the first command, and so on. */
  watchGamepads(gamepads: Iterable<Gamepad | null>): void {
    if (!this.offered.length) return;
    const before = this.pressed;
    this.pressed = pressedButtons(gamepads);
    for (const index of this.pressed) {
      const command = before.has(index) ? undefined : this.offered[index];
      if (command) this.give(command.name, "button");
    }
  }

  private button({ name, label }: CommandLabel, index: number): HTMLButtonElement {
    const key = String(index + 1);
    const button = createElement("button", `${this.watcher === "experimenter" ? name.replace("_", " ") : label} `);
    button.type = "button";
    button.dataset["robotCommand"] = name;
    button.setAttribute("aria-keyshortcuts", key);
    button.append(createElement("kbd", key));
    button.addEventListener("click", () => this.give(name, this.buttonSource));
    return button;
  }

  give(name: Name, source: ClientCommandSource): void {
    const client_time_ms = performance.now();
    if (this.watcher) this.send({ type: "robot_command", name, source: this.watcher, client_time_ms });
    else this.send({ type: "robot_command", name, source, client_time_ms });
  }
}
