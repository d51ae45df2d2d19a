import type { Link } from "./connection";
import { PHASES_WHERE, type Body, type Phase, type Question } from "../generated/messages";
import { textFor, type InputKind } from "../input/input-kind";
import type { Key, Texts } from "../page/texts";

/** Everything that texts are shown about. */
export interface DisplayState {
  texts: Texts;
  link: Link;
  /** What the server closed the connection with, or 0. */
  code: number;
  phase: Phase | null;
  /** The participant's body, for those who may choose it. */
  body: Body | null;
  question: Question | null;
  answered: number | null;
  problem: string | null;
  secondsLeft: number | null;
  /** How the participant selects in VR. */
  input: InputKind;
  /** Whether the participant is in VR, or plays without a headset. */
  participates: boolean;
}

export interface PanelContent {
  texts: Texts;
  label: string;
  text: string;
  secondsLeft: number | null;
  question: Question | null;
  /** The body to choose another in the place of, while the participant is measured. */
  body: Body | null;
  answered: number | null;
  notice: string | null;
  /** Whether all questions are answered, and the answers are to be confirmed. */
  confirms: boolean;
  /** Whether the participant may ask to be measured again. */
  again: boolean;
}

const LINK_TEXTS: Record<Link, Key> = {
  connecting: "connecting",
  connected: "connected",
  lost: "lost",
  refused: "lost",
  superseded: "superseded",
};

/** Why the server closed a connection, by its code. */
const REASONS: Readonly<Record<number, Key>> = {
  1001: "stopped_server",
  4400: "outdated",
  4401: "no_token",
  4403: "earlier_start",
  4409: "taken",
  4410: "link_ended",
  4411: "enter_code",
};

/** Whether the code of a session opens this page again; see `server/access.py`. */
export function asksForCode(code: number): boolean {
  return code === 4410 || code === 4411;
}

export function linkText({ texts, link, code }: Pick<DisplayState, "texts" | "link" | "code">): string {
  return texts.get((link !== "connected" && REASONS[code]) || LINK_TEXTS[link]);
}

/** What the panel in VR shows; null while there is nothing to read. */
export function panelContent(display: DisplayState): PanelContent | null {
  const { texts, question, phase, answered, secondsLeft } = display;
  const notice = display.link === "connected" ? display.problem : linkText(display);
  const label = question ? texts.get("of", { number: question.number, count: question.count }) : phaseLabel(phase, texts);
  const text = question ? question.text : phaseText(phase, display.input);
  if (!text && !notice) return null;
  const body = phase?.name === "calibration" ? display.body : null;
  const [confirms, again] = [confirmsAnswers(phase), mayRecalibrate(phase)];
  const counts = question ? null : secondsLeft;
  return { texts, label, text, secondsLeft: counts, question, body, answered, notice, confirms, again };
}

/** Which trial of how many; empty outside the trials. */
export function phaseLabel(phase: Phase | null, texts: Texts): string {
  if (!phase || phase.trial < 1) return "";
  return phase.practice ? texts.get("practice") : texts.get("trial", { trial: phase.trial, trials: phase.trials });
}

/** Nothing stands between the person and the robot while it moves. */
function phaseText(phase: Phase | null, input: InputKind): string {
  if (!phase || phase.name === "trial" || phase.name === "retreat") return "";
  return textFor(input, phase.text, phase.texts_by_input);
}

/** Whether the participant confirms their answers now. */
export function confirmsAnswers(phase: Phase | null): boolean {
  return phase?.name === "confirm";
}

/** Whether there is an earlier answer to change. */
export function mayGoBack({ phase, question }: Pick<DisplayState, "phase" | "question">): boolean {
  return question ? question.number > 1 : confirmsAnswers(phase);
}

/** Whether a press of the trigger tells the server to go on. */
export function awaitsReady(phase: Phase | null): boolean {
  return phase !== null && PHASES_WHERE.awaits_ready.includes(phase.name);
}

/** Whether the participant may ask to be measured again. */
export function mayRecalibrate(phase: Phase | null): boolean {
  return phase?.name === "check";
}

/** Whether a stop holds the robot now. */
export function canBeStopped(phase: Phase | null): boolean {
  return phase !== null && PHASES_WHERE.can_be_stopped.includes(phase.name);
}

/** Whether the person and the robot may be moving, so that the stop key must work. */
export function isRunning(phase: Phase | null): boolean {
  return phase !== null && PHASES_WHERE.moves.includes(phase.name);
}
