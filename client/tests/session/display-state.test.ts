import { describe, expect, it } from "vitest";
import { canChooseBody } from "../../src/panel/body-choice";
import { isRunning, linkText, panelContent, type DisplayState } from "../../src/session/display-state";
import type { ParticipantBody, PhaseDescription, Question } from "../../src/generated/messages";
import { bodiesOf, buttonsOf, wrap } from "../../src/panel/paint-panel";
import { hitButton } from "../../src/panel/questionnaire";
import { ENGLISH_TEXTS } from "../../src/page/texts";

const QUESTION: Question = {
  type: "question",
  item: "L1",
  text: "Safe?",
  points: 7,
  low: "no",
  high: "yes",
  labels: [],
  number: 2,
  count: 4,
  previous_answer: null,
};

const BODY: ParticipantBody = {
  type: "body",
  sex: "woman",
  skin_tone: "dark",
  skin_tones: ["light", "dark"],
  skin_tones_rgb: [
    [0.9, 0.7, 0.6],
    [0.3, 0.2, 0.2],
  ],
};

function phase(name: PhaseDescription["name"], text = "Texts"): PhaseDescription {
  return { type: "phase", name, text, trial: 3, trials: 8, practice: false, seconds: null, page_text: "", texts_by_input: {}, key: "", preferences: false };
}

function display(changes: Partial<DisplayState>): DisplayState {
  const nothing = { phase: null, body: null, question: null, answered: null, problem: null, secondsLeft: null, participates: true, staged: false, segment: null };
  return { texts: ENGLISH_TEXTS, link: "connected", code: 0, input: "trigger", ...nothing, ...changes };
}

describe("the panel", () => {
  it("shows the texts of a phase with its countdown", () => {
    const content = panelContent(display({ phase: phase("countdown"), secondsLeft: 3 }));
    expect(content).toMatchObject({
      label: "Trial 3 of 8",
      text: "Texts",
      secondsLeft: 3,
      question: null,
      notice: null,
    });
  });

  it("calls practice by its name", () => {
    expect(panelContent(display({ phase: { ...phase("countdown"), practice: true } }))?.label).toBe(
      "Practice",
    );
  });

  it("is away during a trial, but not when something is wrong", () => {
    expect(panelContent(display({ phase: phase("trial") }))).toBeNull();
    expect(panelContent(display({ phase: phase("trial"), problem: "Oh" }))).toMatchObject({
      text: "",
      notice: "Oh",
    });
    expect(panelContent(display({ phase: phase("trial"), link: "lost" }))?.notice).toContain(
      "Connection lost",
    );
  });

  it("says how to select with what the participant has", () => {
    const pressing = { ...phase("ready", "Press the trigger."), texts_by_input: { pinch: "Pinch." } };
    const texts = (["trigger", "pinch", "tap"] as const).map((input) => panelContent(display({ phase: pressing, input }))?.text);
    expect(texts).toEqual(["Press the trigger.", "Pinch.", "Press the trigger."]);
  });

  it("puts the question in the place of the phase's texts", () => {
    const content = panelContent(
      display({ phase: phase("questionnaire"), question: QUESTION, secondsLeft: 9 }),
    );
    expect(content).toMatchObject({ label: "2 of 4", text: "Safe?", question: QUESTION, secondsLeft: null });
  });
});

describe("the bodies to choose", () => {
  const calibration = display({ phase: phase("calibration"), body: BODY });

  it("are on the panel only while the participant is measured", () => {
    expect(buttonsOf(panelContent(calibration)).length).toBe(5);
    expect(bodiesOf(panelContent({ ...calibration, phase: phase("check") }))).toEqual([]);
    expect(buttonsOf(panelContent({ ...calibration, question: QUESTION })).length).toBe(QUESTION.points + 1);
  });

  it("change one thing at a time, and mark what is chosen", () => {
    const buttons = bodiesOf(panelContent(calibration));
    expect(buttons.map(({ chosen }) => chosen)).toEqual([true, false, false, true]);
    expect(buttons.map(({ message }) => [message.sex, message.skin_tone])).toEqual([
      ["woman", "dark"],
      ["man", "dark"],
      ["woman", "light"],
      ["woman", "dark"],
    ]);
  });

  it("have buttons of their own that do not overlap", () => {
    for (const button of bodiesOf(panelContent(calibration))) {
      const [x, y] = [button.x + button.width / 2, button.y + button.height / 2];
      expect(hitButton(bodiesOf(panelContent(calibration)), x, y)).toBe(button.value);
    }
  });

  it("may be chosen while no trial runs", () => {
    const allowed = (["waiting", "calibration", "check", "paused", "trial", "questionnaire"] as const).map((name) =>
      canChooseBody(phase(name)),
    );
    expect(allowed).toEqual([true, true, true, true, false, false]);
  });
});

describe("the connection in texts", () => {
  it("says why, when the server gave a reason", () => {
    expect(linkText(display({ link: "refused", code: 4403 }))).toBe(
      ENGLISH_TEXTS.get("earlier_start"),
    );
    expect(linkText(display({ link: "connected" }))).toBe("Connected to the server");
  });
});

describe("the stop key", () => {
  it("works while person or robot may move", () => {
    const running = (["waiting", "countdown", "trial", "free_after", "questionnaire"] as const).map((name) =>
      isRunning(phase(name)),
    );
    expect(running).toEqual([false, true, true, true, false]);
    expect(isRunning(null)).toBe(false);
  });
});

describe("breaking lines", () => {
  const measure = (line: string) => line.length;

  it("loses no word and keeps the width", () => {
    const text = "The robot successfully helped me with the task.";
    const lines = wrap(text, 16, measure);
    expect(lines.join(" ")).toBe(text);
    expect(Math.max(...lines.map(measure))).toBeLessThanOrEqual(16);
  });

  it("keeps previous_answer line ends and texts that are too long", () => {
    expect(wrap("a\n\nlongestword b", 5, measure)).toEqual(["a", "", "longestword", "b"]);
  });
});

describe("the preferences for the robot", () => {
  it.each([["check", [-3, -6, -4]], ["ready", [-4, -5, -6]], ["paused", [-4, -6]]] as const)("have a button in phase %s", (name, values) => {
    for (const preferences of [true, false]) {
      const content = panelContent(display({ phase: { ...phase(name), preferences } }));
      const expected = values.filter((value) => preferences || value !== -6);
      expect(buttonsOf(content).map(({ value }) => value)).toEqual(expected);
    }
  });
});
