import { describe, expect, it } from "vitest";
import german from "../../../src/avrgym/texts/de.toml?raw";
import english from "../../../src/avrgym/texts/en.toml?raw";
import type { PanelContent } from "../../src/session/display-state";
import { FARTHEST_M } from "../../src/panel/panel-placement";
import type { Question } from "../../src/generated/messages";
import { WIDTH, buttonsOf, paint } from "../../src/panel/paint-panel";
import { PANEL_HALF_M } from "../../src/panel/panel";
import { TEXTS } from "../../src/generated/interface-texts";
import { ENGLISH_TEXTS } from "../../src/page/texts";

/** A Quest 2's. */
const PIXELS_PER_DEGREE = 20;
/** Of a letter's square; wider than letters of headsets' fonts are on average. */
const LETTER_WIDTH = 0.58;

/** A canvas that draws nothing and keeps the sizes of what is written on it, in pixels. */
function notingCanvas(): { context: CanvasRenderingContext2D; written: Map<string, number> } {
  const written = new Map<string, number>();
  const size = (font: string) => Number(/(\d+)px/.exec(font)![1]);
  const context = {
    font: "10px sans-serif",
    measureText: (line: string) => ({ width: LETTER_WIDTH * size(context.font) * line.length }),
    fillText: (line: string) => line && written.set(line, size(context.font)),
    ...Object.fromEntries(
      ["clearRect", "beginPath", "roundRect", "fill", "stroke", "fillRect"].map((name) => [name, () => undefined]),
    ),
  } as unknown as CanvasRenderingContext2D;
  return { context, written };
}

const NOTHING: PanelContent = {
  ...{ texts: ENGLISH_TEXTS, label: "", text: "", secondsLeft: null, question: null, body: null, answered: null, notice: null },
  ...{ confirms: false, again: false, rests: false, prefers: false, goesOn: false, staged: false, segment: null },
};

/** The height of the smallest letters' squares, degrees, on the panel at its farthest. */
function smallestDeg(content: Partial<PanelContent>): number {
  const { context, written } = notingCanvas();
  const whole: PanelContent = { ...NOTHING, ...content };
  paint(context, whole, buttonsOf(whole), null);
  const pixel_m = (2 * PANEL_HALF_M.x) / WIDTH;
  return (Math.min(...written.values()) * pixel_m * 180) / Math.PI / FARTHEST_M;
}

/** What the server says in VR, with what stands in braces. */
function said(toml: string): Record<string, string> {
  const session = toml.slice(toml.indexOf("[session]"), toml.indexOf("[page]"));
  const lines = [...session.matchAll(/^(\w+) = "(.*)"$/gm)].map(([, key, text]) => [key!, text!] as const);
  return Object.fromEntries(lines.filter(([key]) => !key.endsWith("_page")));
}

const LANGUAGES = { german: said(german), english: said(english) };
const QUESTION: Question = {
  ...{ type: "question", item: "L1", text: "The robot successfully assisted me with the task.", points: 7, labels: [] },
  ...{ low: "strongly disagree", high: "strongly agree", number: 2, count: 4, previous_answer: null },
};

const SAID = Object.values(LANGUAGES).flatMap((texts) => Object.entries(texts));

/** In a headset's pixels. */
const smallest = (content: Partial<PanelContent>) => PIXELS_PER_DEGREE * smallestDeg(content);

describe("a notice", () => {
  const contents: Partial<PanelContent>[] = [
    ...[{}, { again: true }, { confirms: true }, { goesOn: true, prefers: true }, { rests: true }].map((each) => ({ text: "Oh", ...each })),
    ...[3, 7, 21, 100].map((points) => ({ question: { ...QUESTION, points }, text: QUESTION.text })),
    { text: "Oh", goesOn: true, body: { type: "body", sex: "woman", skin_tone: "fair", skin_tones: ["fair", "dark"], skin_tones_rgb: [[1, 1, 1], [0, 0, 0]] } },
  ];

  it.each(contents)("covers no button: %o", (content) => {
    const { context } = notingCanvas();
    const whole: PanelContent = { ...NOTHING, ...content, notice: "x".repeat(200) };
    let top = 0;
    let bottom = 0;
    context.roundRect = (_x: number, y: number, _width: number, height: number) => void ([top, bottom] = [y, y + height]);
    paint(context, whole, buttonsOf(whole), null);
    expect(top).toBeGreaterThanOrEqual(0);
    expect(bottom - top).toBeGreaterThanOrEqual(128);
    for (const { y, height } of buttonsOf(whole)) expect(bottom < y || top > y + height).toBe(true);
  });
});

describe("the smallest texts on the panel", () => {
  it("are 23 pixels of a headset high where they say what to do, and 20 above a countdown", () => {
    for (const [key, text] of SAID) {
      expect(smallest({ text }), key).toBeGreaterThan(23);
      expect(smallest({ text, secondsLeft: 5 }), key).toBeGreaterThan(20);
    }
  });

  it("are 23 pixels high beside the buttons that measure again and go on", () => {
    for (const { check } of Object.values(LANGUAGES)) expect(smallest({ text: check!, again: true })).toBeGreaterThan(23);
  });

  it("are 17 pixels high in a notice", () => {
    for (const [key, notice] of SAID) expect(smallest({ notice }), key).toBeGreaterThan(17);
  });

  it.each([3, 7, 11, 21, 100])("are 19 pixels high in a question of %i points", (points) => {
    expect(smallest({ question: { ...QUESTION, points }, text: QUESTION.text })).toBeGreaterThan(19);
  });

  it("are 23 pixels high in a label", () => {
    expect(smallest({ label: TEXTS.de.texts.trial })).toBeGreaterThan(23);
  });
});
