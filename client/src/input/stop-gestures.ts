import { Vector3 } from "three";
import type { TrackedHands } from "../body/bare-hands";
import type { InputProfileMessage, StopMethod } from "../generated/messages";
import { isPalmRaised } from "./palm-gesture";
import type { Key } from "../page/texts";
import { CONTROLLERS, points, pointsWith, stopsBy } from "./input-profile";

/** Ways to stop the robot in VR. */
export type VrStopMethod = Exclude<StopMethod, "page" | "key"> | "experimenter";
type HeldStopMethod = Exclude<VrStopMethod, "button" | "switch" | "experimenter">;

/** For each stop method: its text, and the time for which it is held. */
export const STOP_METHODS: Readonly<Record<VrStopMethod, { text: Key; heldMs: number }>> = {
  button: { text: "stop_by_button", heldMs: 0 },
  triggers: { text: "stop_by_triggers", heldMs: 700 },
  squeeze: { text: "stop_by_triggers", heldMs: 700 },
  select: { text: "stop_by_select", heldMs: 700 },
  palm: { text: "stop_by_palm", heldMs: 700 },
  gaze: { text: "stop_by_gaze", heldMs: 1000 },
  switch: { text: "stop_by_switch", heldMs: 0 },
  experimenter: { text: "stop_by_experimenter", heldMs: 0 },
};

/** A, B, X, Y or menu button in the WebXR gamepad mapping. */
const MENU_BUTTONS = [4, 5];
/** The profile of hands. In browsers without hand joints, button 4 is the fist. */
export const HAND_PROFILE = "generic-hand-select";
/** Maximum interruption of tracked gestures that is ignored. */
const FLICKER_MS = 150;
/** Without any input source for this time, the stop method is the gaze. */
const ALONE_MS = 1000;
/** Maximum angle between the gaze and the middle of the stop sign. */
export const SIGN_RADIUS_RAD = (6 * Math.PI) / 180;

type Kind = "button" | "trigger" | "hand" | "gaze";

/** What an input source can stop with. */
export function kindOf({ hand, profiles, gamepad, targetRayMode }: XRInputSource): Kind {
  if (hand) return "hand";
  if (targetRayMode !== "tracked-pointer" || profiles.includes(HAND_PROFILE)) return "gaze";
  return MENU_BUTTONS.some((index) => gamepad?.buttons[index]) ? "button" : "trigger";
}

/** The displayed stop method; null without input sources. */
export function stopMethodFor(sources: Iterable<XRInputSource>): VrStopMethod | null {
  const kinds = Array.from(sources, kindOf);
  if (kinds.includes("button")) return "button";
  const triggers = kinds.filter((kind) => kind === "trigger").length;
  if (triggers > 0) return triggers > 1 ? "triggers" : "select";
  if (kinds.includes("hand")) return "palm";
  return kinds.length > 0 ? "gaze" : null;
}

/** Whether a menu button is pressed. */
export function menuIsDown(sources: Iterable<XRInputSource>): boolean {
  for (const source of sources) {
    if (kindOf(source) !== "button") continue;
    for (const index of MENU_BUTTONS) if (source.gamepad?.buttons[index]?.pressed) return true;
  }
  return false;
}

/** The number of the held press, gesture or gaze; null: none. */
type TargetSelectionRequest = number | null;

/** A press, gesture or gaze that stops the robot when it has been held long enough. */
class Hold {
  private press: TargetSelectionRequest = null;
  private sinceMs: number | null = null;
  private seenMs = -Infinity;
  private used = false;

  constructor(
    private readonly heldMs: number,
    private readonly flickerMs: number,
    /** Whether a press counts only if it began while a stop was possible. */
    private readonly pressed: boolean,
  ) {}

  /** The share of its time that it has been held, 0 to 1; 1 is returned once per press. */
  share(press: TargetSelectionRequest, possible: boolean, nowMs: number): number {
    const held = press !== null;
    if (held && press !== this.press) this.letGo();
    this.press = press ?? this.press;
    if (held) this.seenMs = nowMs;
    else if (nowMs - this.seenMs > this.flickerMs || this.flickerMs === 0) this.letGo();
    if (!possible) {
      this.sinceMs = null;
      this.used ||= this.pressed && held;
    }
    if (!possible || this.used) return 0;
    if (held) this.sinceMs ??= nowMs;
    if (this.sinceMs === null) return 0;
    const share = Math.min(1, (nowMs - this.sinceMs) / this.heldMs);
    if (share < 1 || !held) return Math.min(share, 0.99);
    this.used = true;
    return 1;
  }

  private letGo(): void {
    this.sinceMs = null;
    this.used = false;
  }
}

/** The participant's inputs in one frame. */
export interface Seen {
  sources: Iterable<XRInputSource>;
  eyes: Vector3 | null;
  /** The gaze direction. */
  gaze: Vector3;
  hands: TrackedHands;
  /** The position of the stop sign's middle. */
  sign: Vector3 | null;
}

/** The stop method that a profile determines; null: that of the device. */
export function stopMethodOf(profile: InputProfileMessage): VrStopMethod | null {
  if (points(profile)) return null;
  return (["switch", "gaze"] as const).find((way) => stopsBy(profile, way)) ?? "experimenter";
}

/** Detects all stop methods that are held for a time. */
export class StopGestures {
  profile = CONTROLLERS;
  /** The stop method of the present inputs. */
  method: VrStopMethod = "gaze";
  /** The progress of the stop, 0 to 1. */
  progress = 0;
  /** Sequence numbers of the present presses of each source. */
  private readonly selecting = new Map<XRInputSource, number>();
  private readonly squeezing = new Map<XRInputSource, number>();
  private presses = 0;
  private readonly holds: Readonly<Record<HeldStopMethod, Hold>> = {
    triggers: new Hold(STOP_METHODS.triggers.heldMs, 0, true),
    squeeze: new Hold(STOP_METHODS.squeeze.heldMs, 0, true),
    select: new Hold(STOP_METHODS.select.heldMs, 0, true),
    palm: new Hold(STOP_METHODS.palm.heldMs, FLICKER_MS, false),
    gaze: new Hold(STOP_METHODS.gaze.heldMs, FLICKER_MS, false),
  };
  private sourcesMs = -Infinity;

  /** Listens to the presses of a new session. */
  listen(session: XRSession): void {
    this.selecting.clear();
    this.squeezing.clear();
    session.addEventListener("selectstart", ({ inputSource }) => this.selecting.set(inputSource, this.presses++));
    session.addEventListener("selectend", ({ inputSource }) => this.selecting.delete(inputSource));
    session.addEventListener("squeezestart", ({ inputSource }) => this.squeezing.set(inputSource, this.presses++));
    session.addEventListener("squeezeend", ({ inputSource }) => this.squeezing.delete(inputSource));
  }

  /** The method of a completed stop, or null. `possible`: whether the robot can be stopped now. */
  watch(seen: Seen, possible: boolean, nowMs: number): HeldStopMethod | null {
    const sources = Array.from(seen.sources).filter((each) => !points(this.profile) || pointsWith(this.profile, each));
    this.chooseMethod(sources, nowMs);
    const held = this.held(seen, sources);
    const methods = Object.entries(this.holds) as [HeldStopMethod, Hold][];
    const shares = methods.map(([method, hold]) => hold.share(held[method], possible, nowMs));
    this.progress = Math.max(...shares);
    return methods[shares.indexOf(1)]?.[0] ?? null;
  }

  private chooseMethod(sources: XRInputSource[], nowMs: number): void {
    const method = stopMethodOf(this.profile) ?? stopMethodFor(sources);
    if (method) this.sourcesMs = nowMs;
    if (method) this.method = method;
    else if (nowMs - this.sourcesMs > ALONE_MS) this.method = "gaze";
  }

  /** Whether the participant stops by looking at the sign. */
  get byGaze(): boolean {
    return this.method === "gaze" || stopsBy(this.profile, "gaze");
  }

  private held({ eyes, gaze, hands, sign }: Seen, sources: XRInputSource[]): Record<HeldStopMethod, TargetSelectionRequest> {
    const triggers = sources.filter((source) => kindOf(source) === "trigger");
    const selects = pressesOf(triggers, this.selecting);
    const squeezes = pressesOf(triggers, this.squeezing);
    const all = triggers.length > 0 && selects.length === triggers.length ? Math.max(...selects) : null;
    const raised = (side: "left" | "right") => hands[side] !== null && isPalmRaised(side, hands[side].matrices, eyes!);
    return {
      triggers: triggers.length > 1 ? all : null,
      squeeze: squeezes.length > 0 ? Math.min(...squeezes) : null,
      select: triggers.length === 1 ? all : null,
      palm: eyes !== null && (raised("left") || raised("right")) ? 0 : null,
      gaze: this.byGaze && looksAt(eyes, gaze, sign) ? 0 : null,
    };
  }
}

function pressesOf(sources: readonly XRInputSource[], pressed: ReadonlyMap<XRInputSource, number>): number[] {
  return sources.flatMap((source) => pressed.get(source) ?? []);
}

const towards = new Vector3();

function looksAt(eyes: Vector3 | null, gaze: Vector3, sign: Vector3 | null): boolean {
  return eyes !== null && sign !== null && towards.copy(sign).sub(eyes).angleTo(gaze) < SIGN_RADIUS_RAD;
}
