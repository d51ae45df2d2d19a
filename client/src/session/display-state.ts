import type { Link } from "./connection";
import { PHASES_WHERE, type ParticipantBody, type PhaseDescription, type Question } from "../generated/messages";
import { textFor, type InputKind } from "../input/input-kind";
import type { Key, Texts } from "../page/texts";
import type { Segment } from "../panel/segments";

/** The state that determines the displayed texts. */
export interface DisplayState {
  texts: Texts;
  link: Link;
  /** The closing code of the server, or 0. */
  code: number;
  phase: PhaseDescription | null;
  /** The participant's body, for roles that may change it. */
  body: ParticipantBody | null;
  question: Question | null;
  answered: number | null;
  problem: string | null;
  secondsLeft: number | null;
  /** Whether long scales are shown in segments, and the chosen one. */
  staged: boolean;
  segment: Segment | null;
  /** The participant's select input in VR. */
  input: InputKind;
  /** Whether the participant is in VR or takes part without a headset. */
  participates: boolean;
}

export interface PanelContent {
  texts: Texts;
  label: string;
  text: string;
  secondsLeft: number | null;
  question: Question | null;
  /** The present body, while it can be changed. */
  body: ParticipantBody | null;
  answered: number | null;
  notice: string | null;
  /** Whether the participant must confirm their answers. */
  confirms: boolean;
  /** Whether the participant may be calibrated again. */
  again: boolean;
  /** Whether the participant may request a break. */
  rests: boolean;
  /** Whether the participant may change their preferences for the robot. */
  prefers: boolean;
  /** Whether the participant may go on. */
  goesOn: boolean;
  staged: boolean;
  segment: Segment | null;
}

const LINK_TEXTS: Record<Link, Key> = {
  connecting: "connecting",
  connected: "connected",
  lost: "lost",
  refused: "lost",
  superseded: "superseded",
};

/** Texts by closing code of the server. */
const REASONS: Readonly<Record<number, Key>> = {
  1001: "stopped_server",
  4400: "outdated",
  4401: "no_token",
  4403: "earlier_start",
  4409: "taken",
  4410: "link_ended",
  4411: "enter_code",
};

/** Whether a session code reopens this page; see `server/authentication.py`. */
export function asksForCode(code: number): boolean {
  return code === 4410 || code === 4411;
}

export function linkText({ texts, link, code }: Pick<DisplayState, "texts" | "link" | "code">): string {
  return texts.get((link !== "connected" && REASONS[code]) || LINK_TEXTS[link]);
}

/** The content of the panel in VR; null if it is empty. */
export function panelContent(display: DisplayState): PanelContent | null {
  const { texts, question, phase, answered, secondsLeft, staged, segment } = display;
  const notice = display.link === "connected" ? display.problem : linkText(display);
  const label = question ? texts.get("of", { number: question.number, count: question.count }) : phaseLabel(phase, texts);
  const text = question ? question.text : phaseText(phase, display.input);
  if (!text && !notice) return null;
  const body = phase?.name === "calibration" ? display.body : null;
  const [confirms, again, rests] = [confirmsAnswers(phase), mayRecalibrate(phase), mayRest(phase)];
  const prefers = mayPrefer(phase);
  const goesOn = awaitsReady(phase) && !question && !confirms;
  const counts = question ? null : secondsLeft;
  const shown = { texts, label, text, secondsLeft: counts, question, body, answered, notice };
  return { ...shown, confirms, again, rests, prefers, goesOn, staged, segment };
}

/** What is read aloud: the text, and the answers to a question. */
export function spokenText(display: DisplayState): string {
  const { texts, question, phase, problem, link } = display;
  if (link !== "connected") return linkText(display);
  if (problem) return problem;
  if (!question) return phase ? textFor(display.input, phase.text, phase.texts_by_input, phase.page_text) : "";
  const { text, labels, low, high, points } = question;
  const ends = [[1, low], [points, high]] as const;
  const answers = labels.length > 0 ? labels : ends.map(([value, meaning]) => texts.get("anchor", { value, meaning }));
  return [text, ...answers].join("\n");
}

/** The number of the trial; empty outside trials. */
export function phaseLabel(phase: PhaseDescription | null, texts: Texts): string {
  if (!phase || phase.trial < 1) return "";
  return phase.practice ? texts.get("practice") : texts.get("trial", { trial: phase.trial, trials: phase.trials });
}

/** The text of a phase; empty while the robot moves, so that nothing covers the view. */
function phaseText(phase: PhaseDescription | null, input: InputKind): string {
  if (!phase || phase.name === "trial" || phase.name === "retreat") return "";
  return textFor(input, phase.text, phase.texts_by_input, phase.page_text);
}

/** Whether the participant must confirm their answers. */
export function confirmsAnswers(phase: PhaseDescription | null): boolean {
  return phase?.name === "confirm";
}

/** Whether there is a previous answer to change, or another segment to choose. */
export function mayGoBack({ phase, question, segment }: Pick<DisplayState, "phase" | "question" | "segment">): boolean {
  return question ? question.number > 1 || segment !== null : confirmsAnswers(phase);
}

/** Whether the session waits for a trigger press. */
export function awaitsReady(phase: PhaseDescription | null): boolean {
  return phase !== null && PHASES_WHERE.awaits_confirmation.includes(phase.name);
}

/** Whether the participant may be calibrated again. */
export function mayRecalibrate(phase: PhaseDescription | null): boolean {
  return phase?.name === "check";
}

/** Whether the page offers a break. */
export function mayRest(phase: PhaseDescription | null): boolean {
  return phase?.name === "ready";
}

/** Whether the participant may change their preferences for the robot. */
export function mayPrefer(phase: PhaseDescription | null): boolean {
  return phase?.preferences ?? false;
}

/** Whether a stop is possible now. */
export function canBeStopped(phase: PhaseDescription | null): boolean {
  return phase !== null && PHASES_WHERE.can_be_stopped.includes(phase.name);
}

/** Whether person and robot may move, so the stop key must work. */
export function isRunning(phase: PhaseDescription | null): boolean {
  return phase !== null && PHASES_WHERE.has_motion.includes(phase.name);
}
