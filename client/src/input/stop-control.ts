import { Quaternion, Vector3 } from "three";
import type { TrackedHands } from "../body/bare-hands";
import { CONTROLLERS } from "./input-profile";
import { StopGestures, type VrStopMethod } from "./stop-gestures";
import { StopSign } from "./stop-sign";
import type { StopMethod } from "../generated/messages";
import type { Texts } from "../page/texts";

const FORWARD = new Vector3(0, 0, -1);

/** The emergency stop in VR: gestures and the sign that displays them. */
export class StopControl {
  readonly sign = new StopSign();
  profile = CONTROLLERS;
  private readonly stopping = new StopGestures();
  private readonly eyes = new Vector3();
  private readonly turn = new Quaternion();
  private readonly gaze = new Vector3();

  /** The stop method of the present inputs. */
  get method(): VrStopMethod {
    return this.stopping.method;
  }

  /** The progress of the stop, 0 to 1. */
  get progress(): number {
    return this.stopping.progress;
  }

  listen(session: XRSession): void {
    this.stopping.listen(session);
  }

  /** The method of a completed stop, or null. `possible`: whether the robot can be stopped now. */
  watch(
    frame: XRFrame,
    space: XRReferenceSpace,
    timeMs: number,
    hands: TrackedHands,
    possible: boolean,
    texts: Texts,
  ): StopMethod | null {
    const { sign, stopping, eyes } = this;
    stopping.profile = this.profile;
    const sources = frame.session.inputSources;
    const seen = this.look(frame, space, sources);
    const stopped = stopping.watch(
      { sources, eyes: seen ? eyes : null, gaze: this.gaze, hands, sign: sign.middle },
      possible,
      timeMs,
    );
    if (!possible) sign.hide();
    else if (seen) {
      sign.show(stopping.method, stopping.progress, texts, stopping.byGaze);
      sign.place(stopping.byGaze, eyes, this.turn);
    }
    return stopped;
  }

  /** Updates eyes and gaze: along a gaze input source, or forward from the head. False: not tracked. */
  private look(frame: XRFrame, space: XRReferenceSpace, sources: XRInputSourceArray): boolean {
    const viewer = frame.getViewerPose(space);
    if (!viewer) return false;
    const { position, orientation } = viewer.transform;
    this.eyes.set(position.x, position.y, position.z);
    this.turn.set(orientation.x, orientation.y, orientation.z, orientation.w);
    const gazing = Array.from(sources).find(({ targetRayMode }) => targetRayMode === "gaze");
    const ray = (gazing && frame.getPose(gazing.targetRaySpace, space)?.transform.orientation) ?? orientation;
    this.gaze.copy(FORWARD).applyQuaternion(new Quaternion(ray.x, ray.y, ray.z, ray.w));
    return true;
  }
}
