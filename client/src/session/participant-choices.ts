import type { InputProfileMessage, OfferedTargets, PhaseDescription, TargetSelected, Question, SelectionTarget } from "../generated/messages";
import { canBeStopped, awaitsReady, confirmsAnswers } from "./display-state";
import type { Outgoing } from "./connection";
import { kindOfProfile, points, stopsBy, switchOfHand, type Switch } from "../input/input-profile";
import { FIRST_ICON } from "../input/command-icons";
import { Selection } from "../input/selection";
import { Switches } from "../input/switches";
import { AGAIN, BACK, DONE, GO_ON, PREFER, REST } from "../panel/paint-panel";
import type { Panel } from "../panel/panel";
import { Questionnaire } from "../panel/questionnaire";
import { segmentsOf, type Segment } from "../panel/segments";

export interface ChoiceEvents {
  send(message: Outgoing): boolean;
  /** A switch stops the robot. */
  stop(): void;
  /** What is displayed has changed. */
  changed(): void;
  /** Gives the robot command of an icon. */
  command(value: number): void;
  /** Activates a target of the page. */
  activate(value: number): void;
}

/** What the participant can select in the present phase, and what each selection does. */
export class ParticipantChoices {
  readonly questionnaire = new Questionnaire();
  readonly selection = new Selection(
    (value) => this.select(value),
    (offered: OfferedTargets) => this.events.send(offered),
  );
  readonly switches: Switches;
  /** The chosen segment of a long scale. */
  segment: Segment | null = null;
  /** Whether the participant is in VR; otherwise the page offers the targets. */
  presenting = false;
  phase: PhaseDescription | null = null;

  constructor(
    private readonly panel: Panel,
    private readonly events: ChoiceEvents,
  ) {
    this.switches = new Switches(
      () => this.profile,
      (which) => this.pressSwitch(which),
    );
  }

  get profile(): InputProfileMessage {
    return this.selection.profile;
  }

  /** Whether long scales are shown in segments. */
  get staged(): boolean {
    return !points(this.profile);
  }

  changeProfile(profile: InputProfileMessage): void {
    this.selection.change(profile, performance.now());
    this.segment = null;
  }

  ask(question: Question): void {
    this.questionnaire.show(question, performance.now());
    this.segment = null;
  }

  /** The questionnaire is over, or not visible. */
  clearQuestion(): void {
    this.questionnaire.clear();
    this.segment = null;
  }

  /** Offers what panel or page show now. */
  offer(targets: readonly SelectionTarget[]): void {
    const { phase, questionnaire, segment } = this;
    const { question } = questionnaire;
    const shown = [this.presenting, phase?.name, phase?.text, phase?.trial, question?.number, question?.item, segment?.value];
    this.selection.offer(targets, JSON.stringify([shown, targets]), performance.now());
    this.panel.offer = this.selection.number;
  }

  /** A source in VR was pressed. */
  pressSource(source: XRInputSource, pointed: { value: number | null; rests: boolean } | null): void {
    const { profile } = this;
    const kind = kindOfProfile(profile);
    if (kind === "scan" || kind === "step") return this.pressSwitch(switchOfHand(profile, source.handedness));
    if (!points(profile) || !pointed) return;
    const { value, rests } = pointed;
    if (rests && value !== GO_ON) return;
    if (value !== null) this.select(value);
    else if (awaitsReady(this.phase) && !confirmsAnswers(this.phase) && !this.questionnaire.question) this.select(GO_ON);
  }

  pressRemotely(pressed: TargetSelected): void {
    this.selection.pressRemotely(pressed);
  }

  private pressSwitch(which: Switch): void {
    if (stopsBy(this.profile, "switch") && canBeStopped(this.phase)) this.events.stop();
    else this.selection.press(which, performance.now());
  }

  private select(value: number): void {
    if (this.presenting) this.act(value);
    else this.events.activate(value);
  }

  /** Does what a target stands for. */
  act(value: number): void {
    const { question } = this.questionnaire;
    const choice = this.panel.choice(value);
    if (value >= FIRST_ICON) this.events.command(value);
    else if (value === BACK) this.goBack();
    else if (question) this.answer(value);
    else if (value === DONE || value === GO_ON) this.events.send({ type: "ready" });
    else if (value === AGAIN) this.events.send({ type: "recalibrate" });
    else if (value === REST) this.events.send({ type: "request_break" });
    else if (value === PREFER) this.events.send({ type: "change_preferences" });
    else if (choice) this.events.send(choice);
  }

  /** Sends an answer, or shows a segment of the scale. */
  answer(value: number): void {
    const { question } = this.questionnaire;
    const segment = question && segmentsOf(question).find((each) => each.value === value);
    if (segment) this.segment = segment;
    else this.questionnaire.answer(value, performance.now(), (answer) => this.events.send(answer));
    this.events.changed();
  }

  /** Goes back from a segment to the whole scale, or to the previous question. */
  goBack(): void {
    if (this.segment) {
      this.segment = null;
      this.events.changed();
    } else this.events.send({ type: "back" });
  }
}
