import { element } from "./dom";
import type { Question } from "../generated/messages";
import { isLine, labelOf, saysItsEnds } from "../panel/questionnaire";
import type { Texts } from "./texts";

/** The answers to a question on the page: buttons, or a slider for long scales. */
export class AnswerScale {
  /** Whether the last answer came from the keyboard; then the next question receives the focus. */
  byKeyboard = false;
  private readonly points = element("points");
  private shown: Question | null = null;

  constructor(private readonly answer: (value: number) => void) {}

  /** Shows a question and its present or earlier answer. */
  show(question: Question | null, answered: number | null, texts: Texts): void {
    if (question && question !== this.shown) this.fill(question, texts);
    this.shown = question;
    for (const button of this.points.querySelectorAll("button")) {
      button.disabled = answered !== null;
      button.setAttribute("aria-pressed", String(Number(button.value) === (answered ?? question?.previous_answer)));
    }
  }

  private fill(question: Question, texts: Texts): void {
    const { points, labels, low, high } = question;
    const ends = { low: [1, low], high: [points, high] } as const;
    for (const [id, [value, meaning]] of Object.entries(ends))
      element(id).textContent = isLine(question) ? meaning : texts.get("anchor", { value: labelOf(question, value), meaning });
    element("anchors").hidden = saysItsEnds(question) && !isLine(question);
    this.points.classList.toggle("texts", labels.some((label) => label.length > 3));
    this.points.classList.toggle("line", isLine(question));
    if (isLine(question)) this.points.replaceChildren(...this.line(question, texts));
    else this.points.replaceChildren(...Array.from({ length: points }, (_, at) => this.button(at + 1, question)));
    if (this.byKeyboard) this.points.querySelector<HTMLElement>("button, input")?.focus();
  }

  private button(value: number, question: Question): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.value = String(value);
    button.textContent = labelOf(question, value);
    button.addEventListener("click", (event) => {
      this.byKeyboard = event.detail === 0;
      this.answer(value);
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
    const choose = () => {
      line.classList.remove("untouched");
      take.value = line.value;
      take.hidden = false;
      line.setAttribute("aria-valuetext", labelOf(question, Number(line.value)));
    };
    line.classList.add("untouched");
    take.hidden = true;
    if (previous_answer !== null) choose();
    for (const event of ["input", "pointerdown", "change"]) line.addEventListener(event, choose);
    take.addEventListener("click", (event) => {
      this.byKeyboard = event.detail === 0;
      this.answer(Number(take.value));
    });
    return [line, take];
  }
}
