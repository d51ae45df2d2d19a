import { canChooseBody } from "../panel/body-choice";
import {
  awaitsReady,
  canBeStopped,
  confirmsAnswers,
  linkText,
  mayGoBack,
  mayPrefer,
  mayRecalibrate,
  mayRest,
  phaseLabel,
  type DisplayState,
} from "../session/display-state";
import { element } from "./dom";
import { setUpCodeForm } from "./code-form";
import type { ParticipantBody, BodyChoice, InputProfileMessage, PhaseDescription, PresentationPreferences } from "../generated/messages";
import { AnswerScale } from "./answer-scale";
import { PageTargets } from "./page-targets";
import type { InputKind } from "../input/input-kind";
import { PRESENTATION } from "../input/input-profile";
import type { Allowed } from "../session/haptics-and-sounds";
import { ENGLISH_TEXTS, type Key, type Texts } from "./texts";

const SENSES = ["haptics", "sounds"] as const;
/** The default font size, px. */
const TEXT_PX = 16;
/** How to select on the page, by kind of input. */
const BY_INPUT: Readonly<Partial<Record<InputKind, Key>>> = {
  dwell: "by_dwell",
  scan: "by_scan",
  step: "by_step",
  remote: "by_remote",
};

export interface PageEvents {
  toggleVR(): void;
  toggleDesktop(): void;
  ready(): void;
  recalibrate(): void;
  rest(): void;
  prefer(): void;
  stop(): void;
  back(): void;
  answer(value: number): void;
  chooseBody(choice: BodyChoice): void;
}

/** The texts and controls of the page. */
export class Page {
  readonly view = element("view");
  readonly card = element("card");
  readonly handButtons = element("hand").querySelectorAll("button");
  private readonly enter = element<HTMLButtonElement>("enter");
  private readonly play = element<HTMLButtonElement>("play");
  private readonly sex = element<HTMLSelectElement>("sex");
  private readonly tone = element<HTMLSelectElement>("skin-tone");
  readonly targets = new PageTargets();
  private readonly scale: AnswerScale;
  private readonly shownTexts = new Map<string, string>();
  private texts = ENGLISH_TEXTS;
  private presenting = false;
  private playing = false;
  /** Whether this is the experimenter's page, which may always stop the robot. */
  commands = false;

  constructor(
    private readonly isSpectator: boolean,
    private readonly events: PageEvents,
  ) {
    this.scale = new AnswerScale((value) => events.answer(value));
    this.enter.addEventListener("click", () => events.toggleVR());
    this.play.addEventListener("click", () => events.toggleDesktop());
    element("ready").addEventListener("click", () => events.ready());
    element("stop").addEventListener("pointerdown", () => events.stop());
    element("stop").addEventListener("click", ({ detail }) => detail === 0 && events.stop());
    element("again").addEventListener("click", () => events.recalibrate());
    element("rest").addEventListener("click", () => events.rest());
    element("prefer").addEventListener("click", () => events.prefer());
    element("back").addEventListener("click", () => events.back());
    for (const select of [this.sex, this.tone]) select.addEventListener("change", () => this.chooseBody());
    for (const sense of SENSES) remember(element<HTMLInputElement>(sense));
    element<HTMLDetailsElement>("help").open = window.innerHeight > 620 && window.innerWidth > 720;
    setUpCodeForm(() => this.texts);
    this.speak(ENGLISH_TEXTS);
  }

  /** Shows how the participant selects without pointing. */
  showInput({ stops }: InputProfileMessage, kind: InputKind): void {
    this.targets.use(kind);
    const by = BY_INPUT[kind];
    const stop = stops?.includes("experimenter") ? this.texts.get("stop_by_experimenter") : "";
    this.text("input-help", by ? [this.texts.get(by), stop].filter(Boolean).join(" ") : "");
    element("input-help").hidden = !by;
  }

  /** Changes font size, contrast and the card's side. */
  present({ text_deg, contrast, position }: PresentationPreferences): void {
    document.documentElement.style.fontSize = `${(TEXT_PX * text_deg) / PRESENTATION.text_deg}px`;
    const { classList } = document.body;
    classList.toggle("high-contrast", contrast === "high");
    for (const side of ["left", "right"]) classList.toggle(`card-${side}`, position === side);
  }

  /** Shows the caption of a sound; an empty text hides it. */
  caption(text: string): void {
    this.text("caption", text);
    element("caption").hidden = !text;
  }

  /** Shows all texts in this language. */
  speak(texts: Texts): void {
    this.texts = texts;
    texts.applyTo(document);
    for (const option of this.tone.options) option.text = texts.get(option.value as Key);
    this.updateActionLabels();
  }

  /** Marks the language of the phase text on watchers' pages. */
  markAsParticipants(texts: Texts): void {
    Object.assign(element("phase-text"), { lang: texts.language, dir: texts.direction });
  }

  /** Empty: VR is available. */
  setVRUnavailableReason(reason: string): void {
    this.enter.disabled = reason !== "";
    this.text("reason", reason);
  }

  setPresenting(presenting: boolean): void {
    document.body.classList.toggle("presenting", presenting);
    this.presenting = presenting;
    this.updateActionLabels();
    this.enter.blur();
  }

  /** Whether the server shows an environment without a session. */
  setViewing(onShow: boolean): void {
    document.body.classList.toggle("on-show", onShow);
  }

  /** HapticAndAudioFeedback enabled by the participant. */
  get senses(): Allowed {
    const [haptics, sounds] = SENSES.map((sense) => element<HTMLInputElement>(sense).checked);
    return { haptics: haptics!, sounds: sounds! };
  }

  /** Hides the loading message when a scene is displayed. */
  setSceneLoaded(): void {
    document.body.classList.remove("sceneless");
    element("loading").hidden = true;
  }

  setPlaying(playing: boolean): void {
    this.playing = playing;
    document.body.classList.toggle("playing", playing);
    this.updateActionLabels();
    element("play-help").hidden = element("hand").hidden = !playing;
    element("help").hidden = playing;
    this.enter.hidden = element("reason").hidden = playing;
    this.play.blur();
  }

  private updateActionLabels(): void {
    this.enter.textContent = this.texts.get(this.presenting ? "leave" : "enter");
    this.play.textContent = this.texts.get(this.playing ? "end_play" : "play");
  }

  /** Shows the form for session codes instead of the controls. */
  showCodeForm(): void {
    for (const id of ["take-part", "help", "loading", "body"]) element(id).hidden = true;
    element("entrance").hidden = false;
  }

  /** Hides the participant's controls on watchers' pages. */
  hideParticipation(): void {
    element("take-part").hidden = element("help").hidden = true;
  }

  /** Notes that the last answer came from the keyboard. */
  noteKeyboardAnswer(): void {
    this.scale.byKeyboard = true;
  }

  show(display: DisplayState): void {
    const { texts, phase, question, problem, secondsLeft } = display;
    const confirms = confirmsAnswers(phase) && !question;
    const hadFocus = this.card.contains(document.activeElement);
    element("status").dataset["link"] = display.link;
    this.text("status-words", linkText(display));
    this.text("problem", problem ?? "");
    this.text("phase-label", this.isSpectator ? "" : phaseLabel(phase, texts));
    this.text("phase-text", (this.isSpectator ? phase?.text : phase?.page_text || phase?.text) ?? "");
    this.text("countdown", secondsLeft === null ? "" : texts.get("seconds", { seconds: secondsLeft }));
    this.text("ready", texts.get(confirms ? "done" : "go_on"));
    element("problem").hidden = !problem;
    element("emergency").hidden = !this.commands && !(display.participates && canBeStopped(phase));
    element("ready").hidden = this.isSpectator || (!confirms && !(display.participates && awaitsReady(phase)));
    element("again").hidden = !display.participates || !mayRecalibrate(phase);
    element("rest").hidden = !display.participates || !mayRest(phase);
    element("prefer").hidden = !display.participates || !mayPrefer(phase);
    element("back").hidden = this.isSpectator || !mayGoBack(display);
    element("phase").hidden = !phase?.text || question !== null;
    this.showBody(display.body, phase);
    this.showQuestion(display);
    if (hadFocus && !this.card.contains(shownFocus())) this.keepFocus();
  }

  /** Moves the focus to the next control when the focused element is hidden. */
  private keepFocus(): void {
    const next = [element("points").querySelector("button"), element("ready"), element("phase-text")];
    next.find((each) => each && each.getClientRects().length > 0)?.focus();
  }

  private showBody(body: ParticipantBody | null, phase: PhaseDescription | null): void {
    element("body").hidden = body === null;
    element<HTMLFieldSetElement>("body").disabled = !canChooseBody(phase);
    if (!body) return;
    if (this.tone.options.length === 0)
      this.tone.append(...body.skin_tones.map((tone) => new Option(this.texts.get(tone as Key), tone)));
    this.sex.value = body.sex;
    this.tone.value = body.skin_tone;
  }

  private chooseBody(): void {
    const sex = this.sex.value as BodyChoice["sex"];
    this.events.chooseBody({ type: "choose_body", sex, skin_tone: this.tone.value });
  }

  private showQuestion({ question, answered, staged, segment }: DisplayState): void {
    element("question").hidden = question === null;
    if (question)
      this.text("question-label", this.texts.get("question", { number: question.number, count: question.count }));
    this.text("statement", question?.text ?? "");
    this.scale.show(question, answered, this.texts, staged ? { segment } : null);
  }

  /** Sets a text only if it changes, because screen readers announce every change. */
  private text(id: string, text: string): void {
    if (this.shownTexts.get(id) === text) return;
    this.shownTexts.set(id, text);
    element(id).textContent = text;
  }
}

/** The focused element, if it is visible. */
function shownFocus(): Element | null {
  const focused = document.activeElement;
  return focused && focused.getClientRects().length > 0 ? focused : null;
}

/** Stores the state of a check box in this browser. */
function remember(box: HTMLInputElement): void {
  box.checked = localStorage.getItem(box.id) !== "off";
  box.addEventListener("change", () => localStorage.setItem(box.id, box.checked ? "on" : "off"));
}

/** Whether a key press stops the robot: Escape, or Space unless a control has the focus. */
export function isStopKey(event: KeyboardEvent): boolean {
  if (event.repeat) return false;
  const onControl = event.target instanceof Element && event.target.closest("button, summary, a, input, select, label") !== null;
  return event.key === "Escape" || (event.key === " " && !onControl);
}
