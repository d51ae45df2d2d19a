import type { DemonstrationButton, ControllerPoseCommand, XRPose } from "../generated/messages";
import { findSource, type Poses } from "../tracking/pose-reader";

export type Hand = "left" | "right";

const TRIGGER = 0;
const GRIP = 1;
const STICK_PRESS = 3;
const ACCEPT = 4;
const REJECT = 5;
const HANDS: readonly Hand[] = ["right", "left"];
/** Tool force, N, with the maximum strength of the vibration, and the least force that is felt. */
const STRONG_N = 15;
const FELT_N = 0.2;
const PULSE_MS = 60;

/** The inputs of the controllers in one XR frame. */
export interface Controls {
  /** The hand whose clutch is held, or that held it last. */
  hand: Hand;
  clutch: boolean;
  /** Deflections of the sticks, −1 to 1. */
  move: readonly [right: number, back: number];
  turn: number;
  /** Buttons that were pressed since the last frame. */
  accepted: boolean;
  rejected: boolean;
  nextView: boolean;
  toggledCamera: boolean;
}

/** Reads clutch, buttons and sticks of both controllers. */
export class ControlReader {
  private hand: Hand = "right";
  private down = new Set<number>();

  read(sources: XRInputSourceArray): Controls {
    const pads = new Map(HANDS.map((hand) => [hand, findSource(sources, hand)?.gamepad]));
    const pressed = (index: number) => HANDS.some((hand) => pads.get(hand)?.buttons[index]?.pressed);
    const held = (hand: Hand) => !!pads.get(hand)?.buttons[GRIP]?.pressed;
    if (!held(this.hand)) this.hand = HANDS.find(held) ?? this.hand;
    const down = new Set([TRIGGER, STICK_PRESS, ACCEPT, REJECT].filter(pressed));
    const isNew = (index: number) => down.has(index) && !this.down.has(index);
    const controls: Controls = {
      hand: this.hand,
      clutch: held(this.hand),
      move: [pads.get("left")?.axes[2] ?? 0, pads.get("left")?.axes[3] ?? 0],
      turn: pads.get("right")?.axes[2] ?? 0,
      accepted: isNew(ACCEPT),
      rejected: isNew(REJECT),
      nextView: isNew(STICK_PRESS),
      toggledCamera: isNew(TRIGGER),
    };
    this.down = down;
    return controls;
  }
}

/** The message of one XR frame. */
export function steerMessage({ hand, clutch }: Controls, poses: Poses, xrFromWorld: XRPose, scale: number): ControllerPoseCommand {
  return { type: "steer", clutch, grip: poses[hand], xr_from_world: xrFromWorld, scale };
}

/** The button of an episode for the accept and reject buttons of a controller. */
export function episodeButton({ accepted, rejected }: Controls, running: boolean): DemonstrationButton | null {
  if (rejected) return "discard";
  return accepted ? (running ? "success" : "start") : null;
}

/** Vibrates while the tool touches the person. */
export class ForceHaptics {
  forceN = 0;
  private dueMs = 0;

  constructor(private readonly pulse: (hand: Hand, strength: number, ms: number) => void) {}

  frame(hand: Hand, nowMs: number): void {
    if (this.forceN < FELT_N || nowMs < this.dueMs) return;
    this.dueMs = nowMs + PULSE_MS;
    this.pulse(hand, Math.min(1, 0.1 + (0.9 * this.forceN) / STRONG_N), PULSE_MS);
  }
}
