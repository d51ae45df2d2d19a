import type { Problem } from "../generated/messages";
import type { Key, Texts } from "./texts";

/** How long a problem is shown: as long as it takes to read. */
const SHOWN_MS = 6000;
const SHOWN_MS_A_LETTER = 80;

/** The latest problem, from the server or from this page, until it can have been read. */
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

  /** Shows why something on this page failed. */
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
