import { describe, expect, it } from "vitest";
import type { Question } from "../../src/generated/messages";
import { buttonsOf } from "../../src/panel/paint-panel";
import { panelContent } from "../../src/session/display-state";
import { segmentsOf } from "../../src/panel/segments";
import { ENGLISH_TEXTS } from "../../src/page/texts";

function question(points: number): Question {
  return { type: "question", item: "x", text: "How?", points, low: "no", high: "yes", labels: [], number: 2, count: 2, previous_answer: null };
}

function values(points: number, segment: number | null): number[] {
  const asked = question(points);
  const chosen = segment === null ? null : segmentsOf(asked)[segment]!;
  const nothing = { phase: null, body: null, answered: null, problem: null, secondsLeft: null, participates: true };
  const shown = { texts: ENGLISH_TEXTS, link: "connected", code: 0, input: "scan", question: asked, staged: true, segment: chosen } as const;
  return buttonsOf(panelContent({ ...shown, ...nothing })).map(({ value }) => value);
}

describe.each([12, 21, 100, 101])("a scale of %i points", (points) => {
  it("is covered by segments, each of them small", () => {
    const covered = segmentsOf(question(points)).flatMap((_, at) => values(points, at).filter((value) => value > 0));
    expect(covered).toEqual(Array.from({ length: points }, (_, at) => at + 1));
    for (const { first, last } of segmentsOf(question(points))) expect(last - first).toBeLessThan(11);
    expect(segmentsOf(question(points)).length).toBeLessThanOrEqual(11);
  });

  it("has Back in each of its segments", () => {
    expect(values(points, 0).at(-1)).toBe(-1);
  });
});

describe("a short scale", () => {
  it("has no segments", () => {
    expect(values(7, null)).toEqual([1, 2, 3, 4, 5, 6, 7, -1]);
  });
});
