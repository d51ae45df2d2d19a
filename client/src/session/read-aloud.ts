import type { Texts } from "../page/texts";

type Voice = Pick<SpeechSynthesisVoice, "lang" | "localService">;

/** The first voice of this computer for a language, or null. Voices that send texts to other computers are not used. */
export function localVoice<V extends Voice>(voices: readonly V[], language: string): V | null {
  const base = (tag: string) => tag.toLowerCase().split(/[-_]/)[0];
  return voices.find(({ lang, localService }) => localService && base(lang) === base(language)) ?? null;
}

/** Reads texts and the names of highlighted buttons aloud, with the browser's local voices. */
export class ReadAloud {
  private enabled = false;
  private language = "";
  private latest = "";
  private named = "";
  private readsText = false;

  constructor(private readonly synthesis: SpeechSynthesis | null = globalThis.speechSynthesis ?? null) {}

  /** Enables or disables reading. */
  enable(enabled: boolean): void {
    if (enabled === this.enabled) return;
    this.enabled = enabled;
    this.latest = this.named = "";
    this.synthesis?.cancel();
  }

  get speaking(): boolean {
    return this.enabled && !!this.synthesis?.speaking;
  }

  /** Reads the displayed text once. A new text interrupts the previous one. Returns whether the text is read now. */
  read(text: string, { language }: Pick<Texts, "language">): boolean {
    if (!this.enabled || text === this.latest) return false;
    this.latest = text;
    this.language = language;
    this.readsText = this.speak(text);
    return this.readsText;
  }

  /**
   * Reads the name of a newly highlighted button, after the text.
   *
   * `key` identifies the highlight. `interrupts`: the name interrupts the text.
   */
  name(label: string, key: string, interrupts = false): void {
    if (key === this.named || (this.speaking && this.readsText && !interrupts)) return;
    this.named = key;
    if (!this.speak(label)) return;
    this.readsText = false;
  }

  private speak(text: string): boolean {
    const { synthesis, language, enabled } = this;
    if (!enabled || !synthesis) return false;
    synthesis.cancel();
    const voice = localVoice(synthesis.getVoices(), language);
    if (!voice || !text) return false;
    const utterance = new SpeechSynthesisUtterance(text);
    utterance.voice = voice;
    utterance.lang = voice.lang;
    synthesis.speak(utterance);
    return true;
  }
}
