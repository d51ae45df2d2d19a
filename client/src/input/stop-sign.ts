import { Quaternion, Vector3 } from "three";
import { CanvasPlane } from "../panel/canvas-plane";
import { wrap } from "../panel/paint-panel";
import { STOP_METHODS, type VrStopMethod } from "./stop-gestures";
import type { Texts } from "../page/texts";

/** Size of the sign's canvas in pixels, and of the sign in metres. */
const WIDTH = 512;
const HEIGHT = 448;
const WIDTH_M = 0.32;
const HEIGHT_M = (WIDTH_M * HEIGHT) / WIDTH;
const DISC = { x: WIDTH / 2, y: 132, radius: 92 };
const RING = 22;
const TEXT_PIXELS = 34;
/** Height of the disc's middle above that of the sign. */
const MIDDLE_M = (0.5 - DISC.y / HEIGHT) * HEIGHT_M;
/** Number of steps of the progress ring. */
const STEPS = 40;
const DISTANCE_M = 1.1;
/** Position of the sign relative to the head: above and to the left, away from robot and table. */
const ASIDE = new Vector3(-0.62, 0.36, -1).normalize().multiplyScalar(DISTANCE_M);
const COLOUR = { sign: "#c62828", ring: "#ffd36b", quiet: "#5b1717", text: "#ffffff", plate: "rgba(15, 42, 49, 0.85)" };

/** A sign in VR with the method to stop the robot, and a progress ring. */
export class StopSign {
  private readonly plane = new CanvasPlane(WIDTH, HEIGHT, WIDTH_M);
  readonly mesh = this.plane.mesh;
  private painted = "";
  private stands: Vector3 | null = null;

  /** The position of the disc in `local-floor`; null while it is hidden or follows the head. */
  get middle(): Vector3 | null {
    return this.stands;
  }

  hide(): void {
    this.mesh.visible = false;
    this.stands = null;
  }

  /** Shows the stop method and its progress. */
  show(method: VrStopMethod, progress: number, texts: Texts, byGaze: boolean): void {
    this.mesh.visible = true;
    this.mesh.material.depthTest = progress === 0 && !byGaze;
    if (!byGaze) this.stands = null;
    const step = Math.round(progress * STEPS);
    const wanted = `${method} ${step} ${texts.language}`;
    if (wanted === this.painted) return;
    this.painted = wanted;
    const [sign, how] = [texts.get("stop_sign"), texts.get(STOP_METHODS[method].text)];
    this.plane.paint((context) => paintSign(context, sign, how, step / STEPS));
  }

  /** Moves the sign with the head; a sign for the gaze stays in the room. */
  place(byGaze: boolean, eyes: Vector3, turn: Quaternion): void {
    if (this.stands) return;
    const { mesh } = this;
    if (byGaze) {
      this.stands = standingMiddle(eyes, turn);
      mesh.position.copy(this.stands).setY(this.stands.y - MIDDLE_M);
    } else mesh.position.copy(ASIDE).applyQuaternion(turn).add(eyes);
    mesh.lookAt(eyes);
    mesh.updateMatrixWorld();
  }
}

/** The position of a sign that stays in the room, from the head pose when it appears. */
export function standingMiddle(eyes: Vector3, turn: Quaternion): Vector3 {
  return ASIDE.clone().applyQuaternion(level(turn)).add(eyes);
}

/** The yaw of a rotation. */
function level({ y, w }: Quaternion): Quaternion {
  return new Quaternion(0, y, 0, w).normalize();
}

function paintSign(context: CanvasRenderingContext2D, sign: string, how: string, progress: number): void {
  const { x, y, radius } = DISC;
  context.clearRect(0, 0, WIDTH, HEIGHT);
  context.textAlign = "center";
  context.textBaseline = "middle";
  disc(context, radius + RING, COLOUR.quiet);
  context.beginPath();
  context.moveTo(x, y);
  context.arc(x, y, radius + RING, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * progress);
  context.fillStyle = COLOUR.ring;
  context.fill();
  disc(context, radius, COLOUR.sign);
  const font = (pixels: number, weight: number) => `${weight} ${pixels}px system-ui, "Segoe UI", Roboto, Arial, sans-serif`;
  context.font = font(56, 700);
  context.fillStyle = COLOUR.text;
  context.fillText(sign, x, y, 2 * radius - 16);
  context.font = font(TEXT_PIXELS, 500);
  const lines = wrap(how, WIDTH - 48, (line) => context.measureText(line).width);
  const top = y + radius + RING + 18;
  context.fillStyle = COLOUR.plate;
  context.beginPath();
  context.roundRect(4, top, WIDTH - 8, lines.length * TEXT_PIXELS * 1.25 + 24, 20);
  context.fill();
  context.fillStyle = COLOUR.text;
  lines.forEach((line, at) => context.fillText(line, x, top + 12 + (at + 0.5) * TEXT_PIXELS * 1.25));
}

function disc(context: CanvasRenderingContext2D, radius: number, colour: string): void {
  context.beginPath();
  context.arc(DISC.x, DISC.y, radius, 0, 2 * Math.PI);
  context.fillStyle = colour;
  context.fill();
}
