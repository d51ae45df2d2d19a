import { CONTROLLERS } from "../../src/input/input-profile";
import { describe, expect, it } from "vitest";
import { sessionText } from "../../src/dashboard/live-session";
import { Refusal, type ConditionResults, type Participant, type Trial } from "../../src/dashboard/study-api";
import {
  beginText,
  paragraphs,
  participantsTable,
  participantText,
  resultsTable,
  resultsText,
  trialsTable,
} from "../../src/dashboard/tables";

const TRIAL: Trial = {
  position: 2,
  task: "ScratchItch",
  robot: "PR2",
  policy: "A",
  practice: false,
  state: "planned",
  attempts: ["stopped", "completed"],
  success: null,
  reward: null,
  questionnaire_open: false,
};

const PERSON: Participant = {
  participant: "sub-001",
  state: "allocated",
  may_become: ["completed", "withdrawn"],
  simulated: false,
  sex: "woman",
  age_years: 22,
  identified: true,
  language: "en",
  direction: "ltr",
  consent: "",
  inclusion: {},
  scores: [],
  consented_at: null,
  consent_version: null,
  must_reconsent: false,
  consents: [],
  missing_consent: "",
  respondent: "participant",
  furniture: null,
  preferences: null,
  preferences_words: "",
  sessions: [],
      input: { ...CONTROLLERS },
      input_words: "controllers",
  trials: [TRIAL],
  notes: [],
      adverse_events: [],
      safety_events: [],
};

const RESULTS: ConditionResults = {
  task: "BedBathing",
  robot: "Jaco",
  policy: "B",
  simulated: true,
  trials: 3,
  success_rate: 2 / 3,
  reward_mean: -12.34,
  answer_means: { L2: 4.333 },
};

describe("tables", () => {
  it("say in words who takes part and how far they are", () => {
    const summary = { participant: "sub-003", state: "allocated", simulated: true, cell: 1, sessions: 2 };
    const { rows } = participantsTable([{ ...summary, trials_completed: 4, trials: 20 }], "sub-003");
    expect(rows).toEqual([["sub-003", "allocated, simulated, in session", "4 of 20", "2"]]);
    expect(participantsTable([], null).caption).toBe("Nobody is enrolled yet.");
  });

  it("have a line for each trial", () => {
    const done = { ...TRIAL, position: 1, practice: true, success: false, reward: 3.14, attempts: [] };
    expect(trialsTable([TRIAL, done]).rows).toEqual([
      ["2", "scratch itch", "PR2", "A", "planned", "stopped, completed", "–"],
      ["1, practice", "scratch itch", "PR2", "A", "planned", "–", "3.1, no success"],
    ]);
  });

  it("have a column for each statement that was answered", () => {
    const { head, rows } = resultsTable([RESULTS, { ...RESULTS, answer_means: {} }], ["L1", "L2"]);
    expect(head.at(-1)).toBe("Mean L2");
    expect(rows[0]).toEqual(["bed bathing", "Jaco", "B", "simulated", "3", "67 %", "-12.3", "4.3"]);
    expect(rows[1]!.at(-1)).toBe("–");
    expect(rows.every((row) => row.length === head.length)).toBe(true);
  });
});

describe("words", () => {
  it("tell what comes next", () => {
    expect(participantText(PERSON, false)).toBe(
      "allocated; woman; 22 years; reads en; name stored; no consent yet. Next: begin.",
    );
    expect(participantText({ ...PERSON, state: "enrolled" }, false)).toMatch(/record their consent\.$/);
    expect(participantText({ ...PERSON, must_reconsent: true }, false)).toMatch(/consent to the new version of the text\.$/);
    expect(participantText(PERSON, true)).toMatch(/Their session runs\.$/);
    expect(beginText(PERSON)).toBe("Begin session");
    expect(beginText({ ...PERSON, trials: [{ ...TRIAL, state: "completed" }] })).toMatch(/^Continue/);
  });

  it("say what letters mean only where there are any", () => {
    expect(resultsText(true)).toContain("blind");
    expect(resultsText(false)).not.toContain("blind");
  });

  it("tell where the session stands", () => {
    const phase = { type: "phase", name: "free_before", text: "Move.", trial: 2, trials: 5, page_text: "", texts_by_input: {}, key: "", preferences: false } as const;
    expect(sessionText({ ...phase, practice: false, seconds: 5 })).toBe("Free movement before the robot starts.");
    for (const none of [null, { ...phase, trials: 0, practice: false, seconds: null }])
      expect(sessionText(none)).toBe("No session runs here.");
    const asked = { ...phase, name: "questionnaire", text: "Please answer.", trial: 0, trials: 0 } as const;
    expect(sessionText({ ...asked, practice: false, seconds: null })).toBe("The participant answers questions.");
  });

  it("keep paragraphs and mend broken lines", () => {
    expect(paragraphs("one\ntwo\n\nthree\n")).toBe("one two\n\nthree");
  });

  it("repeat the server's reason for a refusal", () => {
    expect(new Refusal(409, '{"detail": "no session"}').message).toBe("no session");
    for (const text of ["<html>", "{}", '{"detail": [1]}'])
      expect(new Refusal(500, text).message).toBe("the server answered with status 500");
    expect(new Refusal(409, '{"detail": "sub-001?", "confirm": "duplicate"}').confirm).toBe("duplicate");
    expect(new Refusal(409, '{"detail": "no session"}').confirm).toBeNull();
  });
});
