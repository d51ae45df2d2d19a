import { Matrix4, Quaternion, Vector3 } from "three";
import { P_SPACE, XRDevice } from "iwer";
import type { App } from "../page/app";
import type { View } from "../scene/view";
import { confirmsAnswers, mayRecalibrate } from "../session/display-state";
import type { BodyPose } from "../body/body-solver";
import { DEVICES, type EmulatedDevice } from "./emulated-devices";
import { raisePalm } from "./emulated-hand";
import { EmulatedPointer, turnTo } from "./emulated-pointer";
import type { PhaseDescription, Question, XRPose } from "../generated/messages";
import { poseOf, type Poses } from "../tracking/pose-reader";
import tickerUrl from "./timer-worker?worker&url";

type Hand = "left" | "right";
type Triple = [x: number, y: number, z: number];

/** A pose in `local-floor`; the orientation is x, y, z, w. */
export interface EmulatedPose {
  position: Triple;
  orientation: [x: number, y: number, z: number, w: number];
}

export interface EmulatedButton {
  item: string;
  value: number;
  centre: Triple;
}

/** Controls for automated tests. Only with `?emulate=1`. */
export interface EmulatorControls {
  /** The emulated device, for everything else. */
  device: XRDevice;
  /** Sets the poses of headset and controller grips. null: not tracked; undefined: unchanged. */
  setPoses(poses: { head?: EmulatedPose; left?: EmulatedPose | null; right?: EmulatedPose | null }): void;
  setTrigger(hand: Hand, pressed: boolean): void;
  /** Presses or releases the menu button of a hand (X or A). */
  holdMenu(hand: Hand, pressed: boolean): void;
  /** Presses or releases the grip button of a hand. */
  setSqueeze(hand: Hand, pressed: boolean): void;
  /** Turns a controller until its target ray meets a point. */
  aimAt(hand: Hand, point: Triple): void;
  /** Points with this headset's pointer: the right controller or hand, the only button, or the eyes. */
  pointAt(point: Triple): void;
  /** Presses or releases the select input of this headset's pointer. */
  select(pressed: boolean): void;
  /** Turns the head towards a point. */
  lookAt(point: Triple): void;
  /** Raises an open bare hand before the face, palm away from it. */
  raisePalm(hand: Hand): void;
  /** The displayed stop method, its progress, and the position of a sign in the room. */
  stop(): { method: string; progress: number; sign: Triple | null };
  /** The visible buttons on the panel, of a question or of the body choice; without a panel, the command icons. */
  buttons(): EmulatedButton[];
  phase(): PhaseDescription | null;
  question(): Question | null;
  /** The value of the highlighted target, and the number of the offered ones. */
  highlighted(): number | null;
  offer(): number;
  /** PhaseDescription and question in one call. */
  phaseAndQuestion(): [PhaseDescription | null, Question | null];
  statesReceived(): number;
  lastState(): {
    sequence: number;
    simulation_time_s: number;
    tracking_sequence: number;
    poses: number[];
  } | null;
  /** In the last frame: the tracked pose, and the poses of all bodies as drawn and as simulated. */
  participantBody(): { tracked: BodyPose | null; drawn: number[]; simulated: number[] };
  presenting(): boolean;
  trackingSent(): number;
  framesDrawn(): number;
}

declare global {
  interface Window {
    avrgymEmulator?: EmulatorControls;
  }
}

/** An emulated headset, and its pointer if that is neither a controller nor a hand. */
export interface Emulator extends EmulatedDevice {
  device: XRDevice;
  pointer: EmulatedPointer | null;
}

/** Replaces `navigator.xr` by an emulated headset; must run before any other access. */
export function installEmulator(name: string): Emulator {
  const emulated = DEVICES[name];
  if (!emulated) throw new Error(`no headset ${name} is emulated; choose one of ${Object.keys(DEVICES).join(", ")}`);
  const canvasContainer = document.createElement("div");
  const device = new XRDevice(emulated.config, { stereoEnabled: true, visibilityMask: null, canvasContainer });
  canvasContainer.style.zIndex = "0";
  for (const controller of Object.values(device.controllers)) markTracked(controller!.inputSource);
  device.installRuntime({ forceInstall: true });
  return { ...emulated, device, pointer: pointerOf(device, emulated.input) };
}

function pointerOf(device: XRDevice, input: EmulatedDevice["input"]): EmulatedPointer | null {
  if (input !== "controllers") device.primaryInputMode = "hand";
  if (input === "controllers" || input === "hands") return null;
  for (const hand of Object.values(device.hands)) hand!.connected = false;
  return new EmulatedPointer(device, input === "gaze" ? "gaze" : "transient-pointer");
}

/** Marks a source as tracked: the emulator reports all positions as emulated. */
function markTracked(source: { gripSpace?: unknown }): void {
  if (source.gripSpace) (source.gripSpace as { [P_SPACE]: { emulated: boolean } })[P_SPACE].emulated = false;
}

/** Exposes the controls of the headset, for pages without a participant. */
export function exposeDevice(
  page: { view: View; presenting: boolean; framesDrawn: number; lastState: App["lastState"] },
  emulator: Emulator,
): void {
  cacheClearValues(page.view.renderer.getContext() as WebGL2RenderingContext);
  const controls: Partial<EmulatorControls> = {
    ...deviceControls(emulator),
    presenting: () => page.presenting,
    framesDrawn: () => page.framesDrawn,
    lastState: () => plainState(page),
  };
  window.avrgymEmulator = controls as EmulatorControls;
}

/** The controls of headset and controllers alone. */
function deviceControls(emulator: Emulator) {
  const { device } = emulator;
  return {
    device,
    setPoses: ({ head, left, right }) => {
      if (head) move(device, new Vector3(...head.position), new Quaternion(...head.orientation));
      if (left !== undefined) setGrip(emulator, "left", left);
      if (right !== undefined) setGrip(emulator, "right", right);
    },
    setTrigger: (hand, pressed) => setTrigger(emulator, hand, pressed),
    setSqueeze: (hand, pressed) => controllerOf(device, hand).updateButtonValue("squeeze", pressed ? 1 : 0),
    holdMenu: (hand, pressed) =>
      controllerOf(device, hand).updateButtonValue(hand === "left" ? "x-button" : "a-button", pressed ? 1 : 0),
    aimAt: (hand, point) => turnTo(controllerOf(device, hand), new Vector3(...point)),
    lookAt: (point) => turnTo(device, new Vector3(...point)),
  } satisfies Partial<EmulatorControls>;
}

export function exposeEmulator(app: App, emulator: Emulator): void {
  const { device } = emulator;
  cacheClearValues(app.view.renderer.getContext() as WebGL2RenderingContext);
  window.avrgymEmulator = {
    ...deviceControls(emulator),
    pointAt: (point) => pointAt(emulator, new Vector3(...point)),
    select: (pressed) => select(emulator, pressed),
    raisePalm: (hand) => raisePalm(device, hand),
    stop: () => {
      const { method, progress, sign } = app.stopControl;
      return { method, progress, sign: sign.middle?.toArray() ?? null };
    },
    buttons: () => shownButtons(app),
    phase: () => app.phase,
    question: () => app.choices.questionnaire.question,
    phaseAndQuestion: () => [app.phase, app.choices.questionnaire.question],
    highlighted: () => app.choices.selection.highlighted,
    offer: () => app.choices.selection.number,
    statesReceived: () => app.statesReceived,
    lastState: () => plainState(app),
    participantBody: () => plainBody(app),
    presenting: () => app.presenting,
    trackingSent: () => app.xrFrames.numbering.count,
    framesDrawn: () => app.xrFrames.frames,
  };
  trackByTimer(app, emulator);
}

function pointAt({ device, pointer, input }: Emulator, point: Vector3): void {
  if (pointer) pointer.lookAt(point);
  else turnTo(input === "hands" ? device.hands["right"]! : pointingController(device), point);
}

function select(emulator: Emulator, pressed: boolean): void {
  const { device, pointer, input } = emulator;
  if (pointer) pointer.press(pressed);
  else if (input === "hands") setTrigger(emulator, "right", pressed);
  else pointingController(device).updateButtonValue("trigger", pressed ? 1 : 0);
}

function setTrigger({ device, input }: Emulator, hand: Hand, pressed: boolean): void {
  if (input === "hands") device.hands[hand]!.updatePinchValue(pressed ? 1 : 0);
  else controllerOf(device, hand).updateButtonValue("trigger", pressed ? 1 : 0);
}

/** The right controller, or the only one. */
function pointingController({ controllers }: XRDevice): Controller {
  return controllers["right"] ?? controllers["none"]!;
}

interface TrustedTypes {
  createPolicy(name: string, rules: { createScriptURL(url: string): string }): { createScriptURL(url: string): string };
}

/** A trusted script URL. The server's policy allows only the policy name used here. */
function trustedURL(url: string): string {
  const { trustedTypes } = window as unknown as { trustedTypes?: TrustedTypes };
  return trustedTypes?.createPolicy("avrgym", { createScriptURL: (same) => same }).createScriptURL(url) ?? url;
}

/** Sends poses by a timer, as a real headset does, independent of drawing. */
function trackByTimer(app: App, emulator: Emulator): void {
  app.xrFrames.trackedElsewhere = true;
  const ticker = new Worker(trustedURL(tickerUrl), { type: "module" });
  ticker.onmessage = () => {
    if (app.presenting) app.xrFrames.track(withSensorNoise(posesOf(emulator)), performance.now());
  };
}

const SENSOR_NOISE_M = 1e-6;
let noise = 0;

/** Adds noise, so that no pose equals the previous one. */
function withSensorNoise(poses: Poses): Poses {
  noise = SENSOR_NOISE_M - noise;
  for (const pose of [poses.head, poses.left, poses.right]) if (pose) pose[0][0] += noise;
  return poses;
}

function posesOf(emulator: Emulator): Poses {
  const { device, input } = emulator;
  const [left, right] = [handPose(emulator, "left"), handPose(emulator, "right")];
  const modality = input === "hands" ? "hand" : "controller";
  return {
    head: poseOf(device.position, device.quaternion),
    left,
    right,
    left_modality: left ? modality : "none",
    right_modality: right ? modality : "none",
  };
}

/** The pose of a controller's grip or a bare hand's wrist. */
function handPose(emulator: Emulator, hand: Hand): XRPose | null {
  const held = deviceOf(emulator, hand);
  if (!held?.connected) return null;
  const { position, quaternion } = held;
  const ray = new Matrix4().compose(
    new Vector3(position.x, position.y, position.z),
    new Quaternion(quaternion.x, quaternion.y, quaternion.z, quaternion.w),
    new Vector3(1, 1, 1),
  );
  const [heldPosition, heldQuaternion] = [new Vector3(), new Quaternion()];
  ray.multiply(fromRay(held)).decompose(heldPosition, heldQuaternion, new Vector3());
  return poseOf(heldPosition, heldQuaternion);
}

/** The controller or bare hand; null if the headset tracks neither. */
function deviceOf({ device, input }: Emulator, hand: Hand): HeldDevice | null {
  if (input === "controllers") return device.controllers[hand] ?? null;
  return input === "hands" ? device.hands[hand]! : null;
}

/** The offset from the target ray to the grip or wrist. */
function fromRay({ inputSource: { hand, gripSpace } }: HeldDevice): Matrix4 {
  return offsetOf(hand?.get("wrist" as never) ?? gripSpace!);
}

function offsetOf(space: { [P_SPACE]: { offsetMatrix: ArrayLike<number> } }): Matrix4 {
  return new Matrix4().fromArray(Array.from(space[P_SPACE].offsetMatrix));
}

type Movable = Pick<XRDevice, "position" | "quaternion">;

type Controller = NonNullable<XRDevice["controllers"]["left"]>;
type HeldDevice = Pick<Controller, "connected" | "position" | "quaternion" | "inputSource">;

function controllerOf(device: XRDevice, hand: Hand) {
  return device.controllers[hand]!;
}

function move(target: Movable, position: Vector3, orientation: Quaternion): void {
  target.position.set(position.x, position.y, position.z);
  target.quaternion.set(orientation.x, orientation.y, orientation.z, orientation.w);
}

/** Sets the pose of a controller's grip or a bare hand's wrist. */
function setGrip(emulator: Emulator, hand: Hand, grip: EmulatedPose | null): void {
  const held = deviceOf(emulator, hand);
  if (!held) return;
  held.connected = grip !== null;
  if (!grip) return;
  const localFromGrip = new Matrix4().compose(
    new Vector3(...grip.position),
    new Quaternion(...grip.orientation).normalize(),
    new Vector3(1, 1, 1),
  );
  const [position, orientation] = [new Vector3(), new Quaternion()];
  localFromGrip.multiply(fromRay(held).invert()).decompose(position, orientation, new Vector3());
  move(held, position, orientation);
}

function shownButtons(app: App): EmulatedButton[] {
  if (!app.panel.mesh.visible || app.panel.buttons.length === 0) return shownIcons(app);
  return app.panel.buttons.map((button) => ({
    item: app.choices.questionnaire.question?.item ?? buttonPurpose(app),
    value: button.value,
    centre: app.panel.centreOf(button).toArray(),
  }));
}

/** The icons of robot commands. */
function shownIcons({ commandIcons }: App): EmulatedButton[] {
  return commandIcons.targets.flatMap(({ value }) => {
    const centre = commandIcons.centreOf(value)?.toArray();
    return centre ? [{ item: commandIcons.commandOf(value)!, value, centre }] : [];
  });
}

/** The purpose of the buttons without a question. */
function buttonPurpose({ phase, panel }: App): string {
  if (confirmsAnswers(phase)) return "confirm";
  if (mayRecalibrate(phase)) return "check";
  return panel.buttons.some(({ value }) => value > 0) ? "body" : "ready";
}

function plainState({ lastState }: Pick<App, "lastState">): ReturnType<EmulatorControls["lastState"]> {
  if (!lastState) return null;
  const { sequence, simulation_time_s, tracking_sequence } = lastState;
  const poses = [...lastState.poses];
  return { sequence, simulation_time_s, tracking_sequence, poses };
}

function plainBody({ world }: App): ReturnType<EmulatorControls["participantBody"]> {
  return { tracked: world.tracked, drawn: [...world.drawn], simulated: [...world.simulated] };
}

/** Caches WebGL's clear values: IWER queries them in every frame, which blocks a software renderer. */
function cacheClearValues(gl: WebGL2RenderingContext): void {
  const { clearColor, clearDepth, clearStencil, getParameter } = gl;
  const values = new Map<number, unknown>();
  for (const name of [gl.COLOR_CLEAR_VALUE, gl.DEPTH_CLEAR_VALUE, gl.STENCIL_CLEAR_VALUE]) {
    values.set(name, gl.getParameter(name));
  }
  gl.getParameter = (name: number) => (values.has(name) ? values.get(name) : getParameter.call(gl, name));
  gl.clearColor = (red, green, blue, alpha) => {
    values.set(gl.COLOR_CLEAR_VALUE, new Float32Array([red, green, blue, alpha]));
    clearColor.call(gl, red, green, blue, alpha);
  };
  gl.clearDepth = (depth) => {
    values.set(gl.DEPTH_CLEAR_VALUE, depth);
    clearDepth.call(gl, depth);
  };
  gl.clearStencil = (stencil) => {
    values.set(gl.STENCIL_CLEAR_VALUE, stencil);
    clearStencil.call(gl, stencil);
  };
}
