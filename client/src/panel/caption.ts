import { Quaternion, Vector3 } from "three";
import { CanvasPlane } from "../panel/canvas-plane";
import { paintCaption } from "../panel/paint-panel";
import { PRESENTATION } from "../input/input-profile";
import type { PresentationPreferences, XRPose } from "../generated/messages";

/** Size of the canvas in pixels, and width in metres at the distance, so that the text has 1.5° as on the panel. */
const WIDTH = 1200;
const HEIGHT = 260;
const DISTANCE_M = 1;
const WIDTH_M = 0.4375;
/** Angles from the viewing direction: downwards, and to the side that the participant prefers. */
const BELOW_RAD = (17 * Math.PI) / 180;
const ASIDE_RAD = (15 * Math.PI) / 180;
/** Minimum duration of a caption. */
const SHOWN_MS = 3000;

/** The caption of the latest sound. */
export class Captions {
  private text = "";
  private untilMs = 0;

  /** A caption remains for at least 3 s, and as long as `sounding`. */
  constructor(private readonly sounding: () => boolean) {}

  /** A sound begins. */
  begin(text: string, nowMs: number): void {
    this.text = text;
    this.untilMs = nowMs + SHOWN_MS;
  }

  /** The text to show now, or an empty one. */
  at(nowMs: number): string {
    if (nowMs >= this.untilMs && !this.sounding()) this.text = "";
    return this.text;
  }
}

/** A caption in VR that follows the head, below the middle of the view. */
export class CaptionPlane {
  private readonly plane = new CanvasPlane(WIDTH, HEIGHT, WIDTH_M);
  readonly mesh = this.plane.mesh;
  private painted = "";

  constructor() {
    this.mesh.material.depthTest = false;
  }

  /** Shows a caption; an empty text hides it. */
  show(text: string, head: XRPose | null, { position, contrast, text_deg }: PresentationPreferences): void {
    this.mesh.visible = text !== "" && head !== null;
    if (!text || !head) return;
    if (this.painted !== contrast + text) this.plane.paint((context) => paintCaption(context, text, contrast, WIDTH, HEIGHT));
    this.painted = contrast + text;
    const [[x, y, z], orientation] = head;
    const aside = { left: 1, centre: 0, right: -1 }[position] * ASIDE_RAD;
    const direction = new Vector3(0, -Math.sin(BELOW_RAD), -Math.cos(BELOW_RAD)).applyAxisAngle(new Vector3(0, 1, 0), aside);
    const turn = new Quaternion(...orientation);
    this.mesh.scale.setScalar(text_deg / PRESENTATION.text_deg);
    this.mesh.position.copy(direction.multiplyScalar(DISTANCE_M).applyQuaternion(turn)).add({ x, y, z });
    this.mesh.up.set(0, 1, 0).applyQuaternion(turn);
    this.mesh.lookAt(x, y, z);
    this.mesh.updateMatrixWorld();
  }
}
