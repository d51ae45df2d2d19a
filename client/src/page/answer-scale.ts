import { element } from "./dom";
import type { Question } from "../generated/messages";
import { isLine, labelOf, saysItsEnds } from "../panel/questionnaire";
import { segmentLabel, segmentsOf, type Segment } from "../panel/segments";
import type { Texts } from "./texts";

/** The chosen segment of a long scale; null: none yet. */
interface Stage {
  segment: Segment | null;
}

/** The answers to a question on the page: buttons; for long scales a slider, or segments without a pointer. */
export class AnswerScale {
  /** Whether the last answer came from the keyboard; then the next question receives the focus. */
  byKeyboard = false;
  private readonly points = element("points");
  private shown: Question | null = null;
  private stage: Stage | null = null;

  /** `choose`: called with the value of a button, which is an answer or a segment. */
  constructor(private readonly choose: (value: number) => void) {}

  /** Shows a question and its present or earlier answer. `stage`: long scales are shown in segments. */
  show(question: Question | null, answered: number | null, texts: Texts, stage: Stage | null = null): void {
    const staged = stage && question && isLine(question) ? stage : null;
    const changed = question !== this.shown || staged?.segment !== this.stage?.segment || !staged !== !this.stage;
    this.stage = staged;
    if (question && changed) this.fill(question, texts);
    this.shown = question;
    for (const button of this.points.querySelectorAll("button")) {
      button.disabled = answered !== null;
      button.setAttribute("aria-pressed", String(Number(button.value) === (answered ?? question?.previous_answer)));
    }
  }

  private fill(question: Question, texts: Texts): void {
    const { points, labels, low, high } = question;
    const ends = { low: [1, low], high: [points, high] } as const;
    const slides = isLine(question) && !this.stage;
    for (const [id, [value, meaning]] of Object.entries(ends))
      element(id).textContent = isLine(question) ? meaning : texts.get("anchor", { value: labelOf(question, value), meaning });
    element("anchors").hidden = saysItsEnds(question) && !isLine(question);
    this.points.classList.toggle("texts", labels.some((label) => label.length > 3));
    this.points.classList.toggle("line", slides);
    if (slides) this.points.replaceChildren(...this.line(question, texts));
    else this.points.replaceChildren(...this.buttons(question));
    if (this.byKeyboard) this.points.querySelector<HTMLElement>("button, input")?.focus();
  }

  private buttons(question: Question): HTMLButtonElement[] {
    const segments = this.stage ? segmentsOf(question) : [];
    const { segment } = this.stage ?? { segment: null };
    if (segments.length > 0 && !segment) return segments.map((each) => this.button(each.value, segmentLabel(question, each)));
    const { first, last } = segment ?? { first: 1, last: question.points };
    return Array.from({ length: last - first + 1 }, (_, at) => this.button(first + at, labelOf(question, first + at)));
  }

  private button(value: number, label: string): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.value = String(value);
    button.textContent = label;
    button.addEventListener("click", (event) => {
      this.byKeyboard = event.detail === 0;
      this.choose(value);
    });
    return button;
  }

  /** A slider without an initial answer, so that none is suggested. */
  private line(question: Question, texts: Texts): HTMLElement[] {
    const { points, previous_answer } = question;
    const line = document.createElement("input");
    const value = String(previous_answer ?? Math.ceil(points / 2));
    Object.assign(line, { type: "range", min: "1", max: String(points), step: "1", value });
    line.setAttribute("aria-label", texts.get("slide"));
    line.setAttribute("aria-describedby", "statement anchors");
    const take = document.createElement("button");
    take.type = "button";
    take.textContent = texts.get("take_answer");
    const move = () => {
      line.classList.remove("untouched");
      take.value = line.value;
      take.hidden = false;
      line.setAttribute("aria-valuetext", labelOf(question, Number(line.value)));
    };
    line.classList.add("untouched");
    take.hidden = true;
    if (previous_answer !== null) move();
    for (const event of ["input", "pointerdown", "change"]) line.addEventListener(event, move);
    take.addEventListener("click", (event) => {
      this.byKeyboard = event.detail === 0;
      this.choose(Number(take.value));
    });
    return [line, take];
  }
}
