import type { Problem } from "../generated/messages";
import type { Key, Texts } from "./texts";

/** Display time of a problem, by the length of its text. */
const SHOWN_MS = 6000;
const SHOWN_MS_A_LETTER = 80;

/** The last problem, from the server or this page, for the time that it takes to read it. */
export class Notice {
  problem: Problem | null = null;
  private timer = 0;

  constructor(private readonly changed: () => void) {}

  show(problem: Problem): void {
    this.problem = problem;
    clearTimeout(this.timer);
    const shownMs = Math.max(SHOWN_MS, SHOWN_MS_A_LETTER * problem.message.length);
    this.timer = window.setTimeout(() => this.hide(), shownMs);
    this.changed();
  }

  /** Shows the reason for an error of this page. */
  explain(texts: Texts, key: Key, error?: unknown): void {
    if (error !== undefined) console.warn(error);
    const text = texts.get(key, { reason: error === undefined ? "" : reasonOf(error) });
    this.show({ type: "problem", message: text, role: "participant", page_message: "", messages_by_input: {} });
  }

  private hide(): void {
    this.problem = null;
    this.changed();
  }
}

function reasonOf(error: unknown): string {
  return (error instanceof Error ? error.message : String(error)).replace(/\.$/, "");
}
