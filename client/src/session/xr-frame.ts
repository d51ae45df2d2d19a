import { Quaternion, Vector3 } from "three";
import type { TrackedHands } from "../body/bare-hands";
import type { Connection } from "./connection";
import type { Panel } from "../panel/panel";
import type { CommandIcons } from "../input/command-icons";
import { kindOfProfile, points, pointsWith } from "../input/input-profile";
import { Pointers } from "../input/pointers";
import type { Selection } from "../input/selection";
import type { World } from "../scene/world";
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
    private readonly selection: Selection,
    private readonly connection: Connection,
    private readonly world: Pick<World, "surfacePoints" | "reclineRad" | "robot">,
    private readonly icons: CommandIcons,
  ) {}

  /** Reads the poses of a frame and sends them. */
  read(frame: XRFrame, space: XRReferenceSpace, timeMs: number): Poses {
    const poses = this.reader.read(frame, space);
    if (!this.trackedElsewhere) this.track(poses, timeMs);
    return poses;
  }

  frame(frame: XRFrame, space: XRReferenceSpace): void {
    this.frames++;
    const { panel, selection, icons, world } = this;
    const viewer = frame.getViewerPose(space);
    const { presentation } = selection.profile;
    icons.place(viewer, world.robot, (eyes) => world.surfacePoints(eyes), presentation, world.reclineRad);
    icons.highlight(selection.highlighted, selection.progress);
    if (panel.visible) this.placePanel(viewer);
    if (panel.buttons.length > 0) this.point(frame, space);
    else {
      this.pointers.hide();
      if (kindOfProfile(selection.profile) === "dwell") selection.look(icons.look(viewer), performance.now());
    }
    panel.hover(selection.highlighted, selection.progress, performance.now());
  }

  /** Feeds rays or the head's direction to the selection. */
  private point(frame: XRFrame, space: XRReferenceSpace): void {
    const { panel, pointers, selection } = this;
    const { profile } = selection;
    if (kindOfProfile(profile) === "dwell")
      selection.look(pointers.look(frame.getViewerPose(space), panel), performance.now());
    else if (points(profile)) selection.point(pointers.point(frame, space, panel, (source) => pointsWith(profile, source)));
    else pointers.hide();
  }

  /** The joints of bare hands in the last frame. */
  get bareHands(): TrackedHands {
    return this.reader.bareHands;
  }

  /** The button at which a source points. Null: the participant does not point with this source. */
  pointedAt(source: XRInputSource, frame: XRFrame, space: XRReferenceSpace): ReturnType<Pointers["pointedAt"]> | null {
    if (!pointsWith(this.selection.profile, source)) return null;
    if (this.panel.buttons.length === 0) return { value: null, rests: false };
    return this.pointers.pointedAt(source, frame, space, this.panel);
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
    const { world } = this;
    const forward = this.forward.set(0, 0, -1).applyQuaternion(this.turn);
    this.panel.place(this.head, forward, (eyes) => world.surfacePoints(eyes), world.reclineRad);
  }
}
