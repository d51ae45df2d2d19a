import type { Link } from "./connection";
import { PHASES_WHERE, type Body, type Phase, type Question } from "./messages";

/** Everything that words are shown about. */
export interface Display {
  link: Link;
  linkReason: string;
  phase: Phase | null;
  /** The participant's body, for those who may choose it. */
  body: Body | null;
  question: Question | null;
  answered: number | null;
  problem: string | null;
  secondsLeft: number | null;
  /** Whether the participant is in VR, or plays without a headset. */
  takesPart: boolean;
  /** Whether they play without one. */
  plays: boolean;
}

export interface PanelContent {
  label: string;
  text: string;
  secondsLeft: number | null;
  question: Question | null;
  /** The body to choose another in the place of, while the participant is measured. */
  body: Body | null;
  answered: number | null;
  notice: string | null;
}

const LINK_WORDS: Record<Link, string> = {
  connecting: "Connecting to the server …",
  connected: "Connected to the server",
  lost: "Connection lost. Trying again …",
  superseded: "Opened in another window. Reload this page to use it here.",
};

export function linkWords({ link, linkReason }: Pick<Display, "link" | "linkReason">): string {
  return link === "lost" && linkReason ? `Not connected: ${linkReason}. Trying again …` : LINK_WORDS[link];
}

/** What the panel in VR shows; null while there is nothing to read. */
export function panelContent(display: Display): PanelContent | null {
  const { question, phase, answered, secondsLeft } = display;
  const notice = display.link === "connected" ? display.problem : linkWords(display);
  const label = question ? `${question.number} of ${question.count}` : phaseLabel(phase);
  const text = question ? question.text : phaseText(phase);
  if (!text && !notice) return null;
  const body = phase?.name === "calibration" ? display.body : null;
  return { label, text, secondsLeft: question ? null : secondsLeft, question, body, answered, notice };
}

/** Which trial of how many; empty outside the trials. */
export function phaseLabel(phase: Phase | null): string {
  if (!phase || phase.trial < 1) return "";
  return phase.practice ? "Practice" : `Trial ${phase.trial} of ${phase.trials}`;
}

/** Nothing stands between the person and the robot while it moves. */
function phaseText(phase: Phase | null): string {
  return phase && phase.name !== "trial" && phase.name !== "retreat" ? phase.text : "";
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
