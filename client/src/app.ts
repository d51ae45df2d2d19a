import { Quaternion, Vector3 } from "three";
import { Connection, type Link } from "./connection";
import { isRunning, panelContent, type Display } from "./display";
import type { Phase, Scene, ServerMessage, State } from "./messages";
import { Page, isStopKey } from "./page";
import { Panel } from "./panel";
import { Pointer } from "./pointer";
import { Questionnaire } from "./questionnaire";
import { createRoom } from "./room";
import { ImmersiveSession, reasonAgainstVR } from "./session";
import { BACKLOG_LIMIT_BYTES, Throttle, Tracker, findSource } from "./tracking";
import { View, type Detail } from "./view";
import { World } from "./world";

const PROBLEM_SHOWN_MS = 6000;
const HANDS = ["left", "right"] as const;

/** The whole client: what the server says goes in, what the participant does goes out. */
export class App {
  readonly page = new Page({ enterOrLeave: () => void this.enterOrLeave(), answer: (value) => this.answer(value) });
  readonly view: View;
  readonly panel: Panel;
  readonly questionnaire = new Questionnaire();
  readonly tracker = new Tracker();
  phase: Phase | null = null;
  lastState: State | null = null;
  statesReceived = 0;

  private readonly world = new World();
  private readonly pointers = { left: new Pointer(), right: new Pointer() };
  private readonly throttle = new Throttle();
  private readonly session: ImmersiveSession;
  private readonly connection: Connection;
  private link: Link = "connecting";
  private linkReason = "";
  private problem: string | null = null;
  private problemTimer = 0;
  private phaseEndsMs = Infinity;
  private secondsLeft: number | null = null;
  private readonly head = new Vector3();
  private readonly forward = new Vector3();
  private readonly turn = new Quaternion();

  constructor(
    private readonly token: string,
    private readonly emulated: boolean,
    detail: Detail,
  ) {
    this.view = new View(this.page.view, this.page.card, detail);
    this.panel = new Panel(detail.anisotropy);
    this.session = new ImmersiveSession(this.view.renderer, {
      entered: () => this.entered(),
      left: () => this.left(),
      selected: (source, frame) => this.selected(source, frame),
      menuPressed: () => this.stop(),
      originReset: () => this.originReset(),
    });
    this.world.root.rotation.x = -Math.PI / 2;
    this.world.root.updateMatrixWorld();
    this.world.root.add(createRoom(detail));
    if (detail.lighting) this.view.reflect(this.world.root);
    this.view.scene.add(this.world.root, this.panel.mesh, this.pointers.left.group, this.pointers.right.group);
    this.view.standBefore(this.world.root);
    const url = new URL("ws", location.href.split("#")[0]);
    url.protocol = url.protocol.replace("http", "ws");
    url.search = "";
    this.connection = new Connection(url.href, token, emulated, {
      message: (message) => this.receive(message),
      link: (link, reason) => this.linked(link, reason),
    });
  }

  get presenting(): boolean {
    return this.session.presenting;
  }

  start(): void {
    this.connection.open();
    this.refresh();
    this.view.renderer.setAnimationLoop((timeMs, frame) => this.frame(timeMs, frame));
    window.addEventListener("keydown", (event) => this.key(event));
    navigator.xr?.addEventListener("devicechange", () => void this.checkVR());
    void this.checkVR();
  }

  // From the server

  private receive(message: ServerMessage): void {
    if (message.type === "state") return this.stateCame(message);
    if (message.type === "scene") void this.sceneCame(message);
    if (message.type === "phase") this.phaseCame(message);
    if (message.type === "question") this.questionnaire.show(message, performance.now());
    if (message.type === "problem") this.showProblem(message.message);
    if (message.type === "welcome") this.welcomed();
    this.refresh();
  }

  /** A new connection knows nothing of the participant in VR yet. */
  private welcomed(): void {
    this.world.forgetStates();
    if (this.presenting) this.connection.send({ type: "entered" });
  }

  private stateCame(state: State): void {
    this.statesReceived++;
    if (this.world.push(state, performance.now())) this.lastState = state;
  }

  private async sceneCame(scene: Scene): Promise<void> {
    try {
      const before = this.world.root.matrix.clone();
      const loading = this.world.load(scene, this.token);
      if (!this.world.root.matrix.equals(before)) this.view.standBefore(this.world.root);
      await loading;
    } catch (error) {
      this.showProblem(`The scene could not be loaded: ${words(error)}.`);
    }
  }

  private phaseCame(phase: Phase): void {
    this.phase = phase;
    this.phaseEndsMs = phase.seconds === null ? Infinity : performance.now() + phase.seconds * 1000;
    this.secondsLeft = secondsUntil(this.phaseEndsMs, performance.now());
    if (phase.name !== "questionnaire") this.questionnaire.clear();
  }

  private linked(link: Link, reason: string): void {
    this.link = link;
    this.linkReason = reason;
    this.refresh();
  }

  // From the participant

  private async enterOrLeave(): Promise<void> {
    if (this.presenting) return this.session.leave();
    if (this.emulated && !navigator.userActivation.isActive) {
      return this.showProblem("Enter VR needs a real click: a headset's browser would refuse this one.");
    }
    try {
      await this.session.enter(navigator.xr!);
    } catch (error) {
      this.showProblem(`VR could not be entered: ${words(error)}.`);
    }
  }

  private entered(): void {
    this.panel.unplace();
    this.showPresenting(true);
    this.connection.send({ type: "entered" });
  }

  private left(): void {
    for (const hand of HANDS) this.pointers[hand].hide();
    this.showPresenting(false);
    this.connection.send({ type: "left" });
  }

  private showPresenting(presenting: boolean): void {
    this.page.setPresenting(presenting);
    this.world.seeFromInside(presenting);
    this.refresh();
  }

  private selected(source: XRInputSource, frame: XRFrame): void {
    if (this.questionnaire.question) this.answerByRay(source, frame);
    else if (this.phase?.name === "calibration") this.connection.send({ type: "ready" });
  }

  private answerByRay(source: XRInputSource, frame: XRFrame): void {
    const space = this.view.renderer.xr.getReferenceSpace();
    const pose = space && frame.getPose(source.targetRaySpace, space);
    const value = pose && source.handedness !== "none" && this.pointers[source.handedness].aim(pose.transform, this.panel);
    if (value) this.answer(value);
  }

  private answer(value: number): void {
    const sent = (answer: Parameters<Connection["send"]>[0]) => this.connection.send(answer);
    this.questionnaire.answer(value, performance.now(), sent);
    this.refresh();
  }

  private stop(): void {
    this.connection.send({ type: "stop" });
  }

  private key(event: KeyboardEvent): void {
    if (!isStopKey(event) || !(this.presenting || isRunning(this.phase))) return;
    event.preventDefault();
    this.stop();
  }

  private originReset(): void {
    this.panel.unplace();
    this.connection.send({ type: "origin_reset" });
  }

  private async checkVR(): Promise<void> {
    this.page.setReason("Looking for a headset …");
    this.page.setReason(await reasonAgainstVR());
  }

  // Words

  showProblem(problem: string): void {
    this.problem = problem;
    clearTimeout(this.problemTimer);
    this.problemTimer = window.setTimeout(() => this.hideProblem(), PROBLEM_SHOWN_MS);
    this.refresh();
  }

  private hideProblem(): void {
    this.problem = null;
    this.refresh();
  }

  private refresh(): void {
    const { link, linkReason, phase, problem, secondsLeft } = this;
    const { question, answered } = this.questionnaire;
    const display: Display = { link, linkReason, phase, question, answered, problem, secondsLeft };
    this.page.show(display);
    this.panel.show(this.presenting ? panelContent(display) : null);
  }

  // Frames

  private frame(timeMs: number, frame?: XRFrame): void {
    this.countDown();
    this.world.update(timeMs);
    const space = this.view.renderer.xr.getReferenceSpace();
    if (frame && space && this.presenting) this.immersiveFrame(frame, space, timeMs);
    this.view.render();
  }

  private countDown(): void {
    const secondsLeft = secondsUntil(this.phaseEndsMs, performance.now());
    if (secondsLeft === this.secondsLeft) return;
    this.secondsLeft = secondsLeft;
    this.refresh();
  }

  private immersiveFrame(frame: XRFrame, space: XRReferenceSpace, timeMs: number): void {
    const { session } = frame;
    this.track(frame, space, timeMs);
    this.session.watchButtons(session.inputSources);
    if (this.panel.visible) this.placePanel(frame.getViewerPose(space));
    if (this.questionnaire.question) this.point(frame, space);
    else for (const hand of HANDS) this.pointers[hand].hide();
  }

  private track(frame: XRFrame, space: XRReferenceSpace, timeMs: number): void {
    if (frame.session.visibilityState === "hidden" || !this.connection.connected) return;
    if (this.connection.backlog > BACKLOG_LIMIT_BYTES || !this.throttle.pass(timeMs)) return;
    this.connection.send(this.tracker.read(frame, space, timeMs));
  }

  private placePanel(viewer: XRViewerPose | undefined): void {
    if (!viewer) return;
    const { position, orientation } = viewer.transform;
    this.head.set(position.x, position.y, position.z);
    this.turn.set(orientation.x, orientation.y, orientation.z, orientation.w);
    this.panel.place(this.head, this.forward.set(0, 0, -1).applyQuaternion(this.turn));
  }

  private point(frame: XRFrame, space: XRReferenceSpace): void {
    let hovered: number | null = null;
    for (const hand of HANDS) hovered = this.pointWith(hand, frame, space) ?? hovered;
    this.panel.hover(hovered);
  }

  private pointWith(hand: "left" | "right", frame: XRFrame, space: XRReferenceSpace): number | null {
    const source = findSource(frame.session.inputSources, hand);
    const pose = source && frame.getPose(source.targetRaySpace, space);
    if (pose) return this.pointers[hand].aim(pose.transform, this.panel);
    this.pointers[hand].hide();
    return null;
  }
}

function secondsUntil(endsMs: number, nowMs: number): number | null {
  return endsMs > nowMs && endsMs < Infinity ? Math.ceil((endsMs - nowMs) / 1000) : null;
}

function words(error: unknown): string {
  return (error instanceof Error ? error.message : String(error)).replace(/\.$/, "");
}
