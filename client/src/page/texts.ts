import type { Language } from "../generated/messages";
import { TEXTS } from "../generated/interface-texts";

export type Key = keyof (typeof TEXTS)["en"]["texts"];

/** The interface texts in one language. */
export class Texts {
  constructor(
    readonly language: string,
    readonly direction: string,
    private readonly texts: Readonly<Record<string, string>>,
  ) {}

  /** A text with its placeholders filled in. */
  get(key: Key, values: Readonly<Record<string, string | number>> = {}): string {
    return this.texts[key]!.replace(/\{(\w+)\}/g, (_, name: string) => String(values[name]));
  }

  /** The language, which identifies the texts in comparisons. */
  toJSON(): string {
    return this.language;
  }

  /** Fills all elements of a page that have a text or label key. */
  applyTo(page: Document): void {
    page.documentElement.lang = this.language;
    page.documentElement.dir = this.direction;
    for (const each of page.querySelectorAll<HTMLElement>("[data-text]"))
      each.replaceChildren(...marked(this.get(each.dataset["text"] as Key)));
    for (const each of page.querySelectorAll<HTMLElement>("[data-label]"))
      each.setAttribute("aria-label", this.get(each.dataset["label"] as Key));
  }
}

export const ENGLISH_TEXTS = new Texts("en", TEXTS.en.direction, TEXTS.en.texts);

/** The texts of a message from the server. */
export function textsOf({ language, direction, texts }: Language): Texts {
  return new Texts(language, direction, texts);
}

/** The texts in the browser's language, or English, before the server sends the participant's language. */
export function initialTexts(wanted: readonly string[]): Texts {
  const included: Readonly<Record<string, { direction: string; texts: Readonly<Record<string, string>> }>> = TEXTS;
  const language = wanted.map((tag) => tag.split("-")[0]!).find((tag) => Object.hasOwn(included, tag)) ?? "en";
  return new Texts(language, included[language]!.direction, included[language]!.texts);
}

/** Converts **bold** and `key` marks to elements. */
function marked(text: string): (Node | string)[] {
  return text.split(/(\*\*.+?\*\*|`.+?`)/).map((part) => {
    const [, bold, key] = /^\*\*(.+)\*\*$|^`(.+)`$/.exec(part) ?? [];
    if (!bold && !key) return part;
    const element = document.createElement(bold ? "b" : "kbd");
    element.textContent = (bold ?? key)!;
    return element;
  });
}
