import { Euler, Quaternion, Vector3, type EulerOrder } from "three";
import { PERSON } from "../generated/body-model";
import type { JointAngles, Side } from "./body-solver";
import { POSE } from "../scene/state-interpolation";
import type { TrackedBodyPart, Skeleton } from "../generated/messages";

/** A body of a chain: the offset of its pose, its joints, and its position in the frame of its parent. */
interface Link {
  at: number;
  joints: { x?: number; y?: number; z?: number };
  order: EulerOrder;
  offset: Vector3;
}

/** Connected bodies. `simulatedShare`: 0 to draw them as tracked, 1 as simulated. */
export interface Chain {
  part: TrackedBodyPart;
  links: [Link, ...Link[]];
  simulatedShare: number;
}

/** A pose in the world frame. */
export interface Place {
  origin: Vector3;
  turn: Quaternion;
}

/** The trunk with the head, whose parent is the hips, and the arms, whose parent is the torso. */
export function chainsOf(skeleton: Skeleton, bodies: readonly string[]): [trunk: Chain, ...arms: Chain[]] {
  const at = (body: string) => POSE * bodies.indexOf(PERSON.prefix + body);
  const { waist, neck, right_shoulder: right, upper_arm_m: upper, forearm_m: fore } = skeleton;
  const [wx, wy, wz] = PERSON.joints.waist;
  const [hx, hy, hz] = PERSON.joints.head;
  const arm = (side: Side, shoulder: Vector3): Chain => {
    const [sy, sx, sz, ex, fz, handX, handY] = PERSON.joints[side];
    return chain(side, [
      { at: at(`${side}_upper_arm`), joints: { x: sx, y: sy, z: sz }, order: "YXZ", offset: shoulder },
      { at: at(`${side}_forearm`), joints: { x: ex, z: fz }, order: "XYZ", offset: new Vector3(0, 0, -upper) },
      { at: at(`${side}_hand`), joints: { x: handX, y: handY }, order: "XYZ", offset: new Vector3(0, 0, -fore) },
    ]);
  };
  const trunk = chain("head", [
    { at: at("torso"), joints: { x: wx, y: wy, z: wz }, order: "XYZ", offset: new Vector3(...waist) },
    { at: at("head"), joints: { x: hx, y: hy, z: hz }, order: "XYZ", offset: new Vector3(...neck) },
  ]);
  return [trunk, arm("left", new Vector3(-right[0], right[1], right[2])), arm("right", new Vector3(...right))];
}

function chain(part: TrackedBodyPart, links: Chain["links"]): Chain {
  return { part, links, simulatedShare: 1 };
}

/**
 * Blends the poses of a chain with these joint angles into the simulated `poses`, by its `simulatedShare`.
 *
 * `root`: the pose of its parent. Returns the tracked pose of its first body.
 */
export function drawChain({ links, simulatedShare }: Chain, poses: Float32Array, angles: JointAngles, root: Place): Place {
  const share = simulatedShare * simulatedShare * (3 - 2 * simulatedShare);
  const [first, ...others] = links;
  const tracked = next(root, first, turnOf(first, angles));
  const drawn: Place = {
    origin: tracked.origin.clone().lerp(positionIn(poses, first.at), share),
    turn: tracked.turn.clone().slerp(turnIn(poses, first.at), share),
  };
  write(poses, first.at, drawn);
  let turn = tracked.turn;
  for (const link of others) {
    turn = turn.clone().multiply(turnOf(link, angles));
    drawn.origin.add(position.copy(link.offset).applyQuaternion(drawn.turn));
    drawn.turn.copy(turn).slerp(turnIn(poses, link.at), share);
    write(poses, link.at, drawn);
  }
  return tracked;
}

function next({ origin, turn }: Place, { offset }: Link, own: Quaternion): Place {
  return { origin: offset.clone().applyQuaternion(turn).add(origin), turn: turn.clone().multiply(own) };
}

const euler = new Euler();
const position = new Vector3();
const quaternion = new Quaternion();
const ownTurn = new Quaternion();

function turnOf({ joints: { x, y, z }, order }: Link, angles: JointAngles): Quaternion {
  const angle = (joint: number | undefined) => (joint === undefined ? 0 : angles[joint]!);
  return ownTurn.setFromEuler(euler.set(angle(x), angle(y), angle(z), order));
}

function positionIn(poses: Float32Array, at: number): Vector3 {
  return position.set(poses[at]!, poses[at + 1]!, poses[at + 2]!);
}

function turnIn(poses: Float32Array, at: number): Quaternion {
  return quaternion.set(poses[at + 4]!, poses[at + 5]!, poses[at + 6]!, poses[at + 3]!);
}

function write(poses: Float32Array, at: number, { origin, turn }: Place): void {
  poses.set([origin.x, origin.y, origin.z, turn.w, turn.x, turn.y, turn.z], at);
}
