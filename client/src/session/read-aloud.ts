import type { Texts } from "../page/texts";
import type { SoundFiles } from "./sound-files";

type Voice = Pick<SpeechSynthesisVoice, "lang" | "localService">;

/** The first voice of this computer for a language, or null. Voices that send texts to other computers are not used. */
export function localVoice<V extends Voice>(voices: readonly V[], language: string): V | null {
  const base = (tag: string) => tag.toLowerCase().split(/[-_]/)[0];
  return voices.find(({ lang, localService }) => localService && base(lang) === base(language)) ?? null;
}

/**
 * Reads texts and the names of highlighted buttons aloud, with the browser's local voices.
 *
 * Without such a voice, it plays the study's sound file of a text.
 */
export class ReadAloud {
  private enabled = false;
  private language = "";
  private latest = "";
  private named = "";
  private readsText = false;

  constructor(
    private readonly files: Pick<SoundFiles, "play" | "stop" | "playing">,
    private readonly synthesis: SpeechSynthesis | null = globalThis.speechSynthesis ?? null,
  ) {}

  /** Enables or disables reading. */
  enable(enabled: boolean): void {
    if (enabled === this.enabled) return;
    this.enabled = enabled;
    this.latest = this.named = "";
    this.cancel();
  }

  get speaking(): boolean {
    return this.enabled && (!!this.synthesis?.speaking || this.files.playing);
  }

  /**
   * Reads the displayed text once. A new text interrupts the previous one. Returns whether a voice reads it.
   *
   * `file`: the name of its sound file.
   */
  read(text: string, { language }: Pick<Texts, "language">, file = ""): boolean {
    if (!this.enabled || text === this.latest) return false;
    this.latest = text;
    this.language = language;
    this.readsText = true;
    if (this.speak(text)) return true;
    if (file && text) void this.files.play(`sounds/${language}/${file}`).catch(() => undefined);
    return false;
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
    this.cancel();
    if (!enabled || !synthesis) return false;
    const voice = localVoice(synthesis.getVoices(), language);
    if (!voice || !text) return false;
    const utterance = new SpeechSynthesisUtterance(text);
    utterance.voice = voice;
    utterance.lang = voice.lang;
    synthesis.speak(utterance);
    return true;
  }

  private cancel(): void {
    this.synthesis?.cancel();
    this.files.stop();
  }
}
