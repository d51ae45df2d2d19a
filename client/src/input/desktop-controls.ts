import { Euler, PerspectiveCamera, Quaternion, Vector3 } from "three";
import { poseOf, type Poses } from "../tracking/pose-reader";

/** Eye height of a person in the virtual wheelchair, metres above the floor. */
const EYE_HEIGHT_M = 1.2;
const RADIANS_PER_PIXEL = 0.004;
const HIGHEST_PITCH = 1.2;
const HIGHEST_YAW = 1.2;
const HAND_SPEED_M_S = 0.35;
const REACH_M = 0.62;

/** A fist around a vertical rod with the forearm forward; see WebXR's grip space. */
const UPRIGHT_GRIP = new Quaternion(Math.SQRT1_2, 0, 0, Math.SQRT1_2);
const RIGHT_SHOULDER = new Vector3(0.17, 0.98, 0.08);
const RIGHT_HAND = new Vector3(0.22, 0.74, -0.32);
const LEFT_HAND = new Vector3(-0.22, 0.74, -0.32);

/** Directions of the right hand by key, in `local-floor`. */
const MOVES: Readonly<Record<string, Vector3>> = {
  KeyW: new Vector3(0, 0, -1),
  KeyS: new Vector3(0, 0, 1),
  KeyA: new Vector3(-1, 0, 0),
  KeyD: new Vector3(1, 0, 0),
  KeyE: new Vector3(0, 1, 0),
  KeyQ: new Vector3(0, -1, 0),
};

/** Participation without a headset: the mouse turns the head, keys move the right hand. */
export class DesktopControls {
  readonly camera = new PerspectiveCamera(undefined, 1, 0.03, 30);
  playing = false;
  private yaw = 0;
  private pitch = -0.2;
  private lastMs = 0;
  private readonly hand = RIGHT_HAND.clone();
  private readonly pressed = new Set<string>();
  private readonly step = new Vector3();

  constructor(view: HTMLElement, handButtons: Iterable<HTMLElement> = []) {
    view.addEventListener("pointermove", (event) => this.turn(event));
    window.addEventListener("keyup", ({ code }) => this.pressed.delete(code));
    window.addEventListener("blur", () => this.pressed.clear());
    for (const button of handButtons) this.holdWith(button);
    this.camera.position.set(0, EYE_HEIGHT_M, 0);
  }

  /** Whether the key moves the hand. */
  press(code: string): boolean {
    if (this.playing && code in MOVES) this.pressed.add(code);
    return this.playing && code in MOVES;
  }

  /** Moves the hand and returns the present poses. */
  frame(timeMs: number): Poses {
    this.moveHand(Math.min(0.1, (timeMs - this.lastMs) / 1000));
    this.lastMs = timeMs;
    this.camera.quaternion.setFromEuler(new Euler(this.pitch, this.yaw, 0, "YXZ"));
    return this.poses;
  }

  /** The poses of head and hands since the last frame. */
  get poses(): Poses {
    return {
      head: poseOf(this.camera.position, this.camera.quaternion),
      left: poseOf(LEFT_HAND, UPRIGHT_GRIP),
      right: poseOf(this.hand, UPRIGHT_GRIP),
      left_modality: "mouse",
      right_modality: "mouse",
    };
  }

  /** Moves the hand while a button is pressed. */
  private holdWith(button: HTMLElement): void {
    const code = button.dataset["code"]!;
    button.addEventListener("pointerdown", ({ pointerId }) => {
      button.setPointerCapture(pointerId);
      this.press(code);
    });
    for (const event of ["pointerup", "pointercancel", "lostpointercapture"])
      button.addEventListener(event, () => this.pressed.delete(code));
  }

  private turn({ buttons, movementX, movementY }: PointerEvent): void {
    if (!this.playing || !(buttons & 1)) return;
    this.yaw = clamp(this.yaw - movementX * RADIANS_PER_PIXEL, HIGHEST_YAW);
    this.pitch = clamp(this.pitch - movementY * RADIANS_PER_PIXEL, HIGHEST_PITCH);
  }

  private moveHand(seconds: number): void {
    for (const code of this.pressed) this.hand.addScaledVector(MOVES[code]!, HAND_SPEED_M_S * seconds);
    this.step.copy(this.hand).sub(RIGHT_SHOULDER).clampLength(0.2, REACH_M);
    this.hand.copy(RIGHT_SHOULDER).add(this.step);
  }
}

function clamp(value: number, limit: number): number {
  return Math.max(-limit, Math.min(limit, value));
}
