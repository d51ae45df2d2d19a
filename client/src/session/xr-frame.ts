import { Quaternion, Vector3 } from "three";
import type { TrackedHands } from "../body/bare-hands";
import type { Connection } from "./connection";
import type { Panel } from "../panel/panel";
import { Pointers } from "../input/pointers";
import { BACKLOG_LIMIT_BYTES, Numbering, Reader, Throttle, type Poses } from "../tracking/pose-reader";

/** Handles XR frames: sends poses, places the panel, updates the pointers. */
export class XRFrameHandler {
  readonly numbering = new Numbering();
  readonly pointers = new Pointers();
  /** The number of frames so far. */
  frames = 0;
  /** Whether poses are sent only by `track` and not with each frame. */
  trackedElsewhere = false;
  /** Whether the participant does not see the scene; then no poses are sent. */
  blocked = false;
  private readonly reader = new Reader();
  private readonly throttle = new Throttle();
  private readonly head = new Vector3();
  private readonly forward = new Vector3();
  private readonly turn = new Quaternion();

  constructor(
    private readonly panel: Panel,
    private readonly connection: Connection,
    private readonly surfacePoints: (eyes: Vector3) => Float32Array,
  ) {}

  /** Reads the poses of a frame and sends them. */
  read(frame: XRFrame, space: XRReferenceSpace, timeMs: number): Poses {
    const poses = this.reader.read(frame, space);
    if (!this.trackedElsewhere) this.track(poses, timeMs);
    return poses;
  }

  frame(frame: XRFrame, space: XRReferenceSpace): void {
    this.frames++;
    if (this.panel.visible) this.placePanel(frame.getViewerPose(space));
    if (this.panel.buttons.length > 0) this.panel.hover(this.pointers.point(frame, space, this.panel));
    else this.pointers.hide();
  }

  /** The joints of bare hands in the last frame. */
  get bareHands(): TrackedHands {
    return this.reader.bareHands;
  }

  /** The value of the button at which a source points, or null. */
  pointedAt(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace): number | null {
    return this.panel.buttons.length > 0 ? this.pointers.pointedAt(source, frame, space, this.panel) : null;
  }

  /** Sends poses, unless there is a backlog or the participant does not see the scene. */
  track(poses: Poses, timeMs: number): void {
    if (this.blocked || !this.connection.connected || this.connection.backlog > BACKLOG_LIMIT_BYTES) return;
    if (this.throttle.pass(timeMs)) this.connection.send(this.numbering.next(poses, timeMs, performance.now()));
  }

  private placePanel(viewer: XRViewerPose | undefined): void {
    if (!viewer) return;
    const { position, orientation } = viewer.transform;
    this.head.set(position.x, position.y, position.z);
    this.turn.set(orientation.x, orientation.y, orientation.z, orientation.w);
    this.panel.place(this.head, this.forward.set(0, 0, -1).applyQuaternion(this.turn), this.surfacePoints);
  }
}
