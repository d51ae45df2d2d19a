import type { BareHandsTracked } from "../body/bare-hands";
import { Connection, type Link } from "../session/connection";
import { asksForCode, awaitsReady, canBeStopped, confirmsAnswers, isRunning, mayRecalibrate, panelContent, type Display } from "../session/display-state";
import { Countdown } from "../session/countdown";
import { DrawnFrames } from "../session/frame-intervals";
import { fetchBytes } from "./dom";
import { FlatPlay } from "../input/desktop-controls";
import { Immersive } from "../session/xr-frame";
import type { Outgoing } from "../session/connection";
import { LatencyMeter } from "../session/latency";
import type { Body, Phase, Scene, ServerMessage, StopWay, Visibility, Welcome } from "../generated/messages";
import { Notice } from "./notice";
import { Page, isStopKey } from "./participant-page";
import { AGAIN, BACK, DONE } from "../panel/paint-panel";
import { Panel } from "../panel/panel";
import { Questionnaire } from "../panel/questionnaire";
import { createRoom } from "../scene/room";
import { inputOfAll, wordsFor, type Input } from "../input/input-kind";
import { Senses } from "../session/haptics-and-sounds";
import { ImmersiveSession, reasonAgainstVR } from "../session/xr-session";
import { StopControl } from "../input/stop-control";
import { StateDecoder, type State } from "../session/state-decoder";
import type { Poses } from "../tracking/pose-reader";
import { View, type Detail } from "../scene/view";
import { Watching } from "../session/spectator";
import { RobotPointer, Whereabouts } from "../scene/robot-direction";
import { ENGLISH, firstWords, wordsOf, type Key, type Words } from "./texts";
import { World } from "../scene/world";

/** As often as a headset of 72 Hz sends its poses. */
const PLAY_INTERVAL_MS = 1000 / 72;

/** The whole client: what the server says goes in, what the participant does goes out. */
export class App {
  readonly view: View;
  readonly panel: Panel;
  readonly immersive: Immersive;
  readonly stopControl = new StopControl();
  readonly questionnaire = new Questionnaire();
  phase: Phase | null = null;
  lastState: State | null = null;
  statesReceived = 0;

  private readonly page: Page;
  readonly world = new World();
  private readonly session: ImmersiveSession;
  private readonly connection: Connection;
  private readonly flat: FlatPlay;
  private readonly latency: LatencyMeter;
  private readonly states = new StateDecoder();
  private readonly drawnFrames = new DrawnFrames();
  private readonly senses: Senses;
  private readonly watching: Watching | null;
  private readonly whereabouts: Whereabouts;
  private readonly pointsAtRobot: RobotPointer;
  private welcome: Welcome | null = null;
  private lastPoses: Poses | null = null;
  private body: Body | null = null;
  private link: Link = "connecting";
  private code = 0;
  private words: Words;
  private readonly notice = new Notice(() => this.refresh());
  private contextLost = false;
  private toldVisibility: Visibility = "visible";
  private readonly countdown = new Countdown();
  private input: Input = "trigger";

  constructor(
    private readonly token: string,
    private readonly emulated: boolean,
    detail: Detail,
    private readonly watches: boolean,
  ) {
    this.words = watches ? ENGLISH : firstWords(navigator.languages);
    this.page = new Page(watches, {
      enterOrLeave: () => void this.enterOrLeave(),
      playOrEnd: () => this.playOrEnd(),
      ready: () => this.send({ type: "ready" }),
      recalibrate: () => this.send({ type: "recalibrate" }),
      stop: () => this.stop("page"),
      back: () => this.send({ type: "back" }),
      answer: (value) => this.answer(value),
      chooseBody: (choice) => this.send(choice),
    });
    this.flat = new FlatPlay(this.page.view, this.page.handButtons);
    this.view = new View(this.page.view, this.page.card, detail);
    this.pointsAtRobot = new RobotPointer(this.view.scene);
    this.panel = new Panel(detail.anisotropy);
    this.connection = new Connection(socketAddress(watches ? "watch" : "ws"), token, emulated, {
      message: (message) => this.receive(message),
      link: (link, code) => this.linked(link, code),
    });
    this.immersive = new Immersive(this.panel, this.connection, (eyes) => this.world.around(eyes));
    this.latency = new LatencyMeter((sequence) => this.immersive.numbering.timesOf(sequence));
    this.session = new ImmersiveSession(this.view.renderer, {
      begins: (session) => this.stopControl.listen(session),
      entered: () => this.entered(),
      left: () => this.left(),
      selected: (source, frame) => this.selected(source, frame),
      menuPressed: () => (mayRecalibrate(this.phase) ? this.send({ type: "recalibrate" }) : this.stop("button")),
      originReset: () => this.originReset(),
      visibilityChanged: () => this.tellVisibility(),
    });
    this.senses = new Senses(
      (hand, strength, ms) => this.session.pulse(hand, strength, ms),
      () => this.allowedSenses(),
    );
    this.watching = watches ? this.watch() : null;
    this.whereabouts = new Whereabouts(this.page.view, this.page.card);
    this.furnish(detail);
  }

  private watch(): Watching {
    this.page.hideTakingPart();
    return new Watching(
      (message) => this.send(message),
      (fromInside) => this.seeFromInside(fromInside),
    );
  }

  private seeFromInside(inside: boolean): void {
    this.world.seeFromInside(inside);
    this.view.seeWith(inside && this.watching ? this.watching.eyes : null);
  }

  /** The plan and the participant must both want them. */
  private allowedSenses(): { haptics: boolean; sounds: boolean } {
    const { haptics, sounds } = this.page.senses;
    return { haptics: haptics && !!this.welcome?.haptics, sounds: sounds && !!this.welcome?.sounds };
  }

  get presenting(): boolean {
    return this.session.presenting;
  }

  private get onShow(): boolean {
    return this.phase?.name === "viewing";
  }

  /** Whether somebody takes part here, in VR or without a headset. */
  private get takesPart(): boolean {
    return this.presenting || this.flat.playing;
  }

  start(): void {
    if (!this.watches) this.page.speak(this.words);
    this.connection.open();
    this.refresh();
    this.view.renderer.setAnimationLoop((timeMs, frame) => this.frame(timeMs, frame));
    const { domElement } = this.view.renderer;
    for (const event of ["webglcontextlost", "webglcontextrestored"])
      domElement.addEventListener(event, () => this.drawingLost(event === "webglcontextlost"));
    document.addEventListener("visibilitychange", () => this.tellVisibility());
    window.addEventListener("keydown", (event) => this.key(event));
    setInterval(() => this.playFrame(), PLAY_INTERVAL_MS);
    navigator.xr?.addEventListener("devicechange", () => void this.checkVR());
    void this.checkVR();
  }

  private furnish(detail: Detail): void {
    const { root } = this.world;
    root.add(createRoom(detail));
    if (detail.lighting) this.view.reflect(root);
    this.view.scene.add(root, this.panel.mesh, this.stopControl.sign.mesh, this.immersive.pointers.group);
    this.view.standBefore(root);
  }

  private send(message: Outgoing): boolean {
    return this.connection.send(message);
  }

  // From the server

  private receive(message: ServerMessage): void {
    if (message.type === "state") return this.stateCame(this.states.decode(message));
    if (message.type === "passed") return this.latency.announce(message);
    if (message.type === "feedback") return this.senses.take(message);
    if (message.type === "status") return this.watching?.statusCame(message);
    if (message.type === "timing") return this.watching?.timingCame(message);
    if (message.type === "placed") return this.world.move(message, performance.now());
    if (message.type === "upcoming") return this.fetchAhead(message.url);
    if (message.type === "welcome") this.welcomed(message);
    if (message.type === "language") this.speak(wordsOf(message));
    if (message.type === "body") this.bodyCame(message);
    if (message.type === "scene") void this.sceneCame(message);
    if (message.type === "phase") this.phaseCame(message);
    if (message.type === "question" && !this.watches) this.questionnaire.show(message, performance.now());
    if (message.type === "problem") this.notice.show(message);
    this.refresh();
  }

  /** A new connection knows nothing of the participant in VR yet. */
  private welcomed(welcome: Welcome): void {
    this.welcome = welcome;
    this.watching?.welcomed(welcome);
    this.page.commands = welcome.role === "experimenter";
    this.world.forgetStates();
    this.toldVisibility = "visible";
    if (this.takesPart) this.send({ type: "entered" });
    this.tellVisibility();
  }

  private get visibility(): Visibility {
    if (!this.takesPart) return "visible";
    if (this.contextLost) return "context-lost";
    return this.presenting ? this.session.visibility : document.visibilityState;
  }

  /** The server holds the robot while the participant does not see the scene or cannot act. */
  private tellVisibility(): void {
    const { visibility } = this;
    this.immersive.blocked = visibility !== "visible";
    this.watchAnswering();
    if (visibility !== this.toldVisibility && this.send({ type: "visibility_changed", visibility }))
      this.toldVisibility = visibility;
  }

  /** Whether the participant sees the questions and can point at an answer. */
  private get canAnswer(): boolean {
    const seen = this.presenting ? this.visibility : document.visibilityState;
    const tracked = !this.presenting || this.lastPoses?.head !== null;
    return this.link === "connected" && seen === "visible" && tracked;
  }

  private watchAnswering(): void {
    this.questionnaire.block(!this.canAnswer, performance.now());
  }

  /** Fills the browser's cache, so that the scene is there when it is wanted. */
  private fetchAhead(url: string): void {
    void fetchBytes(url, this.token).catch(() => undefined);
  }

  private stateCame(state: State): void {
    const nowMs = performance.now();
    this.statesReceived++;
    if (this.world.push(state)) this.lastState = state;
    this.latency.stateCame(state, nowMs);
  }

  private async sceneCame(scene: Scene): Promise<void> {
    this.states.beginScene();
    this.watching?.sceneCame(scene);
    try {
      const before = this.world.root.matrix.clone();
      const loading = this.world.load(scene, fetchBytes(scene.url, this.token));
      if (!this.world.root.matrix.equals(before)) this.view.standBefore(this.world.root);
      await loading;
      this.page.setFurnished();
      this.panel.review();
      if (!this.watches) this.send({ type: "scene_loaded", url: scene.url });
      else if (this.onShow) this.send({ type: "scene_watched", url: scene.url });
    } catch (error) {
      this.explain("scene_not_loaded", error);
    }
  }

  private bodyCame(body: Body): void {
    this.body = body;
    this.world.hands.colour(body);
  }

  private phaseCame(phase: Phase): void {
    this.phase = phase;
    this.panel.review();
    this.page.setOnShow(this.onShow);
    this.countdown.begin(phase.seconds, performance.now());
    if (phase.name !== "questionnaire") this.questionnaire.clear();
    if (phase.name === "headset" || phase.name === "calibration") this.world.forgetHands();
  }

  /** The participant's page speaks their language; what those who watch read of it is marked as theirs. */
  private speak(words: Words): void {
    if (this.watches) return this.page.markAsParticipants(words);
    this.words = words;
    this.page.speak(words);
    void this.checkVR();
  }

  private linked(link: Link, code: number): void {
    this.link = link;
    this.code = code;
    if (asksForCode(code)) this.page.showEntrance();
    this.watchAnswering();
    this.refresh();
  }

  // From the participant

  private async enterOrLeave(): Promise<void> {
    if (this.presenting) return this.session.leave();
    this.senses.wake();
    if (this.emulated && !navigator.userActivation.isActive) {
      return this.explain("real_click");
    }
    this.page.setReason(this.words.say("entering"));
    await this.session.enter(navigator.xr!).catch((error) => this.explain("not_entered", error));
    this.page.setReason("");
  }

  private playOrEnd(): void {
    const playing = !this.flat.playing;
    this.senses.wake();
    this.flat.playing = playing;
    this.page.setPlaying(playing);
    this.world.seeFromInside(playing);
    this.view.seeWith(playing ? this.flat.camera : null);
    this.send({ type: playing ? "entered" : "left" });
    this.tellVisibility();
    this.refresh();
  }

  private entered(): void {
    this.panel.unplace();
    this.showPresenting(true);
    this.send({ type: "entered" });
    this.tellVisibility();
  }

  private left(): void {
    this.immersive.pointers.hide();
    this.stopControl.sign.hide();
    this.showPresenting(false);
    this.send({ type: "left" });
    this.tellVisibility();
  }

  private drawingLost(lost: boolean): void {
    this.contextLost = lost;
    this.tellVisibility();
    if (lost) this.explain("drawing_lost");
  }

  private showPresenting(presenting: boolean): void {
    this.page.setPresenting(presenting);
    this.world.seeFromInside(presenting);
    this.refresh();
  }

  private selected(source: XRInputSource, frame: XRFrame): void {
    const space = this.view.renderer.xr.getReferenceSpace();
    const value = space && this.immersive.pointedAt(source, frame, space);
    const choice = this.panel.choice(value);
    if (value === BACK) this.send({ type: "back" });
    else if (this.questionnaire.question) this.answer(value);
    else if (confirmsAnswers(this.phase)) value === DONE && this.send({ type: "ready" });
    else if (choice) this.send(choice);
    else if (value === AGAIN) this.send({ type: "recalibrate" });
    else if (awaitsReady(this.phase)) this.send({ type: "ready" });
  }

  private answer(value: number | null): void {
    if (value === null) return;
    this.questionnaire.answer(value, performance.now(), (answer) => this.send(answer));
    this.refresh();
  }

  private key(event: KeyboardEvent): void {
    if (this.answerByKey(event)) return;
    if (this.flat.press(event.code)) return;
    if (this.flat.playing && event.key === "Enter" && event.target === document.body && awaitsReady(this.phase))
      this.send({ type: "ready" });
    if (!isStopKey(event) || !(this.takesPart || isRunning(this.phase))) return;
    event.preventDefault();
    this.stop("key");
  }

  /** Whether a number key answers the question that is shown; 0 is ten. */
  private answerByKey(event: KeyboardEvent): boolean {
    const { question, answered } = this.questionnaire;
    const isOther = event.repeat || event.ctrlKey || event.altKey || event.metaKey || !/^\d$/.test(event.key);
    if (!question || answered !== null || isOther || this.watches) return false;
    const value = Number(event.key) || 10;
    if (question.points > 10 || value > question.points) return false;
    this.page.answersByKeyboard();
    this.answer(value);
    return true;
  }

  private stop(way: StopWay): void {
    if (!this.watches) this.send({ type: "stop", way });
    else if (this.page.commands) this.send({ type: "command", name: "stop" });
  }

  /** Holds the robot once a participant in VR has held what stops it. */
  private watchStop(frame: XRFrame, space: XRReferenceSpace, timeMs: number): void {
    const { phase, words, immersive, stopControl } = this;
    const way = stopControl.watch(frame, space, timeMs, immersive.bareHands, canBeStopped(phase), words);
    if (way) this.stop(way);
  }

  /** Shows the panel's words for the participant's input. */
  private watchInput(sources: XRInputSourceArray): void {
    const input = inputOfAll(sources) ?? this.input;
    if (input === this.input) return;
    this.input = input;
    this.refresh();
  }

  private originReset(): void {
    this.panel.unplace();
    this.stopControl.sign.hide();
    this.send({ type: "origin_reset" });
  }

  private async checkVR(): Promise<void> {
    this.page.setReason(this.words.say("looking"));
    const reason = await reasonAgainstVR();
    this.page.setReason(reason ? this.words.say(reason) : "");
  }

  // Words

  private explain(key: Key, error?: unknown): void {
    this.notice.explain(this.words, key, error);
  }

  private refresh(): void {
    const { words, link, code, phase, takesPart, input } = this;
    const { secondsLeft } = this.countdown;
    const { problem } = this.notice;
    const question = link === "connected" ? this.questionnaire.question : null;
    const { answered } = this.questionnaire;
    const body = this.welcome?.role === "spectator" ? null : this.body;
    const message = problem && wordsFor(input, problem.message, problem.messages_by_input);
    const counted = { secondsLeft, takesPart, input };
    const display: Display = { words, link, code, phase, body, question, answered, problem: message, ...counted };
    this.page.show({ ...display, problem: problem && (problem.page_message || problem.message) });
    this.panel.show(this.presenting ? panelContent(display) : null);
  }

  // Frames

  private frame(timeMs: number, frame?: XRFrame): void {
    if (this.countdown.goOn(performance.now())) this.refresh();
    this.watchAnswering();
    const space = this.view.renderer.xr.getReferenceSpace();
    if (frame && space && this.presenting) {
      this.updateWorld(timeMs, this.immersive.read(frame, space, timeMs), this.immersive.bareHands);
      this.session.watchButtons(frame.session.inputSources);
      this.watchInput(frame.session.inputSources);
      this.immersive.frame(frame, space);
      this.watchStop(frame, space, timeMs);
    } else this.updateWorld(timeMs, this.flat.playing ? this.flat.poses : null);
    if (this.watching?.fromInside && !this.presenting) this.watching.follow(this.lastState, this.world.root);
    this.pointAtRobot();
    this.view.render();
    this.tellLatency();
    this.tellFrames(timeMs);
  }

  /** Says on screen, and in VR while it moves, where the robot is when it is out of view. */
  private pointAtRobot(): void {
    const place = this.world.robot;
    const head = this.presenting && isRunning(this.phase) ? this.lastPoses?.head : null;
    this.pointsAtRobot.update(head ?? null, place);
    this.whereabouts.update(this.view.camera, this.presenting ? null : place);
  }

  private tellLatency(): void {
    const nowMs = performance.now();
    this.latency.pictureDrawn(this.world.drawnTimeS, nowMs);
    const latency = this.takesPart ? this.latency.take(nowMs) : null;
    if (latency) this.send(latency);
  }

  /** While the headset is checked. */
  private tellFrames(timeMs: number): void {
    if (!this.takesPart || this.phase?.name !== "headset_check") return this.drawnFrames.forget();
    const { emulated } = this;
    const headset = () => ({ device: navigator.userAgent.slice(0, 512), emulated, ...this.session.hardware });
    const frames = this.drawnFrames.drawn(timeMs, headset);
    if (frames) this.send(frames);
  }

  private updateWorld(timeMs: number, poses: Poses | null, bareHands?: BareHandsTracked): void {
    this.lastPoses = poses;
    const lagMs = this.immersive.numbering.ageMs(this.lastState?.tracking_sequence ?? -1, timeMs);
    this.world.update(timeMs, poses, lagMs, bareHands);
  }

  private playFrame(): void {
    if (!this.flat.playing) return;
    const nowMs = performance.now();
    this.immersive.track(this.flat.frame(nowMs), nowMs);
  }
}

/** The server's socket beside this page; the token stays out of the address. */
function socketAddress(name: string): string {
  const address = new URL(name, location.origin + location.pathname);
  address.protocol = location.protocol.replace("http", "ws");
  return address.href;
}
