import { JOINTS, type TrackedHands, type HandJoints } from "../body/bare-hands";
import type { Modality, TrackingFrameMessage, XRPose } from "../generated/messages";

export const HIGHEST_RATE_HZ = 90;
/** Maximum backlog of bytes. Above it frames are skipped, so that the newest is never delayed by old ones. */
export const BACKLOG_LIMIT_BYTES = 2048;

const INTERVAL_MS = 1000 / HIGHEST_RATE_HZ;
/** Jitter of frames that is tolerated, so that no frame at 90 Hz is dropped. */
const JITTER_MS = 2;

/** Limits the rate to `HIGHEST_RATE_HZ`. */
export class Throttle {
  private dueMs = -Infinity;

  pass(nowMs: number): boolean {
    if (nowMs < this.dueMs - JITTER_MS) return false;
    this.dueMs = Math.max(this.dueMs, nowMs - INTERVAL_MS) + INTERVAL_MS;
    return true;
  }
}

/** The poses of head and hands, and the modalities of the hands. */
export type Poses = Omit<TrackingFrameMessage, "type" | "sequence" | "client_time_ms">;

const UNTRACKED: Poses = { head: null, left: null, right: null, left_modality: "none", right_modality: "none" };

/** Reads the poses of headset and controllers; reuses its objects in every frame. */
export class Reader {
  private readonly head = emptyPose();
  private readonly left = emptyPose();
  private readonly right = emptyPose();
  private readonly poses: Poses = { ...UNTRACKED };
  private readonly leftJoints = noJoints();
  private readonly rightJoints = noJoints();
  /** The joints of bare hands in the last frame. */
  readonly bareHands: TrackedHands = { left: null, right: null };

  read(frame: XRFrame, space: XRReferenceSpace): Poses {
    const { poses } = this;
    const sources = frame.session.inputSources;
    const left = findSource(sources, "left");
    const right = findSource(sources, "right");
    poses.head = fill(this.head, frame.getViewerPose(space));
    poses.left = left && fill(this.left, sourcePose(frame, space, left));
    poses.right = right && fill(this.right, sourcePose(frame, space, right));
    poses.left_modality = modality(left);
    poses.right_modality = modality(right);
    this.bareHands.left = fillJoints(this.leftJoints, frame, space, poses.left && left);
    this.bareHands.right = fillJoints(this.rightJoints, frame, space, poses.right && right);
    return poses;
  }
}

export interface FrameTimes {
  readMs: number;
  sentMs: number;
}

const HISTORY = 1024;

/** Numbers the frames that are sent, and stores their times; reuses one message. */
export class Numbering {
  private readonly message: TrackingFrameMessage = { type: "tracking", sequence: -1, client_time_ms: 0, ...UNTRACKED };
  private readonly readMs = new Float64Array(HISTORY);
  private readonly sentMs = new Float64Array(HISTORY);

  /** The number of frames so far, which is the next sequence number. */
  get count(): number {
    return this.message.sequence + 1;
  }

  /** The message of a frame that was read at `timeMs` and is sent at `sentMs`. */
  next(poses: Poses, timeMs: number, sentMs = timeMs): TrackingFrameMessage {
    const { message } = this;
    Object.assign(message, poses);
    message.sequence++;
    message.client_time_ms = timeMs;
    this.readMs[message.sequence % HISTORY] = timeMs;
    this.sentMs[message.sequence % HISTORY] = sentMs;
    return message;
  }

  /** The times of a recent frame; null for older ones. */
  timesOf(sequence: number): FrameTimes | null {
    const newest = this.message.sequence;
    if (sequence < 0 || sequence > newest || sequence <= newest - HISTORY) return null;
    const at = sequence % HISTORY;
    return { readMs: this.readMs[at]!, sentMs: this.sentMs[at]! };
  }

  /** The age of the poses of a recent frame; 0 for older ones. */
  ageMs(sequence: number, nowMs: number): number {
    return nowMs - (this.timesOf(sequence)?.readMs ?? nowMs);
  }
}

/** The source of a hand: a controller, else the bare hand, else a transient pointer (during a pinch). */
export function findSource(sources: XRInputSourceArray, handedness: XRHandedness): XRInputSource | null {
  let found: XRInputSource | null = null;
  for (let i = 0; i < sources.length; i++) {
    const source = sources[i]!;
    if (source.handedness !== handedness || !(source.gripSpace || source.hand)) continue;
    if (!source.hand && source.targetRayMode !== "transient-pointer") return source;
    if (source.hand || !found) found = source;
  }
  return found;
}

function sourcePose(frame: XRFrame, space: XRReferenceSpace, source: XRInputSource): XRPoseOfFrame {
  if (!source.hand) return frame.getPose(source.gripSpace!, space);
  const wrist = source.hand.get("wrist");
  return wrist && frame.getJointPose?.(wrist, space);
}

function noJoints(): HandJoints {
  return { matrices: new Float32Array(16 * JOINTS), radii: new Float32Array(JOINTS) };
}

/** Methods of WebXR Hand InputProfileMessage that the type definitions lack. */
interface FrameOfJoints extends XRFrame {
  fillPoses?(spaces: XRJointSpace[], base: XRReferenceSpace, matrices: Float32Array): boolean;
  fillJointRadii?(spaces: XRJointSpace[], radii: Float32Array): boolean;
}

const jointsOf = new WeakMap<XRHand, XRJointSpace[]>();

/** The joints of a bare hand; null unless all are tracked. */
function fillJoints(
  joints: HandJoints,
  frame: FrameOfJoints,
  space: XRReferenceSpace,
  source: XRInputSource | null,
): HandJoints | null {
  if (!source?.hand || !frame.fillPoses || !frame.fillJointRadii) return null;
  const spaces = jointsOf.get(source.hand) ?? [...source.hand.values()];
  jointsOf.set(source.hand, spaces);
  const filled = frame.fillPoses(spaces, space, joints.matrices) && frame.fillJointRadii(spaces, joints.radii);
  return filled ? joints : null;
}

function modality(source: XRInputSource | null): Modality {
  if (!source) return "none";
  return source.hand ? "hand" : "controller";
}

type XRPoseOfFrame = { transform: XRRigidTransform; emulatedPosition: boolean } | null | undefined;

type Place = { x: number; y: number; z: number };

/** A pose as plain numbers. */
export function poseOf({ x, y, z }: Place, turn: Place & { w: number }): XRPose {
  return [
    [x, y, z],
    [turn.x, turn.y, turn.z, turn.w],
  ];
}

/** Copies a pose; null if its position is emulated, i.e. not tracked. */
function fill(pose: XRPose, seen: XRPoseOfFrame): XRPose | null {
  if (!seen || seen.emulatedPosition) return null;
  const { position, orientation } = seen.transform;
  pose[0][0] = position.x;
  pose[0][1] = position.y;
  pose[0][2] = position.z;
  pose[1][0] = orientation.x;
  pose[1][1] = orientation.y;
  pose[1][2] = orientation.z;
  pose[1][3] = orientation.w;
  return pose;
}

function emptyPose(): XRPose {
  return [
    [0, 0, 0],
    [0, 0, 0, 1],
  ];
}
