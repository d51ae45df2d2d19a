import { describe, expect, it } from "vitest";
import type { Answer, Question } from "../../src/generated/messages";
import {
  Questionnaire,
  LONGEST_ROW,
  hitButton,
  labelOf,
  isLine,
  layoutButtons,
  layoutLine,
  layoutWords,
  saysItsEnds,
  type Box,
} from "../../src/panel/questionnaire";

const AREA: Box = { x: 70, y: 470, width: 1400, height: 250 };
const SCALES = [1, 2, 5, 7, LONGEST_ROW];

function question(item: string, labels: string[] = []): Question {
  return { type: "question", item, text: "?", points: 7, low: "no", high: "yes", labels, number: 1, count: 4, previous_answer: null };
}

describe.each(SCALES)("a scale of %i points", (points) => {
  const buttons = layoutButtons(points, AREA);

  it("has every value once, in order", () => {
    expect(buttons.map(({ value }) => value)).toEqual(Array.from({ length: points }, (_, at) => at + 1));
  });

  it("is hit in the middle of each button and nowhere outside", () => {
    for (const { x, y, width, height, value } of buttons) {
      expect(hitButton(buttons, x + width / 2, y + height / 2)).toBe(value);
      expect(hitButton(buttons, x - 1, y + height / 2)).toBeNull();
      expect(hitButton(buttons, x + width / 2, y + height + 1)).toBeNull();
    }
  });

  it("lies in its area, in the middle", () => {
    const left = Math.min(...buttons.map(({ x }) => x));
    const right = Math.max(...buttons.map(({ x, width }) => x + width));
    const bottom = Math.max(...buttons.map(({ y, height }) => y + height));
    expect(left).toBeGreaterThanOrEqual(AREA.x - 1e-6);
    expect(left + right).toBeCloseTo(2 * AREA.x + AREA.width, 6);
    expect(bottom).toBeLessThanOrEqual(AREA.y + AREA.height + 1e-6);
  });
});

describe.each([LONGEST_ROW + 1, 21, 100])("a line of %i points", (points) => {
  const places = layoutLine(points, AREA);

  it("is hit everywhere, from the lowest value at its left end to the highest at its right", () => {
    for (let pixel = 0.5; pixel < AREA.width; pixel++)
      expect(hitButton(places, AREA.x + pixel, AREA.y + 1)).toBe(1 + Math.floor((pixel / AREA.width) * points));
    expect(isLine({ ...question("a"), points })).toBe(true);
    expect(isLine({ ...question("a", Array(points).fill("rather")), points })).toBe(false);
  });
});

describe.each([2, 4, 7, 21])("a row of %i buttons with words", (points) => {
  const buttons = layoutWords(points, AREA, 150);

  it("has every value once, in order, and is hit in the middle of each", () => {
    expect(buttons.map(({ value }) => value)).toEqual(Array.from({ length: points }, (_, at) => at + 1));
    for (const { x, y, width, height, value } of buttons)
      expect(hitButton(buttons, x + width / 2, y + height / 2)).toBe(value);
  });

  it("fills the width of its area, no button overlaps another or is higher than wide", () => {
    expect(buttons[0]!.x).toBe(AREA.x);
    const last = buttons.at(-1)!;
    expect(last.x + last.width).toBeCloseTo(AREA.x + AREA.width, 6);
    buttons.slice(1).forEach(({ x }, at) => expect(x).toBeGreaterThan(buttons[at]!.x + buttons[at]!.width));
    for (const { width, height } of buttons) expect(height).toBeLessThanOrEqual(Math.min(width, 150));
  });
});

describe("words on buttons", () => {
  it("stand for the numbers, where there are any", () => {
    expect(labelOf(question("a"), 3)).toBe("3");
    expect(labelOf(question("a", ["none", "some", "much"]), 3)).toBe("much");
  });

  it("make the texts at the ends needless where they are the same", () => {
    expect(saysItsEnds(question("a"))).toBe(false);
    expect(saysItsEnds(question("a", ["0", "50", "100"]))).toBe(false);
    expect(saysItsEnds(question("a", ["no", "perhaps", "yes"]))).toBe(true);
  });
});

describe("answering", () => {
  const sent: Answer[] = [];
  const send = (answer: Answer) => sent.push(answer) > 0;

  it("sends the first press with the time since the question appeared", () => {
    const questionnaire = new Questionnaire();
    questionnaire.show(question("L1"), 1000);
    questionnaire.answer(3, 3500, send);
    questionnaire.answer(5, 3600, send);
    expect(sent.splice(0)).toEqual([{ type: "answer", item: "L1", value: 3, response_time_s: 2.5 }]);
    expect(questionnaire.answered).toBe(3);
  });

  it("ignores presses without a question", () => {
    const questionnaire = new Questionnaire();
    questionnaire.answer(3, 0, send);
    questionnaire.show(question("L1"), 0);
    questionnaire.clear();
    questionnaire.answer(3, 0, send);
    expect(sent).toEqual([]);
  });

  it("can be repeated when it could not be sent", () => {
    const questionnaire = new Questionnaire();
    questionnaire.show(question("L1"), 0);
    questionnaire.answer(3, 1000, () => false);
    expect(questionnaire.answered).toBeNull();
    questionnaire.answer(4, 2000, send);
    expect(sent.splice(0)[0]).toMatchObject({ value: 4, response_time_s: 2 });
  });

  it("counts from the first appearance when a question comes again after a lost connection", () => {
    const questionnaire = new Questionnaire();
    questionnaire.show(question("L1"), 1000);
    questionnaire.answer(3, 2000, send);
    questionnaire.show(question("L1"), 4000);
    questionnaire.answer(3, 6000, send);
    expect(sent.splice(0).map(({ response_time_s }) => response_time_s)).toEqual([1, 5]);
  });

  it("does not count the time in which the question cannot be seen or answered", () => {
    const questionnaire = new Questionnaire();
    questionnaire.show(question("L1"), 1000);
    questionnaire.block(true, 2000);
    questionnaire.block(true, 3000);
    questionnaire.show(question("L1"), 8000);
    questionnaire.block(false, 9000);
    questionnaire.block(false, 9500);
    questionnaire.answer(3, 10000, send);
    expect(sent.splice(0)[0]).toMatchObject({ item: "L1", response_time_s: 2 });
    questionnaire.block(true, 10500);
    questionnaire.show(question("L2"), 11000);
    questionnaire.block(false, 20000);
    questionnaire.answer(3, 20500, send);
    expect(sent.splice(0)[0]).toMatchObject({ item: "L2", response_time_s: 0.5 });
  });

  it("counts every new question from its own appearance", () => {
    const questionnaire = new Questionnaire();
    questionnaire.show(question("L1"), 1000);
    questionnaire.show(question("L2"), 4000);
    questionnaire.answer(1, 4500, send);
    expect(sent.splice(0)[0]).toMatchObject({ item: "L2", response_time_s: 0.5 });
  });
});
