import { mayChooseBody } from "./bodychoice";
import { awaitsReady, canBeStopped, linkWords, mayRecalibrate, phaseLabel, type Display } from "./display";
import { element } from "./element";
import type { Body, ChooseBody, Phase, Question } from "./messages";
import { labelOf, saysItsEnds } from "./questionnaire";
import type { Allowed } from "./senses";
import { onThePage } from "./words";

const SENSES = ["haptics", "sounds"] as const;

export interface PageEvents {
  enterOrLeave(): void;
  playOrEnd(): void;
  ready(): void;
  recalibrate(): void;
  stop(): void;
  answer(value: number): void;
  chooseBody(choice: ChooseBody): void;
}

/** The words and buttons over the flat view. */
export class Page {
  readonly view = element("view");
  readonly card = element("card");
  private readonly enter = element<HTMLButtonElement>("enter");
  private readonly play = element<HTMLButtonElement>("play");
  private readonly sex = element<HTMLSelectElement>("sex");
  private readonly tone = element<HTMLSelectElement>("skin-tone");
  private shown: Question | null = null;
  /** Whether the latest answer came from the keyboard, which then stays at the answers. */
  private byKeyboard = false;
  private readonly texts = new Map<string, string>();

  constructor(private readonly events: PageEvents) {
    this.enter.addEventListener("click", () => events.enterOrLeave());
    this.play.addEventListener("click", () => events.playOrEnd());
    element("ready").addEventListener("click", () => events.ready());
    element("stop").addEventListener("pointerdown", () => events.stop());
    element("stop").addEventListener("click", ({ detail }) => detail === 0 && events.stop());
    element("again").addEventListener("click", () => events.recalibrate());
    for (const select of [this.sex, this.tone]) select.addEventListener("change", () => this.chooseBody());
    for (const sense of SENSES) remember(element<HTMLInputElement>(sense));
    element<HTMLDetailsElement>("help").open = window.innerHeight > 620 && window.innerWidth > 720;
  }

  /** Empty: VR can be entered. */
  setReason(reason: string): void {
    this.enter.disabled = reason !== "";
    this.text("reason", reason);
  }

  setPresenting(presenting: boolean): void {
    document.body.classList.toggle("presenting", presenting);
    this.enter.textContent = presenting ? "Leave VR" : "Enter VR";
    this.enter.blur();
  }

  /** What the participant wants to feel and hear. */
  get senses(): Allowed {
    const [haptics, sounds] = SENSES.map((sense) => element<HTMLInputElement>(sense).checked);
    return { haptics: haptics!, sounds: sounds! };
  }

  /** A scene is shown: there is more to see than an empty room. */
  setFurnished(): void {
    document.body.classList.remove("sceneless");
    element("loading").hidden = true;
  }

  setPlaying(playing: boolean): void {
    this.play.textContent = playing ? "Stop playing" : "Play without a headset";
    element("play-help").hidden = !playing;
    element("help").hidden = playing;
    this.enter.hidden = element("reason").hidden = playing;
    this.play.blur();
  }

  /** Whoever only watches takes no part. */
  hideTakingPart(): void {
    element("take-part").hidden = element("help").hidden = true;
  }

  show(display: Display): void {
    const { phase, question, problem, secondsLeft } = display;
    element("status").dataset["link"] = display.link;
    this.text("status-words", linkWords(display));
    const words = display.plays ? onThePage : (text: string) => text;
    this.text("problem", words(problem ?? ""));
    this.text("phase-label", phaseLabel(phase));
    this.text("phase-text", words(phase?.text ?? ""));
    this.text("countdown", secondsLeft === null ? "" : `${secondsLeft} s`);
    element("problem").hidden = !problem;
    element("emergency").hidden = !display.takesPart || !canBeStopped(phase);
    element("go-on").hidden = !display.takesPart || !awaitsReady(phase);
    element("again").hidden = !mayRecalibrate(phase);
    element("phase").hidden = !phase?.text || question !== null;
    this.showBody(display.body, phase);
    this.showQuestion(question, display.answered);
  }

  private showBody(body: Body | null, phase: Phase | null): void {
    element("body").hidden = body === null;
    element<HTMLFieldSetElement>("body").disabled = !mayChooseBody(phase);
    if (!body) return;
    if (this.tone.options.length === 0)
      this.tone.append(...body.skin_tones.map((tone) => new Option(tone, tone)));
    this.sex.value = body.sex;
    this.tone.value = body.skin_tone;
  }

  private chooseBody(): void {
    const sex = this.sex.value as ChooseBody["sex"];
    this.events.chooseBody({ type: "choose_body", sex, skin_tone: this.tone.value });
  }

  private showQuestion(question: Question | null, answered: number | null): void {
    element("question").hidden = question === null;
    if (question && question !== this.shown) this.fillQuestion(question);
    this.shown = question;
    for (const button of element("points").querySelectorAll("button")) {
      button.disabled = answered !== null;
      button.setAttribute("aria-pressed", String(Number(button.value) === answered));
    }
  }

  private fillQuestion(question: Question): void {
    this.text("question-label", `Question ${question.number} of ${question.count}`);
    this.text("statement", question.text);
    this.text("low", `${labelOf(question, 1)}: ${question.low}`);
    this.text("high", `${labelOf(question, question.points)}: ${question.high}`);
    element("anchors").hidden = saysItsEnds(question);
    const values = Array.from({ length: question.points }, (_, at) => at + 1);
    const points = element("points");
    points.classList.toggle("words", question.labels.some((label) => label.length > 3));
    points.replaceChildren(...values.map((value) => this.pointButton(value, labelOf(question, value))));
    if (this.byKeyboard) points.querySelector("button")?.focus();
  }

  private pointButton(value: number, label: string): HTMLButtonElement {
    const button = document.createElement("button");
    button.type = "button";
    button.value = String(value);
    button.textContent = label;
    button.addEventListener("click", (event) => {
      this.byKeyboard = event.detail === 0;
      this.events.answer(value);
    });
    return button;
  }

  /** Sets a text only when it changes: screen readers announce every change. */
  private text(id: string, text: string): void {
    if (this.texts.get(id) === text) return;
    this.texts.set(id, text);
    element(id).textContent = text;
  }
}

/** Keeps a check box as it was set, on this device. */
function remember(box: HTMLInputElement): void {
  box.checked = localStorage.getItem(box.id) !== "off";
  box.addEventListener("change", () => localStorage.setItem(box.id, box.checked ? "on" : "off"));
}

/** Whether a key press asks the robot to stop: Escape anywhere, Space unless it presses a button. */
export function isStopKey(event: KeyboardEvent): boolean {
  if (event.repeat) return false;
  const onControl = event.target instanceof Element && event.target.closest("button, summary, a, input, select, label") !== null;
  return event.key === "Escape" || (event.key === " " && !onControl);
}
