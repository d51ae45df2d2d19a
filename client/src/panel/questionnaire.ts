import type { Answer, Question } from "../generated/messages";

/** A rectangle in pixels of the panel's canvas; the origin is the top left corner. */
export interface Box {
  x: number;
  y: number;
  width: number;
  height: number;
}

export interface Button extends Box {
  value: number;
}

/** Gap between buttons as a share of their pitch. */
const GAP = 0.16;
const GAP_OF_WORDS = 0.06;

/** Buttons 1 … `points` in one row: the largest squares that fit into `area`, centred. */
export function layoutButtons(points: number, area: Box): Button[] {
  const pitch = Math.min(area.width / (points - GAP), area.height / (1 - GAP));
  const size = pitch * (1 - GAP);
  const left = area.x + (area.width - pitch * points + pitch * GAP) / 2;
  const y = area.y + (area.height - size) / 2;
  return Array.from({ length: points }, (_, at) => ({ value: at + 1, x: left + pitch * at, y, width: size, height: size }));
}

/** Buttons with texts 1 … `points` in one row, as wide as `area` allows; the height is at most the width and `height`. */
export function layoutWords(points: number, area: Box, height: number): Button[] {
  const pitch = area.width / (points - GAP_OF_WORDS);
  const width = pitch * (1 - GAP_OF_WORDS);
  const size = { width, height: Math.min(width, height) };
  const y = area.y + (area.height - size.height) / 2;
  return Array.from({ length: points }, (_, at) => ({ value: at + 1, x: area.x + pitch * at, y, ...size }));
}

/** The label of a value, by default its number. */
export function labelOf({ labels }: Question, value: number): string {
  return labels[value - 1] ?? String(value);
}

/** Scales with more points are drawn as a line. */
export const LONGEST_ROW = 11;

/** Whether a question is answered on a line instead of buttons. */
export function isLine({ points, labels }: Question): boolean {
  return points > LONGEST_ROW && !labels.some((label) => label.length > 3);
}

/** The positions 1 … `points` of a line, without gaps. */
export function layoutLine(points: number, area: Box): Button[] {
  const width = area.width / points;
  return Array.from({ length: points }, (_, at) => ({ ...area, value: at + 1, x: area.x + width * at, width }));
}

/** The buttons mirrored for right-to-left scripts. */
export function mirrored(buttons: Button[], area: Box): Button[] {
  return buttons.map((button) => ({ ...button, x: 2 * area.x + area.width - button.x - button.width }));
}

/** Whether the labels of the first and last button already are the anchors. */
export function saysItsEnds({ labels, low, high }: Question): boolean {
  return labels[0] === low && labels.at(-1) === high;
}

/** The value of the button at a point of the panel, or null. */
export function hitButton(buttons: readonly Button[], x: number, y: number): number | null {
  for (const button of buttons) {
    const inside =
      x >= button.x && x <= button.x + button.width && y >= button.y && y <= button.y + button.height;
    if (inside) return button.value;
  }
  return null;
}

/** The displayed question and its answer. */
export class Questionnaire {
  question: Question | null = null;
  answered: number | null = null;
  /** Response time until `sinceMs`, the time at which it continues; `sinceMs` is null while answering is blocked. */
  private spentMs = 0;
  private sinceMs: number | null = 0;

  /** Shows a question. The response time continues if the same question returns after a lost connection. */
  show(question: Question, nowMs: number): void {
    if (question.item !== this.question?.item) {
      this.spentMs = 0;
      if (this.sinceMs !== null) this.sinceMs = nowMs;
    }
    this.question = question;
    this.answered = null;
  }

  /** Pauses the response time while the participant cannot see or answer the question. */
  block(blocked: boolean, nowMs: number): void {
    if (blocked === (this.sinceMs === null)) return;
    this.spentMs = this.spentUntil(nowMs);
    this.sinceMs = blocked ? null : nowMs;
  }

  clear(): void {
    this.question = null;
    this.answered = null;
  }

  /** Sends the first answer; ignores later ones. `send` returns whether it was sent. */
  answer(value: number, nowMs: number, send: (answer: Answer) => boolean): void {
    if (!this.question || this.answered !== null || value < 1 || value > this.question.points) return;
    const response_time_s = this.spentUntil(nowMs) / 1000;
    if (send({ type: "answer", item: this.question.item, value, response_time_s })) this.answered = value;
  }

  private spentUntil(nowMs: number): number {
    return this.spentMs + (this.sinceMs === null ? 0 : Math.max(0, nowMs - this.sinceMs));
  }
}
