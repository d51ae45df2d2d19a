import type { TrackedHands } from "../body/bare-hands";
import { Connection, type Link } from "../session/connection";
import {
  asksForCode,
  awaitsReady,
  canBeStopped,
  isRunning,
  mayRecalibrate,
  panelContent,
  spokenText,
  type DisplayState,
} from "../session/display-state";
import { Countdown } from "../session/countdown";
import { FrameIntervalCollector } from "../session/frame-intervals";
import { element, fetchBytes } from "./dom";
import { DesktopControls } from "../input/desktop-controls";
import { XRFrameHandler } from "../session/xr-frame";
import type { Outgoing } from "../session/connection";
import { LatencyMeter } from "../session/latency";
import type { ParticipantBody, InputProfileMessage, PhaseDescription, Scene, ServerMessage, StopMethod, Visibility, Welcome } from "../generated/messages";
import { Notice } from "./notice";
import { Page, isStopKey } from "./participant-page";
import { CaptionPlane, Captions } from "../panel/caption";
import { Panel } from "../panel/panel";
import { CommandIcons } from "../input/command-icons";
import { commandSource, kindOfProfile } from "../input/input-profile";
import { ParticipantChoices } from "../session/participant-choices";
import { createRoom } from "../scene/room";
import { inputKindOf, textFor, type InputKind } from "../input/input-kind";
import { Senses } from "../session/haptics-and-sounds";
import { ReadAloud } from "../session/read-aloud";
import { SoundFiles } from "../session/sound-files";
import { XRSessionManager, vrUnavailableReason } from "../session/xr-session";
import { RobotCommandInput } from "../input/robot-commands";
import { StopControl } from "../input/stop-control";
import { StateDecoder, type WorldState } from "../session/state-decoder";
import type { Poses } from "../tracking/pose-reader";
import { View, type Detail } from "../scene/view";
import { Spectator } from "../session/spectator";
import { RobotPointer, RobotArrow } from "../scene/robot-direction";
import { ENGLISH_TEXTS, initialTexts, textsOf, type Key, type Texts } from "./texts";
import { World } from "../scene/world";

/** The rate of a headset with 72 Hz. */
const DESKTOP_INTERVAL_MS = 1000 / 72;

/** The client of participant and watchers: connects server, page and VR session. */
export class App {
  readonly view: View;
  readonly panel: Panel;
  readonly xrFrames: XRFrameHandler;
  readonly stopControl = new StopControl();
  readonly choices: ParticipantChoices;
  phase: PhaseDescription | null = null;
  lastState: WorldState | null = null;
  statesReceived = 0;

  private readonly page: Page;
  readonly world = new World();
  private readonly session: XRSessionManager;
  private readonly connection: Connection;
  private readonly desktop: DesktopControls;
  private readonly robotCommands: RobotCommandInput;
  readonly commandIcons = new CommandIcons();
  private readonly latency: LatencyMeter;
  private readonly states = new StateDecoder();
  private readonly frameIntervals = new FrameIntervalCollector();
  private readonly senses: Senses;
  private readonly readAloud = new ReadAloud(
    new SoundFiles(
      () => this.senses.audio,
      (url) => fetchBytes(url, this.token),
    ),
  );
  private readonly captions = new Captions(() => this.readAloud.speaking);
  readonly captionPlane = new CaptionPlane();
  private readonly spectator: Spectator | null;
  private readonly robotArrow: RobotArrow;
  private readonly robotPointer: RobotPointer;
  private welcome: Welcome | null = null;
  private lastPoses: Poses | null = null;
  private body: ParticipantBody | null = null;
  private link: Link = "connecting";
  private code = 0;
  private texts: Texts;
  private readonly notice = new Notice(() => this.update());
  private contextLost = false;
  private sentVisibility: Visibility = "visible";
  private readonly countdown = new Countdown();
  private input: InputKind = "trigger";

  constructor(
    private readonly token: string,
    private readonly emulated: boolean,
    detail: Detail,
    private readonly isSpectator: boolean,
  ) {
    this.texts = isSpectator ? ENGLISH_TEXTS : initialTexts(navigator.languages);
    this.page = new Page(isSpectator, {
      toggleVR: () => void this.toggleVR(),
      toggleDesktop: () => this.toggleDesktop(),
      ready: () => this.send({ type: "ready" }),
      recalibrate: () => this.send({ type: "recalibrate" }),
      rest: () => this.send({ type: "request_break" }),
      prefer: () => this.send({ type: "change_preferences" }),
      stop: () => this.stop("page"),
      back: () => this.choices.goBack(),
      answer: (value) => this.choices.answer(value),
      chooseBody: (choice) => this.send(choice),
    });
    const watcher = isSpectator ? "experimenter" : null;
    this.robotCommands = new RobotCommandInput(element("robot-commands"), (message) => this.send(message), watcher);
    this.desktop = new DesktopControls(this.page.view, this.page.handButtons);
    this.view = new View(this.page.view, this.page.card, detail);
    this.robotPointer = new RobotPointer(this.view.scene);
    this.panel = new Panel(detail.anisotropy);
    this.choices = new ParticipantChoices(this.panel, {
      send: (message) => this.send(message),
      stop: () => this.stop("switch"),
      changed: () => this.update(),
      command: (value) => this.commandByIcon(value),
      activate: (value) => this.page.targets.activate(value),
    });
    this.connection = new Connection(socketAddress(isSpectator ? "watch" : "ws"), token, emulated, {
      message: (message) => this.receive(message),
      link: (link, code) => this.onLink(link, code),
    });
    this.xrFrames = new XRFrameHandler(this.panel, this.choices.selection, this.connection, this.world, this.commandIcons);
    this.latency = new LatencyMeter((sequence) => this.xrFrames.numbering.timesOf(sequence));
    this.session = new XRSessionManager(this.view.renderer, {
      begins: (session) => this.stopControl.listen(session),
      entered: () => this.entered(),
      left: () => this.left(),
      selected: (source, frame) => this.selected(source, frame),
      menuPressed: () => (mayRecalibrate(this.phase) ? this.send({ type: "recalibrate" }) : this.stop("button")),
      originReset: () => this.originReset(),
      visibilityChanged: () => this.sendVisibility(),
    });
    this.senses = new Senses(
      (hand, strength, ms) => this.session.pulse(hand, strength, ms),
      () => this.allowedSenses(),
      () => this.captions.begin(this.texts.get("caption_success"), performance.now()),
    );
    this.spectator = isSpectator ? this.watch() : null;
    this.robotArrow = new RobotArrow(this.page.view, this.page.card);
    this.addScenery(detail);
  }

  private watch(): Spectator {
    this.page.hideParticipation();
    return new Spectator(
      (message) => this.send(message),
      (firstPerson) => this.setFirstPerson(firstPerson),
    );
  }

  private setFirstPerson(inside: boolean): void {
    this.world.setFirstPerson(inside);
    this.view.useCamera(inside && this.spectator ? this.spectator.eyes : null);
  }

  /** HapticAndAudioFeedback that both the session plan and the participant enable. */
  private allowedSenses(): { haptics: boolean; sounds: boolean } {
    const { haptics, sounds } = this.page.senses;
    return { haptics: haptics && !!this.welcome?.haptics, sounds: sounds && !!this.welcome?.sounds };
  }

  get presenting(): boolean {
    return this.session.presenting;
  }

  private get isViewing(): boolean {
    return this.phase?.name === "viewing";
  }

  /** Whether this page offers choices: the participant's page, and the experimenter's own page. */
  private get mayChoose(): boolean {
    const isDashboard = document.body.classList.contains("embedded");
    return !this.isSpectator || (this.welcome?.role === "experimenter" && !isDashboard);
  }

  /** Whether somebody takes part on this page, in VR or without a headset. */
  private get participates(): boolean {
    return this.presenting || this.desktop.playing;
  }

  start(): void {
    if (!this.isSpectator) this.page.speak(this.texts);
    this.connection.open();
    this.update();
    this.view.renderer.setAnimationLoop((timeMs, frame) => this.frame(timeMs, frame));
    const { domElement } = this.view.renderer;
    for (const event of ["webglcontextlost", "webglcontextrestored"])
      domElement.addEventListener(event, () => this.onContextLost(event === "webglcontextlost"));
    document.addEventListener("visibilitychange", () => this.sendVisibility());
    window.addEventListener("keydown", (event) => this.key(event));
    setInterval(() => this.sendDesktopPoses(), DESKTOP_INTERVAL_MS);
    navigator.xr?.addEventListener("devicechange", () => void this.checkVR());
    void this.checkVR();
  }

  private addScenery(detail: Detail): void {
    const { root } = this.world;
    root.add(createRoom(detail));
    if (detail.lighting) this.view.reflect(root);
    this.view.scene.add(root, this.panel.mesh, this.stopControl.sign.mesh, this.xrFrames.pointers.group, this.captionPlane.mesh, this.commandIcons.group);
    this.view.placeSpectator(root);
  }

  private send(message: Outgoing): boolean {
    return this.connection.send(message);
  }

  // From the server

  private receive(message: ServerMessage): void {
    if (message.type === "state") return this.onState(this.states.decode(message));
    if (message.type === "passed") return this.latency.announce(message);
    if (message.type === "feedback") return this.senses.take(message);
    if (message.type === "status") return this.spectator?.onStatus(message);
    if (message.type === "timing") return this.spectator?.onTiming(message);
    if (message.type === "placed") return this.world.move(message, performance.now());
    if (message.type === "upcoming") return this.prefetch(message.url);
    if (message.type === "welcome") this.onWelcome(message);
    if (message.type === "language") this.speak(textsOf(message));
    if (message.type === "body") this.onBody(message);
    if (message.type === "scene") void this.onScene(message);
    if (message.type === "input") this.onInput(message);
    if (message.type === "pressed") this.choices.pressRemotely(message);
    if (message.type === "robot_commands" && this.mayChoose) this.robotCommands.show(message);
    if (message.type === "phase") this.onPhase(message);
    if (message.type === "question" && !this.isSpectator) this.choices.ask(message);
    if (message.type === "problem") this.notice.show(message);
    this.update();
  }

  /** Sends the participant's state to a new connection. */
  private onWelcome(welcome: Welcome): void {
    this.welcome = welcome;
    this.spectator?.onWelcome(welcome);
    this.page.commands = welcome.role === "experimenter";
    this.world.forgetStates();
    this.sentVisibility = "visible";
    if (this.participates) this.send({ type: "entered" });
    this.choices.selection.announceOffer();
    this.sendVisibility();
  }

  private get visibility(): Visibility {
    if (!this.participates) return "visible";
    if (this.contextLost) return "context-lost";
    return this.presenting ? this.session.visibility : document.visibilityState;
  }

  /** Reports visibility to the server, which holds the robot while the participant does not see the scene. */
  private sendVisibility(): void {
    const { visibility } = this;
    this.xrFrames.blocked = visibility !== "visible";
    this.updateAnswering();
    if (visibility !== this.sentVisibility && this.send({ type: "visibility_changed", visibility }))
      this.sentVisibility = visibility;
  }

  /** Whether the participant sees the question and can answer it. */
  private get canAnswer(): boolean {
    const seen = this.presenting ? this.visibility : document.visibilityState;
    const tracked = !this.presenting || this.lastPoses?.head !== null;
    return this.link === "connected" && seen === "visible" && tracked;
  }

  private updateAnswering(): void {
    this.choices.questionnaire.block(!this.canAnswer, performance.now());
  }

  /** Loads a scene into the browser's cache. */
  private prefetch(url: string): void {
    void fetchBytes(url, this.token).catch(() => undefined);
  }

  private onState(state: WorldState): void {
    const nowMs = performance.now();
    this.statesReceived++;
    if (this.world.push(state)) this.lastState = state;
    this.latency.onState(state, nowMs);
  }

  private async onScene(scene: Scene): Promise<void> {
    this.states.beginScene();
    this.spectator?.onScene(scene);
    try {
      const before = this.world.root.matrix.clone();
      const loading = this.world.load(scene, fetchBytes(scene.url, this.token));
      if (!this.world.root.matrix.equals(before)) this.view.placeSpectator(this.world.root);
      await loading;
      this.page.setSceneLoaded();
      this.panel.review();
      if (!this.isSpectator) this.send({ type: "scene_loaded", url: scene.url });
      else if (this.isViewing) this.send({ type: "scene_watched", url: scene.url });
    } catch (error) {
      this.explain("scene_not_loaded", error);
    }
  }

  private onBody(body: ParticipantBody): void {
    this.body = body;
    this.world.hands.colour(body);
  }

  /** Changes how the participant selects, stops, reads and hears. */
  private onInput(input: InputProfileMessage): void {
    this.world.absentArms = input.absent_arms;
    if (this.isSpectator) return;
    this.choices.changeProfile(input);
    this.stopControl.profile = input;
    this.input = kindOfProfile(input) ?? "trigger";
    this.robotCommands.press(commandSource(input) ?? "button");
    this.page.showInput(input, this.input);
    const { presentation } = input;
    this.panel.present(presentation);
    this.world.reducedMotion = presentation.reduced_motion;
    this.readAloud.enable(presentation.read_aloud);
    this.page.present(presentation);
    this.view.fit();
  }

  private onPhase(phase: PhaseDescription): void {
    this.phase = this.choices.phase = phase;
    this.panel.review();
    this.page.setViewing(this.isViewing);
    this.countdown.begin(phase.seconds, performance.now());
    if (phase.name !== "questionnaire") this.choices.clearQuestion();
    if (phase.name === "headset" || phase.name === "calibration") this.world.forgetHands();
  }

  /** Shows the page in the participant's language. On watchers' pages only the phase text is in that language. */
  private speak(texts: Texts): void {
    if (this.isSpectator) return this.page.markAsParticipants(texts);
    this.texts = texts;
    this.page.speak(texts);
    void this.checkVR();
  }

  private onLink(link: Link, code: number): void {
    this.link = link;
    this.code = code;
    if (asksForCode(code)) this.page.showCodeForm();
    this.updateAnswering();
    this.update();
  }

  // From the participant

  private async toggleVR(): Promise<void> {
    if (this.presenting) return this.session.leave();
    this.senses.wake();
    if (this.emulated && !navigator.userActivation.isActive) {
      return this.explain("real_click");
    }
    this.page.setVRUnavailableReason(this.texts.get("entering"));
    await this.session.enter(navigator.xr!).catch((error) => this.explain("not_entered", error));
    this.page.setVRUnavailableReason("");
  }

  private toggleDesktop(): void {
    const playing = !this.desktop.playing;
    this.senses.wake();
    this.desktop.playing = playing;
    this.page.setPlaying(playing);
    this.world.setFirstPerson(playing);
    this.view.useCamera(playing ? this.desktop.camera : null);
    this.send({ type: playing ? "entered" : "left" });
    this.sendVisibility();
    this.update();
  }

  private entered(): void {
    this.panel.unplace();
    this.showPresenting(true);
    this.send({ type: "entered" });
    this.sendVisibility();
  }

  private left(): void {
    this.xrFrames.pointers.hide();
    this.stopControl.sign.hide();
    this.showPresenting(false);
    this.send({ type: "left" });
    this.sendVisibility();
  }

  private onContextLost(lost: boolean): void {
    this.contextLost = lost;
    this.sendVisibility();
    if (lost) this.explain("drawing_lost");
  }

  private showPresenting(presenting: boolean): void {
    this.page.setPresenting(presenting);
    this.world.setFirstPerson(presenting);
    this.update();
  }

  private selected(source: XRInputSource, frame: XRFrame): void {
    const space = this.view.renderer.xr.getReferenceSpace();
    this.choices.pressSource(source, space && this.xrFrames.pointedAt(source, frame, space));
  }

  private key(event: KeyboardEvent): void {
    if (this.answerByKey(event) || (!this.isSpectator && this.robotCommands.takesKey(event))) return;
    if (this.desktop.press(event.code)) return;
    if (this.desktop.playing && event.key === "Enter" && event.target === document.body && awaitsReady(this.phase))
      this.send({ type: "ready" });
    if (!isStopKey(event) || !(this.participates || isRunning(this.phase))) return;
    event.preventDefault();
    this.stop("key");
  }

  /** Whether a number key answers the displayed question; 0 means ten. */
  private answerByKey(event: KeyboardEvent): boolean {
    const { question, answered } = this.choices.questionnaire;
    const isOther = event.repeat || event.ctrlKey || event.altKey || event.metaKey || !/^\d$/.test(event.key);
    if (!question || answered !== null || isOther || this.isSpectator) return false;
    const value = Number(event.key) || 10;
    if (question.points > 10 || value > question.points) return false;
    this.page.noteKeyboardAnswer();
    this.choices.answer(value);
    return true;
  }

  private stop(method: StopMethod): void {
    if (!this.isSpectator) this.send({ type: "stop", method });
    else if (this.page.commands) this.send({ type: "command", name: "stop" });
  }

  /** Stops the robot after a stop gesture in VR. */
  private checkStopGesture(frame: XRFrame, space: XRReferenceSpace, timeMs: number): void {
    const { phase, texts, xrFrames, stopControl } = this;
    const method = stopControl.watch(frame, space, timeMs, xrFrames.bareHands, canBeStopped(phase), texts);
    if (method) this.stop(method);
  }

  /** Updates the texts for the participant's select input. */
  private updateInput(sources: XRInputSourceArray): void {
    const input = kindOfProfile(this.choices.profile) ?? inputKindOf(sources) ?? this.input;
    if (input === this.input) return;
    this.input = input;
    this.update();
  }

  private originReset(): void {
    this.panel.unplace();
    this.stopControl.sign.hide();
    this.send({ type: "origin_reset" });
  }

  private async checkVR(): Promise<void> {
    this.page.setVRUnavailableReason(this.texts.get("looking"));
    const reason = await vrUnavailableReason();
    this.page.setVRUnavailableReason(reason ? this.texts.get(reason) : "");
  }

  // Texts

  private explain(key: Key, error?: unknown): void {
    this.notice.explain(this.texts, key, error);
  }

  private update(): void {
    const { texts, link, code, phase, participates, input } = this;
    const { secondsLeft } = this.countdown;
    const { problem } = this.notice;
    const { questionnaire, staged, segment } = this.choices;
    const question = link === "connected" ? questionnaire.question : null;
    const { answered } = questionnaire;
    const body = this.mayChoose ? this.body : null;
    const message = problem && textFor(input, problem.message, problem.messages_by_input, problem.page_message);
    const counted = { secondsLeft, participates, input, staged, segment };
    const display: DisplayState = { texts, link, code, phase, body, question, answered, problem: message, ...counted };
    this.page.show({ ...display, problem: problem && (problem.page_message || problem.message) });
    this.panel.show(this.presenting ? panelContent(display) : null);
    this.choices.presenting = this.presenting;
    this.readText(display);
    this.showCommandIcons();
    const inVR = this.panel.buttons.length > 0 ? this.panel.targets : this.commandIcons.targets;
    this.choices.offer(this.presenting ? inVR : staged ? this.page.targets.offered : []);
  }

  /** Shows icons of the commands that the participant may give in VR by dwell or switch. */
  private showCommandIcons(): void {
    const { profile } = this.choices;
    const source = commandSource(profile);
    const shown = this.presenting && source !== null && this.panel.buttons.length === 0;
    this.commandIcons.show(shown ? this.robotCommands.offeredTo(source) : [], profile.presentation);
  }

  private commandByIcon(value: number): void {
    const name = this.commandIcons.commandOf(value);
    const source = commandSource(this.choices.profile);
    if (name && source) this.robotCommands.give(name, source);
  }

  /** Reads the displayed text aloud. A text that VR does not display has a caption. */
  private readText(display: DisplayState): void {
    const text = this.isSpectator ? "" : spokenText(display);
    const file = display.problem ? "" : (display.question?.item ?? this.phase?.key);
    const isRead = this.readAloud.read(text, this.texts, file);
    if (isRead && this.presenting && !this.panel.visible) this.captions.begin(text, performance.now());
  }

  // Frames

  private frame(timeMs: number, frame?: XRFrame): void {
    if (this.countdown.advance(performance.now())) this.update();
    this.updateAnswering();
    if (!this.isSpectator && !this.choices.switches.used) this.robotCommands.watchGamepads(navigator.getGamepads());
    this.advanceSelection();
    const space = this.view.renderer.xr.getReferenceSpace();
    if (frame && space && this.presenting) {
      this.updateWorld(timeMs, this.xrFrames.read(frame, space, timeMs), this.xrFrames.bareHands);
      this.session.watchButtons(frame.session.inputSources);
      this.updateInput(frame.session.inputSources);
      this.xrFrames.frame(frame, space);
      this.checkStopGesture(frame, space, timeMs);
    } else this.updateWorld(timeMs, this.desktop.playing ? this.desktop.poses : null);
    if (this.spectator?.firstPerson && !this.presenting) this.spectator.follow(this.lastState, this.world.root);
    this.updateRobotDirection();
    this.showCaption();
    this.view.render();
    this.sendLatency();
    this.sendFrameIntervals(timeMs);
  }

  /** Moves a scan, checks gamepads, and highlights on the page. */
  private advanceSelection(): void {
    const { selection, switches } = this.choices;
    switches.poll();
    selection.tick(performance.now(), this.readAloud.speaking);
    const { highlightedLabel, number, highlighted, stepped } = selection;
    if (highlightedLabel) this.readAloud.name(highlightedLabel, `${number} ${highlighted}`, stepped);
    if (this.presenting) return;
    if (kindOfProfile(this.choices.profile) === "dwell") selection.look(this.page.targets.pointed, performance.now());
    this.page.targets.highlight(selection.highlighted, selection.progress);
  }

  /** Shows the direction of the robot while it is out of view, on the page, and in VR while it moves without a panel. */
  private updateRobotDirection(): void {
    const place = this.world.robot;
    const head = this.presenting && isRunning(this.phase) && !this.panel.visible ? this.lastPoses?.head : null;
    this.robotPointer.update(head ?? null, place);
    this.robotArrow.update(this.view.camera, this.presenting ? null : place);
  }

  private showCaption(): void {
    const { presentation } = this.choices.profile;
    const caption = this.captions.at(performance.now());
    const shown = presentation.captions ? caption : "";
    this.page.caption(shown);
    this.captionPlane.show(shown, (this.presenting && this.lastPoses?.head) || null, presentation);
  }

  private sendLatency(): void {
    const nowMs = performance.now();
    this.latency.pictureDrawn(this.world.drawnTimeS, nowMs);
    const latency = this.participates ? this.latency.take(nowMs) : null;
    if (latency) this.send(latency);
  }

  /** Sends the frame intervals during the headset check. */
  private sendFrameIntervals(timeMs: number): void {
    if (!this.participates || this.phase?.name !== "headset_check") return this.frameIntervals.forget();
    const { emulated } = this;
    const headset = () => ({ device: navigator.userAgent.slice(0, 512), emulated, ...this.session.hardware });
    const frames = this.frameIntervals.drawn(timeMs, headset);
    if (frames) this.send(frames);
  }

  private updateWorld(timeMs: number, poses: Poses | null, bareHands?: TrackedHands): void {
    this.lastPoses = poses;
    const lagMs = this.xrFrames.numbering.ageMs(this.lastState?.tracking_sequence ?? -1, timeMs);
    this.world.update(timeMs, poses, lagMs, bareHands);
  }

  private sendDesktopPoses(): void {
    if (!this.desktop.playing) return;
    const nowMs = performance.now();
    this.xrFrames.track(this.desktop.frame(nowMs), nowMs);
  }
}

/** The address of the server's WebSocket, without the token. */
function socketAddress(name: string): string {
  const address = new URL(name, location.origin + location.pathname);
  address.protocol = location.protocol.replace("http", "ws");
  return address.href;
}
