import { JOINTS, type TrackedHands, type HandJoints } from "../body/bare-hands";
import type { Modality, Tracking, XRPose } from "../generated/messages";

export const HIGHEST_RATE_HZ = 90;
/** Above this many waiting bytes a frame is skipped, so that the newest one never queues behind old ones. */
export const BACKLOG_LIMIT_BYTES = 2048;

const INTERVAL_MS = 1000 / HIGHEST_RATE_HZ;
/** Frames of a 90 Hz headset come a little early or late; none of them should be lost. */
const JITTER_MS = 2;

/** Lets at most `HIGHEST_RATE_HZ` frames per second through. */
export class Throttle {
  private dueMs = -Infinity;

  pass(nowMs: number): boolean {
    if (nowMs < this.dueMs - JITTER_MS) return false;
    this.dueMs = Math.max(this.dueMs, nowMs - INTERVAL_MS) + INTERVAL_MS;
    return true;
  }
}

/** Where head and hands are, and what the hands are tracked with. */
export type Poses = Omit<Tracking, "type" | "sequence" | "client_time_ms">;

const UNTRACKED: Poses = { head: null, left: null, right: null, left_modality: "none", right_modality: "none" };

/** Reads headset and controllers into poses that are filled anew for every frame. */
export class Reader {
  private readonly head = emptyPose();
  private readonly left = emptyPose();
  private readonly right = emptyPose();
  private readonly poses: Poses = { ...UNTRACKED };
  private readonly leftJoints = noJoints();
  private readonly rightJoints = noJoints();
  /** The fingers of bare hands in the frame that was read last. */
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

/** Numbers the frames that are sent, in one message that is filled anew for each, and remembers when that was. */
export class Numbering {
  private readonly message: Tracking = { type: "tracking", sequence: -1, client_time_ms: 0, ...UNTRACKED };
  private readonly readMs = new Float64Array(HISTORY);
  private readonly sentMs = new Float64Array(HISTORY);

  /** How many frames have been numbered; the next one has this sequence number. */
  get count(): number {
    return this.message.sequence + 1;
  }

  /** A message of poses that were read at a time and are sent at another. */
  next(poses: Poses, timeMs: number, sentMs = timeMs): Tracking {
    const { message } = this;
    Object.assign(message, poses);
    message.sequence++;
    message.client_time_ms = timeMs;
    this.readMs[message.sequence % HISTORY] = timeMs;
    this.sentMs[message.sequence % HISTORY] = sentMs;
    return message;
  }

  /** When one of the latest frames was read and sent; null for frames that nobody remembers. */
  timesOf(sequence: number): FrameTimes | null {
    const newest = this.message.sequence;
    if (sequence < 0 || sequence > newest || sequence <= newest - HISTORY) return null;
    const at = sequence % HISTORY;
    return { readMs: this.readMs[at]!, sentMs: this.sentMs[at]! };
  }

  /** How old the poses of one of the latest frames are; 0 for frames that nobody remembers. */
  ageMs(sequence: number, nowMs: number): number {
    return nowMs - (this.timesOf(sequence)?.readMs ?? nowMs);
  }
}

/** The controller in a hand, or else the hand itself; a transient pointer, as while fingers pinch, where there is neither. */
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

/** What WebXR Hand Input adds to frames, which the browsers' types leave out. */
interface FrameOfJoints extends XRFrame {
  fillPoses?(spaces: XRJointSpace[], base: XRReferenceSpace, matrices: Float32Array): boolean;
  fillJointRadii?(spaces: XRJointSpace[], radii: Float32Array): boolean;
}

const jointsOf = new WeakMap<XRHand, XRJointSpace[]>();

/** The joints of a bare hand, all of which must be tracked. */
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

/** A pose of plain numbers. */
export function poseOf({ x, y, z }: Place, turn: Place & { w: number }): XRPose {
  return [
    [x, y, z],
    [turn.x, turn.y, turn.z, turn.w],
  ];
}

/** A position that the headset only guesses counts as not tracked. */
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
