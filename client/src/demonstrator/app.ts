import { Mesh, MeshBasicMaterial, SphereGeometry, type PerspectiveCamera } from "three";
import { OperatorControl } from "../input/operator-control";
import { PRESENTATION } from "../input/input-profile";
import { CaptionPlane } from "../panel/caption";
import { element, fetchBytes, watchAddress } from "../page/dom";
import { ENGLISH_TEXTS } from "../page/texts";
import { createRoom } from "../scene/room";
import { View, type Detail } from "../scene/view";
import { World } from "../scene/world";
import { Connection, type Link } from "../session/connection";
import { linkText } from "../session/display-state";
import { statusTexts } from "../session/session-status";
import { StateDecoder, type WorldState } from "../session/state-decoder";
import { vrUnavailableReason, XRSessionManager } from "../session/xr-session";
import { BACKLOG_LIMIT_BYTES, Reader, Throttle, type Poses } from "../tracking/pose-reader";
import { ControlReader, episodeButton, ForceHaptics, steerMessage, type Controls } from "./steering";
import { CameraPicture } from "./camera-picture";
import { countText, stageText } from "./progress-texts";
import { Viewpoint } from "./viewpoint";
import type { DemonstrationButton, DemonstrationProgress, Scene, ServerMessage, SessionStatus } from "../generated/messages";

const MARKER_RADIUS_M = 0.02;
const IDLE_COLOUR = 0xffffff;
const CLUTCHED_COLOUR = 0x2fd36b;
const BUTTONS: readonly DemonstrationButton[] = ["start", "success", "discard"];

/** The page of the demonstrator, who drives the robot in VR, or here with keyboard, mouse and gamepad. */
export class DemonstratorApp {
  readonly view: View;
  readonly world = new World();
  readonly viewpoint = new Viewpoint(this.world.root);
  framesDrawn = 0;
  lastState: WorldState | null = null;
  progress: DemonstrationProgress | null = null;
  /** The address of the scene that is loaded; an episode cannot start before its end. */
  private loading: string | null = null;
  private readonly connection: Connection;
  private readonly session: XRSessionManager;
  private readonly driving: OperatorControl;
  private readonly states = new StateDecoder();
  private readonly reader = new Reader();
  private readonly controls = new ControlReader();
  private readonly throttle = new Throttle();
  private readonly caption = new CaptionPlane();
  private readonly picture = new CameraPicture();
  private readonly haptics: ForceHaptics;
  private readonly marker = new Mesh(new SphereGeometry(MARKER_RADIUS_M), new MeshBasicMaterial({ color: IDLE_COLOUR }));
  private operated = false;
  private clutched = false;
  private lastMs = 0;
  /** Whether the page shows the view of the robot's camera. */
  private fromRobot = false;
  private camera: PerspectiveCamera | null = null;

  constructor(
    private readonly token: string,
    emulated: boolean,
    detail: Detail,
  ) {
    this.view = new View(element("view"), element("card"), detail);
    this.connection = new Connection(watchAddress(), token, emulated, {
      message: (message) => this.receive(message),
      link: (link, code) => this.onLink(link, code),
    });
    this.session = new XRSessionManager(this.view.renderer, {
      begins: () => undefined,
      entered: () => this.onPresenting(true),
      left: () => this.onPresenting(false),
      selected: () => undefined,
      menuPressed: () => undefined,
      originReset: () => this.release(),
      visibilityChanged: () => this.release(),
    });
    this.haptics = new ForceHaptics((hand, strength, ms) => this.session.pulse(hand, strength, ms));
    this.driving = new OperatorControl(element("drive"), (message) => this.connection.send(message), "demonstrator");
    this.marker.visible = false;
    const { root } = this.world;
    root.add(createRoom(detail));
    if (detail.lighting) this.view.reflect(root);
    this.view.scene.add(root, this.caption.mesh, this.picture.mesh, this.marker);
    this.view.placeSpectator(root);
    element("enter").addEventListener("click", () => void this.toggleVR());
    element("camera").addEventListener("click", () => this.setFromRobot(!this.fromRobot));
    for (const button of BUTTONS) element(button).addEventListener("click", () => this.press(button));
  }

  start(): void {
    this.connection.open();
    this.view.renderer.setAnimationLoop((timeMs, frame) => this.frame(timeMs, frame));
    void vrUnavailableReason().then((reason) => {
      element<HTMLButtonElement>("enter").disabled = reason !== null;
      element("reason").textContent = reason ? ENGLISH_TEXTS.get(reason) : "";
    });
  }

  get presenting(): boolean {
    return this.session.presenting;
  }

  private receive(message: ServerMessage): void {
    if (message.type === "state") this.onState(this.states.decode(message));
    if (message.type === "scene") void this.onScene(message);
    if (message.type === "upcoming") void fetchBytes(message.url, this.token).catch(() => undefined);
    if (message.type === "welcome") this.world.forgetStates();
    if (message.type === "phase") element("phase-text").textContent = message.page_text || message.text;
    if (message.type === "status") this.onStatus(message);
    if (message.type === "tool_force") this.haptics.forceN = message.force_n;
    if (message.type === "demonstration_progress") this.onProgress(message);
    if (message.type === "problem") this.onProblem(message.message);
  }

  private onState(state: WorldState): void {
    if (this.world.push(state)) this.lastState = state;
  }

  /** Loads a scene. The demonstrator's place in it does not change. */
  private async onScene(scene: Scene): Promise<void> {
    this.states.beginScene();
    this.loading = scene.url;
    this.showProgress();
    const placed = this.viewpoint.placed ? { ...scene, xr_from_world: this.viewpoint.xrFromWorld } : scene;
    try {
      await this.world.load(placed, fetchBytes(scene.url, this.token));
      this.connection.send({ type: "scene_watched", url: scene.url });
      if (this.loading === scene.url) this.loading = null;
      this.showProgress();
    } catch (error) {
      this.onProblem(`The scene cannot be loaded: ${String(error)}`);
    }
  }

  private onStatus(status: SessionStatus): void {
    this.operated = status.operated;
    this.driving.onStatus(status);
    const texts = statusTexts(status);
    for (const id of ["watch-force", "watch-limit"]) element(id).textContent = texts[id]!;
  }

  private onProgress(progress: DemonstrationProgress): void {
    this.progress = progress;
    element("problem").hidden = true;
    this.showProgress();
  }

  private showProgress(): void {
    const { progress } = this;
    if (!progress) return;
    const { stage } = progress;
    element("episode").hidden = false;
    element<HTMLButtonElement>("start").disabled = stage !== "ready" || this.loading !== null;
    element<HTMLButtonElement>("success").disabled = stage !== "running";
    element<HTMLButtonElement>("discard").disabled = stage !== "ready" && stage !== "running";
    element("phase-text").textContent = stageText(progress);
    element("counts").textContent = countText(progress);
  }

  private onProblem(text: string): void {
    element("problem").textContent = text;
    element("problem").hidden = false;
  }

  private onLink(link: Link, code: number): void {
    element("status-words").textContent = linkText({ texts: ENGLISH_TEXTS, link, code });
    element("status").dataset["link"] = link;
  }

  private async toggleVR(): Promise<void> {
    if (this.presenting) return this.session.leave();
    await this.session.enter(navigator.xr!).catch((error) => this.onProblem(`VR cannot be entered: ${String(error)}`));
  }

  private onPresenting(presenting: boolean): void {
    document.body.classList.toggle("presenting", presenting);
    for (const part of document.querySelectorAll<HTMLElement>(".hint, #card dl")) part.hidden = presenting;
    element("enter").textContent = presenting ? "Leave VR" : "Enter VR";
    this.marker.visible = presenting;
    this.release();
    this.picture.show(null);
    if (!presenting) this.view.placeSpectator(this.world.root);
  }

  private setFromRobot(on: boolean): void {
    this.fromRobot = on;
    element("camera").setAttribute("aria-pressed", String(on));
  }

  /** Uses the robot's camera of the present scene, on the page or in VR. */
  private useRobotCamera(): void {
    const { wristCamera } = this.world;
    this.picture.render(this.view.renderer, this.view.scene, wristCamera);
    const camera = this.fromRobot && !this.presenting ? wristCamera : null;
    if (camera === this.camera) return;
    this.camera = camera;
    this.view.useCamera(camera, camera?.fov);
  }

  private press(button: DemonstrationButton): void {
    this.connection.send({ type: "demonstrate", button });
  }

  /** Opens the clutch, whatever the controller reports. */
  private release(): void {
    const { xrFromWorld } = this.viewpoint;
    if (this.clutched) this.connection.send({ type: "steer", clutch: false, grip: null, xr_from_world: xrFromWorld, scale: 1 });
    this.setClutched(false);
  }

  private setClutched(clutched: boolean): void {
    this.clutched = clutched;
    this.marker.material.color.set(clutched ? CLUTCHED_COLOUR : IDLE_COLOUR);
    this.world.highlightTool(clutched);
  }

  private frame(timeMs: number, frame?: XRFrame): void {
    const space = this.view.renderer.xr.getReferenceSpace();
    if (frame && space && this.presenting) this.steer(timeMs, frame, this.reader.read(frame, space));
    this.lastMs = timeMs;
    this.framesDrawn++;
    this.world.update(timeMs, null, 0);
    this.useRobotCamera();
    this.view.render();
  }

  private steer(timeMs: number, frame: XRFrame, poses: Poses): void {
    const controls = this.controls.read(frame.session.inputSources);
    if (poses.head) this.place(poses.head, controls, (timeMs - this.lastMs) / 1000);
    if (controls.toggledCamera) this.picture.show(this.picture.shown ? null : poses.head);
    const clutch = controls.clutch && this.session.visibility === "visible";
    if (clutch !== this.clutched) this.setClutched(clutch);
    const open = this.connection.connected && this.connection.backlog <= BACKLOG_LIMIT_BYTES;
    if (open && this.throttle.pass(timeMs))
      this.connection.send(steerMessage({ ...controls, clutch }, poses, this.viewpoint.xrFromWorld, this.scale));
    const button = this.progress && episodeButton(controls, this.progress.stage === "running");
    if (button && !(button === "start" && this.loading)) this.press(button);
    this.haptics.frame(controls.hand, timeMs);
    const grip = poses[controls.hand];
    if (grip) this.marker.position.set(...grip[0]);
    this.caption.show(clutch ? "" : this.text, poses.head, PRESENTATION);
  }

  /** Changes the viewpoint while the clutch is open. */
  private place(head: NonNullable<Poses["head"]>, controls: Controls, seconds: number): void {
    if (controls.clutch) return;
    if (controls.nextView || !this.viewpoint.placed) this.viewpoint.next(head);
    this.viewpoint.move(head, controls.move, controls.turn, Math.min(seconds, 0.1));
  }

  private get scale(): number {
    return Number(element<HTMLSelectElement>("scale").value);
  }

  /** The text in VR. */
  private get text(): string {
    if (this.progress) return `${stageText(this.progress)} ${countText(this.progress)}`;
    return this.operated ? "Hold a grip button to drive the robot." : "Another driver controls the robot.";
  }
}
