import { Matrix4, Quaternion, Vector3 } from "three";
import { P_SPACE, XRDevice, metaQuest3 } from "iwer";
import type { App } from "./app";
import { confirmsAnswers } from "./display";
import type { BodyPose } from "./body";
import type { Phase, Question, XRPose } from "./messages";
import { poseOf, type Poses } from "./tracking";
import tickerUrl from "./ticker?worker&url";

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

/** What automated tests drive the page with. It exists only with `?emulate=1`. */
export interface EmulatorControls {
  /** The emulated device itself, for what the functions below leave out. */
  device: XRDevice;
  /** Places the headset and the grips of the controllers; null: not tracked; left out: as before. */
  setPoses(poses: { head?: EmulatedPose; left?: EmulatedPose | null; right?: EmulatedPose | null }): void;
  setTrigger(hand: Hand, pressed: boolean): void;
  /** Holds the menu button of a hand (X or A) down. */
  holdMenu(hand: Hand, pressed: boolean): void;
  /** Turns a controller about its target ray's origin until the ray meets a point. */
  aimAt(hand: Hand, point: Triple): void;
  /** The buttons on the panel, those of a question or of the bodies to choose; empty while none is to be seen. */
  buttons(): EmulatedButton[];
  phase(): Phase | null;
  question(): Question | null;
  /** Both, in one call. */
  standing(): [Phase | null, Question | null];
  statesReceived(): number;
  lastState(): {
    sequence: number;
    simulation_time_s: number;
    tracking_sequence: number;
    poses: number[];
  } | null;
  /** In the frame drawn last: where the participant is, and the poses of all bodies as drawn and as simulated. */
  ownBody(): { tracked: BodyPose | null; drawn: number[]; simulated: number[] };
  presenting(): boolean;
  trackingSent(): number;
  framesDrawn(): number;
}

declare global {
  interface Window {
    avrgymEmulator?: EmulatorControls;
  }
}

/** Puts an emulated Quest 3 in the place of `navigator.xr`; must come before anything asks for it. */
export function installEmulator(): XRDevice {
  const canvasContainer = document.createElement("div");
  const device = new XRDevice(metaQuest3, { stereoEnabled: true, visibilityMask: null, canvasContainer });
  canvasContainer.style.zIndex = "0";
  for (const hand of ["left", "right"] as const) claimTracked(controllerOf(device, hand).inputSource);
  device.installRuntime({ forceInstall: true });
  return device;
}

/** The emulator calls every position guessed; those of tracked controllers are not. */
function claimTracked(source: { gripSpace?: unknown }): void {
  (source.gripSpace as { [P_SPACE]: { emulated: boolean } })[P_SPACE].emulated = false;
}

export function exposeEmulator(app: App, device: XRDevice): void {
  cacheClearValues(app.view.renderer.getContext() as WebGL2RenderingContext);
  window.avrgymEmulator = {
    device,
    setPoses: ({ head, left, right }) => {
      if (head) move(device, new Vector3(...head.position), new Quaternion(...head.orientation));
      if (left !== undefined) setGrip(device, "left", left);
      if (right !== undefined) setGrip(device, "right", right);
    },
    setTrigger: (hand, pressed) => controllerOf(device, hand).updateButtonValue("trigger", pressed ? 1 : 0),
    holdMenu: (hand, pressed) =>
      controllerOf(device, hand).updateButtonValue(hand === "left" ? "x-button" : "a-button", pressed ? 1 : 0),
    aimAt: (hand, point) => aim(controllerOf(device, hand), new Vector3(...point)),
    buttons: () => shownButtons(app),
    phase: () => app.phase,
    question: () => app.questionnaire.question,
    standing: () => [app.phase, app.questionnaire.question],
    statesReceived: () => app.statesReceived,
    lastState: () => plainState(app),
    ownBody: () => plainBody(app),
    presenting: () => app.presenting,
    trackingSent: () => app.immersive.numbering.count,
    framesDrawn: () => app.immersive.frames,
  };
  trackByTimer(app, device);
}

interface TrustedTypes {
  createPolicy(name: string, rules: { createScriptURL(url: string): string }): { createScriptURL(url: string): string };
}

/** The address of a built script, as browsers want it that enforce trusted types; the server allows this policy alone. */
function ours(url: string): string {
  const { trustedTypes } = window as unknown as { trustedTypes?: TrustedTypes };
  return trustedTypes?.createPolicy("avrgym", { createScriptURL: (same) => same }).createScriptURL(url) ?? url;
}

/** A real headset tracks however long a page takes to draw; so does the emulated one. */
function trackByTimer(app: App, device: XRDevice): void {
  app.immersive.trackedElsewhere = true;
  const ticker = new Worker(ours(tickerUrl), { type: "module" });
  ticker.onmessage = () => {
    if (app.presenting) app.immersive.track(posesOf(device), performance.now());
  };
}

function posesOf(device: XRDevice): Poses {
  const [left, right] = [gripOf(device, "left"), gripOf(device, "right")];
  return {
    head: poseOf(device.position, device.quaternion),
    left,
    right,
    left_modality: left ? "controller" : "none",
    right_modality: right ? "controller" : "none",
  };
}

function gripOf(device: XRDevice, hand: Hand): XRPose | null {
  const { connected, position, quaternion } = controllerOf(device, hand);
  if (!connected) return null;
  const ray = new Matrix4().compose(
    new Vector3(position.x, position.y, position.z),
    new Quaternion(quaternion.x, quaternion.y, quaternion.z, quaternion.w),
    new Vector3(1, 1, 1),
  );
  const [gripPosition, gripQuaternion] = [new Vector3(), new Quaternion()];
  ray.multiply(rayFromGrip(hand)).decompose(gripPosition, gripQuaternion, new Vector3());
  return poseOf(gripPosition, gripQuaternion);
}

/** A grip is fixed to the target ray of its controller by the device's own matrix. */
function rayFromGrip(hand: Hand): Matrix4 {
  return new Matrix4().fromArray(metaQuest3.controllerConfig!.layout[hand]!.gripOffsetMatrix!);
}

type Movable = Pick<XRDevice, "position" | "quaternion">;

function controllerOf(device: XRDevice, hand: Hand) {
  return device.controllers[hand]!;
}

function move(target: Movable, position: Vector3, orientation: Quaternion): void {
  target.position.set(position.x, position.y, position.z);
  target.quaternion.set(orientation.x, orientation.y, orientation.z, orientation.w);
}

/** A controller stands where its target ray begins. */
function setGrip(device: XRDevice, hand: Hand, grip: EmulatedPose | null): void {
  const controller = controllerOf(device, hand);
  controller.connected = grip !== null;
  if (!grip) return;
  const localFromGrip = new Matrix4().compose(
    new Vector3(...grip.position),
    new Quaternion(...grip.orientation).normalize(),
    new Vector3(1, 1, 1),
  );
  const [position, orientation] = [new Vector3(), new Quaternion()];
  localFromGrip.multiply(rayFromGrip(hand).invert()).decompose(position, orientation, new Vector3());
  move(controller, position, orientation);
}

function aim(controller: Movable, point: Vector3): void {
  const { x, y, z } = controller.position;
  const origin = new Vector3(x, y, z);
  const turned = new Matrix4().lookAt(origin, point, new Vector3(0, 1, 0));
  move(controller, origin, new Quaternion().setFromRotationMatrix(turned));
}

function shownButtons(app: App): EmulatedButton[] {
  if (!app.panel.mesh.visible) return [];
  return app.panel.buttons.map((button) => ({
    item: app.questionnaire.question?.item ?? (confirmsAnswers(app.phase) ? "confirm" : "body"),
    value: button.value,
    centre: app.panel.centreOf(button).toArray(),
  }));
}

function plainState({ lastState }: App): ReturnType<EmulatorControls["lastState"]> {
  if (!lastState) return null;
  const { sequence, simulation_time_s, tracking_sequence } = lastState;
  const poses = [...lastState.poses];
  return { sequence, simulation_time_s, tracking_sequence, poses };
}

function plainBody({ world }: App): ReturnType<EmulatorControls["ownBody"]> {
  return { tracked: world.tracked, drawn: [...world.drawn], simulated: [...world.simulated] };
}

/** The emulator asks for the clear values in every frame, which stalls a software renderer: answer from a copy. */
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
