import type { Language } from "../generated/messages";
import { TEXTS } from "../generated/interface-texts";

export type Key = keyof (typeof TEXTS)["en"]["words"];

/** What the page says, in one language. */
export class Texts {
  constructor(
    readonly language: string,
    readonly direction: string,
    private readonly texts: Readonly<Record<string, string>>,
  ) {}

  /** A text, with values in the place of the names in its braces. */
  get(key: Key, values: Readonly<Record<string, string | number>> = {}): string {
    return this.texts[key]!.replace(/\{(\w+)\}/g, (_, name: string) => String(values[name]));
  }

  /** What tells one language from another. */
  toJSON(): string {
    return this.language;
  }

  /** Fills every element of a page that says which text is its own, and which one names it. */
  applyTo(page: Document): void {
    page.documentElement.lang = this.language;
    page.documentElement.dir = this.direction;
    for (const each of page.querySelectorAll<HTMLElement>("[data-text]"))
      each.replaceChildren(...marked(this.get(each.dataset["text"] as Key)));
    for (const each of page.querySelectorAll<HTMLElement>("[data-label]"))
      each.setAttribute("aria-label", this.get(each.dataset["label"] as Key));
  }
}

export const ENGLISH_TEXTS = new Texts("en", TEXTS.en.direction, TEXTS.en.words);

/** The words that a server tells. */
export function textsOf({ language, direction, words }: Language): Texts {
  return new Texts(language, direction, words);
}

/** Until the server tells the participant's language: the browser's, where that is brought along. */
export function initialTexts(wanted: readonly string[]): Texts {
  const brought: Readonly<Record<string, { direction: string; words: Readonly<Record<string, string>> }>> = TEXTS;
  const language = wanted.map((tag) => tag.split("-")[0]!).find((tag) => Object.hasOwn(brought, tag)) ?? "en";
  return new Texts(language, brought[language]!.direction, brought[language]!.words);
}

/** A text whose **bold words** and `keys` become elements. */
function marked(text: string): (Node | string)[] {
  return text.split(/(\*\*.+?\*\*|`.+?`)/).map((part) => {
    const [, bold, key] = /^\*\*(.+)\*\*$|^`(.+)`$/.exec(part) ?? [];
    if (!bold && !key) return part;
    const element = document.createElement(bold ? "b" : "kbd");
    element.textContent = (bold ?? key)!;
    return element;
  });
}
