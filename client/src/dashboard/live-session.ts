import { canChooseBody } from "../panel/body-choice";
import { Connection, type Link, type Outgoing } from "../session/connection";
import { isRunning, linkText } from "../session/display-state";
import { OperatorControl } from "../input/operator-control";
import { RobotCommandInput } from "../input/robot-commands";
import { createElement, element, spectatorFrame, watchAddress } from "../page/dom";
import type { ParticipantBody, BodyChoice, ExperimenterCommandName, FurniturePoint, PhaseDescription, ServerMessage, SessionStatus, ParticipantTargets } from "../generated/messages";
import { PHASE_TEXTS, skipText, statusTexts, timingText } from "../session/session-status";
import { ENGLISH_TEXTS } from "../page/texts";

const COMMAND_KEYS: Record<string, ExperimenterCommandName> = { r: "repeat", k: "skip", m: "recalibrate", b: "break" };

export interface LiveEvents {
  /** The session has advanced, so the study has changed. */
  changed(): void;
  problem(words: string): void;
}

/** The running session: its view, its status, and commands by buttons and keys. */
export class Live {
  private readonly connection: Connection;
  private readonly driving: OperatorControl;
  private readonly robotCommands: RobotCommandInput;
  private readonly buttons = [...document.querySelectorAll<HTMLButtonElement>("[data-command]")];
  private readonly sex = element<HTMLSelectElement>("sex");
  private readonly tone = element<HTMLSelectElement>("skin-tone");
  private phase: PhaseDescription | null = null;
  private body: ParticipantBody | null = null;
  private paused = false;
  private isWelcome = false;

  constructor(
    private readonly token: string,
    private readonly events: LiveEvents,
  ) {
    this.connection = new Connection(watchAddress(), token, false, {
      message: (message) => this.receive(message),
      link: (link, code) => this.onLink(link, code),
    });
    for (const button of this.buttons)
      button.addEventListener("click", () => this.command(button.dataset["command"] as ExperimenterCommandName));
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-point]"))
      button.addEventListener("click", () => this.connection.send({ type: "mark_point", point: button.dataset["point"] as FurniturePoint }));
    for (const select of [this.sex, this.tone]) select.addEventListener("change", () => this.chooseBody());
    const send: (message: Outgoing) => void = (message) => this.connection.send(message);
    this.robotCommands = new RobotCommandInput(element("robot-commands"), send, "experimenter");
    this.driving = new OperatorControl(element("drive"), (message) => this.connection.send(message));
    window.addEventListener("keydown", (event) => this.key(event));
    element("picture").addEventListener("toggle", () => this.showPicture());
  }

  start(): void {
    this.connection.open();
    this.show();
  }

  private receive(message: ServerMessage): void {
    if (message.type === "welcome") this.onWelcome();
    if (message.type === "phase") this.onPhase(message);
    if (message.type === "status") this.onStatus(message);
    if (message.type === "robot_commands") this.robotCommands.show(message);
    if (message.type === "body") this.onBody(message);
    if (message.type === "targets") this.offer(message);
    if (message.type === "input" && message.method !== "experimenter") element("selections").hidden = true;
    if (message.type === "timing") element("watch-ticks").textContent = timingText(message);
    if (message.type === "problem") this.events.problem(message.message);
  }

  private onWelcome(): void {
    this.isWelcome = true;
    this.showPicture();
  }

  /** Draws the view only while it is open, to save processor time. */
  private showPicture(): void {
    const picture = element<HTMLDetailsElement>("picture");
    const drawn = picture.querySelector("iframe");
    if (!picture.open) drawn?.remove();
    else if (this.isWelcome && !drawn) picture.append(this.picture());
  }

  /** A frame with the spectator page. It also forwards this page's keys, except Esc, which it handles. */
  private picture(): HTMLIFrameElement {
    const frame = spectatorFrame("What happens in the simulation", this.token);
    frame.addEventListener("load", () => {
      const inside = frame.contentWindow;
      if (!inside) return;
      this.driving.listen(inside);
      inside.addEventListener("keydown", (event) => event.key !== "Escape" && this.key(event));
    });
    return frame;
  }

  private onBody(body: ParticipantBody): void {
    this.body = body;
    if (this.tone.options.length === 0) this.tone.append(...body.skin_tones.map((tone) => new Option(tone, tone)));
    this.sex.value = body.sex;
    this.tone.value = body.skin_tone;
    this.show();
  }

  /** Shows buttons with which the experimenter selects for the participant. */
  private offer({ number, targets }: ParticipantTargets): void {
    element("selections").hidden = targets.length === 0;
    const buttons = targets.map(({ value, label }) => {
      const button = createElement("button", label);
      button.type = "button";
      button.addEventListener("click", () => this.connection.send({ type: "press", number, value }));
      return button;
    });
    element("targets").replaceChildren(...buttons);
  }

  private chooseBody(): void {
    const sex = this.sex.value as BodyChoice["sex"];
    this.connection.send({ type: "choose_body", sex, skin_tone: this.tone.value });
  }

  private onPhase(phase: PhaseDescription): void {
    this.phase = phase;
    this.show();
    this.events.changed();
  }

  private onStatus(status: SessionStatus): void {
    this.paused = status.paused;
    this.driving.onStatus(status);
    for (const [id, words] of Object.entries(statusTexts(status))) element(id).textContent = words;
    element("skip-word").textContent = skipText(status.phase);
    element("pause").dataset["command"] = this.paused ? "continue" : "pause";
    element("pause-word").textContent = this.paused ? "Continue" : "Pause";
  }

  private onLink(link: Link, code: number): void {
    element("server").textContent = linkText({ texts: ENGLISH_TEXTS, link, code });
    element("server").dataset["link"] = link;
    if (link !== "connected") this.phase = null;
    this.show();
  }

  private show(): void {
    const runs = isSession(this.phase) && this.phase.name !== "finished";
    for (const button of this.buttons) button.disabled = !runs;
    element("body").hidden = !runs || !this.body;
    element("furniture-points").hidden = !runs;
    element<HTMLFieldSetElement>("body").disabled = !canChooseBody(this.phase);
    element("live").hidden = !isSession(this.phase) || this.phase.trials === 0;
    element("session-words").textContent = sessionText(this.phase);
  }

  private command(name: ExperimenterCommandName): void {
    this.connection.send({ type: "command", name });
  }

  private key(event: KeyboardEvent): void {
    if (event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key === "Escape") return this.stop(event);
    if (this.driving.takes(event) || this.robotCommands.takesKey(event)) return;
    if (isTyping(event.target) || !element<HTMLInputElement>("letters").checked) return;
    this.letter(event.key.toLowerCase(), event);
  }

  private stop(event: KeyboardEvent): void {
    if (!isRunning(this.phase)) return;
    event.preventDefault();
    this.command("stop");
  }

  private letter(letter: string, event: KeyboardEvent): void {
    const command = letter === "p" ? (this.paused ? "continue" : "pause") : COMMAND_KEYS[letter];
    if (letter === "n") element("note-text").focus();
    else if (letter === "v") this.changeView();
    else if (command && isSession(this.phase)) this.command(command);
    else return;
    event.preventDefault();
  }

  private changeView(): void {
    document.querySelector("iframe")?.contentDocument?.getElementById("from-inside")?.click();
  }
}

/** Whether a key press belongs to a text field or a select element. */
function isTyping(target: EventTarget | null): boolean {
  const control = target instanceof HTMLElement ? target.closest("input, textarea, select") : null;
  return control !== null && !(control instanceof HTMLInputElement && control.type === "checkbox");
}

/** Whether a session runs: it has trials, or asks questions about the session. */
function isSession(phase: PhaseDescription | null): phase is PhaseDescription {
  return phase !== null && (phase.trials > 0 || phase.name === "questionnaire" || phase.name === "confirm");
}

/** The phase of the session in one sentence. */
export function sessionText(phase: PhaseDescription | null): string {
  if (!isSession(phase)) return "No session runs here.";
  const words = `${phase.practice ? "practice: " : ""}${PHASE_TEXTS[phase.name]}.`;
  return words.charAt(0).toUpperCase() + words.slice(1);
}
