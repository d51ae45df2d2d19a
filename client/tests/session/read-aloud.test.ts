import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { ENGLISH_TEXTS } from "../../src/page/texts";
import { localVoice, ReadAloud } from "../../src/session/read-aloud";

const VOICES = [
  { lang: "en-GB", localService: false },
  { lang: "de_DE", localService: true },
  { lang: "en-US", localService: true },
];

/** A speech synthesizer that speaks until it is cancelled, and what it said. */
function synthesizer(voices = VOICES) {
  const said: string[] = [];
  const synthesis = {
    speaking: false,
    getVoices: () => voices,
    speak: ({ text }: { text: string }) => {
      said.push(text);
      synthesis.speaking = true;
    },
    cancel: () => (synthesis.speaking = false),
  };
  const reading = new ReadAloud(synthesis as unknown as SpeechSynthesis);
  reading.enable(true);
  return { synthesis, said, reading };
}

beforeEach(() => vi.stubGlobal("SpeechSynthesisUtterance", class { constructor(readonly text: string) {} }));
afterEach(() => vi.unstubAllGlobals());

it("chooses a voice of this computer in the language", () => {
  expect(localVoice(VOICES, "en")?.lang).toBe("en-US");
  expect(localVoice(VOICES, "de")?.lang).toBe("de_DE");
  expect(localVoice(VOICES, "fr")).toBeNull();
});

it("reads each text once, and a new text immediately", () => {
  const { said, reading } = synthesizer();
  for (const text of ["Ready?", "Ready?", "Stop", "Stop"]) reading.read(text, ENGLISH_TEXTS);
  expect(said).toEqual(["Ready?", "Stop"]);
  reading.enable(false);
  expect(reading.read("Go on", ENGLISH_TEXTS)).toBe(false);
  reading.enable(true);
  expect(reading.read("Stop", ENGLISH_TEXTS)).toBe(true);
});

it("reads the highlighted button after the text, or when the participant steps", () => {
  const { said, synthesis, reading } = synthesizer();
  reading.read("How hard was it?", ENGLISH_TEXTS);
  reading.name("1", "a");
  expect(said).toEqual(["How hard was it?"]);
  synthesis.speaking = false;
  reading.name("1", "a");
  reading.name("2", "b");
  reading.name("2", "b");
  expect(said.slice(1)).toEqual(["1", "2"]);
  reading.read("Which?", ENGLISH_TEXTS);
  reading.name("3", "c", true);
  expect(said.at(-1)).toBe("3");
});

it("is silent without a voice of this computer", () => {
  const { said, reading } = synthesizer([VOICES[0]!]);
  expect(reading.read("Ready?", ENGLISH_TEXTS)).toBe(false);
  expect([said, reading.speaking]).toEqual([[], false]);
});
