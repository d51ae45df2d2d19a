import { Quaternion, Vector3 } from "three";
import type { BareHandsTracked } from "./barehands";
import type { Connection } from "./connection";
import type { Panel } from "./panel";
import { Pointer } from "./pointer";
import { BACKLOG_LIMIT_BYTES, Numbering, Reader, Throttle, findSource, type Poses } from "./tracking";

type Hand = "left" | "right";

/** What happens in every frame of VR: poses go out, the panel is placed, the hands point at it. */
export class Immersive {
  readonly numbering = new Numbering();
  readonly pointers = { left: new Pointer(), right: new Pointer() };
  /** How many frames have been drawn. */
  frames = 0;
  /** Whether poses come from `track` alone, and not with the frames. */
  trackedElsewhere = false;
  private readonly reader = new Reader();
  private readonly throttle = new Throttle();
  private readonly head = new Vector3();
  private readonly forward = new Vector3();
  private readonly turn = new Quaternion();

  constructor(
    private readonly panel: Panel,
    private readonly connection: Connection,
    private readonly around: (eyes: Vector3) => Float32Array,
  ) {}

  /** Reads the frame's poses and sends them. */
  read(frame: XRFrame, space: XRReferenceSpace, timeMs: number): Poses {
    const poses = this.reader.read(frame, space);
    if (!this.trackedElsewhere && frame.session.visibilityState !== "hidden") this.track(poses, timeMs);
    return poses;
  }

  frame(frame: XRFrame, space: XRReferenceSpace): void {
    this.frames++;
    if (this.panel.visible) this.placePanel(frame.getViewerPose(space));
    if (this.panel.buttons.length > 0) this.point(frame, space);
    else this.stopPointing();
  }

  /** The fingers of bare hands in the latest frame. */
  get bareHands(): BareHandsTracked {
    return this.reader.bareHands;
  }

  stopPointing(): void {
    this.pointers.left.hide();
    this.pointers.right.hide();
  }

  /** The value of the button that an input points at, or null. */
  pointedAt(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace): number | null {
    const pose = frame.getPose(source.targetRaySpace, space);
    if (!pose || source.handedness === "none") return null;
    return this.pointers[source.handedness].aim(pose.transform, this.panel);
  }

  /** Sends poses, unless earlier ones still wait. */
  track(poses: Poses, timeMs: number): void {
    if (!this.connection.connected || this.connection.backlog > BACKLOG_LIMIT_BYTES) return;
    if (this.throttle.pass(timeMs)) this.connection.send(this.numbering.next(poses, timeMs, performance.now()));
  }

  private placePanel(viewer: XRViewerPose | undefined): void {
    if (!viewer) return;
    const { position, orientation } = viewer.transform;
    this.head.set(position.x, position.y, position.z);
    this.turn.set(orientation.x, orientation.y, orientation.z, orientation.w);
    this.panel.place(this.head, this.forward.set(0, 0, -1).applyQuaternion(this.turn), this.around);
  }

  private point(frame: XRFrame, space: XRReferenceSpace): void {
    const left = this.pointWith("left", frame, space);
    const right = this.pointWith("right", frame, space);
    this.panel.hover(right ?? left);
  }

  private pointWith(hand: Hand, frame: XRFrame, space: XRReferenceSpace): number | null {
    const source = findSource(frame.session.inputSources, hand);
    if (source) return this.pointedAt(source, frame, space);
    this.pointers[hand].hide();
    return null;
  }
}
