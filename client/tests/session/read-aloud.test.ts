import { afterEach, beforeEach, expect, it, vi } from "vitest";
import { ENGLISH_TEXTS } from "../../src/page/texts";
import { localVoice, ReadAloud } from "../../src/session/read-aloud";
import { SoundFiles } from "../../src/session/sound-files";

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
  const played: string[] = [];
  const play = (url: string) => Promise.resolve(void played.push(url));
  const reading = new ReadAloud({ play, stop: () => undefined, playing: false }, synthesis as unknown as SpeechSynthesis);
  reading.enable(true);
  return { synthesis, said, played, reading };
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

it("plays the study's sound file without a voice of this computer", () => {
  const { said, played, reading } = synthesizer([VOICES[0]!]);
  for (const text of ["Ready?", "Ready?"]) expect(reading.read(text, ENGLISH_TEXTS, "ready")).toBe(false);
  reading.name("Go on", "a");
  expect([said, played, reading.speaking]).toEqual([[], ["sounds/en/ready"], false]);
});

it("plays only the newest sound file", async () => {
  const started: number[] = [];
  const stop = vi.fn();
  const audio = {
    destination: null,
    decodeAudioData: (bytes: ArrayBuffer) => Promise.resolve(bytes.byteLength),
    createBufferSource: () => ({
      buffer: 0,
      connect: () => undefined,
      stop,
      start() {
        started.push(this.buffer);
      },
    }),
  };
  const sizes: Record<string, number> = { none: 0, a: 1, b: 2 };
  const files = new SoundFiles(() => audio as unknown as AudioContext, (url) => Promise.resolve(new ArrayBuffer(sizes[url]!)));
  await files.play("none");
  expect(files.playing).toBe(false);
  await Promise.all([files.play("a"), files.play("b")]);
  expect([started, files.playing]).toEqual([[2], true]);
  files.stop();
  expect([stop.mock.calls.length, files.playing]).toEqual([1, false]);
});
