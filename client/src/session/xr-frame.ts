import { Quaternion, Vector3 } from "three";
import type { TrackedHands } from "../body/bare-hands";
import type { Connection } from "./connection";
import type { Panel } from "../panel/panel";
import { Pointers } from "../input/pointers";
import { BACKLOG_LIMIT_BYTES, Numbering, Reader, Throttle, type Poses } from "../tracking/pose-reader";

/** What happens in every frame of VR: poses go out, the panel is placed, input sources point at it. */
export class XRFrameHandler {
  readonly numbering = new Numbering();
  readonly pointers = new Pointers();
  /** How many frames have been drawn. */
  frames = 0;
  /** Whether poses come from `track` alone, and not with the frames. */
  trackedElsewhere = false;
  /** The participant does not see the scene: poses that come meanwhile are not theirs. */
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

  /** Reads the frame's poses and sends them. */
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

  /** The fingers of bare hands in the latest frame. */
  get bareHands(): TrackedHands {
    return this.reader.bareHands;
  }

  /** The value of the button that an input points at, or null. */
  pointedAt(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace): number | null {
    return this.panel.buttons.length > 0 ? this.pointers.pointedAt(source, frame, space, this.panel) : null;
  }

  /** Sends poses, unless earlier ones still wait or the participant does not see the scene. */
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
