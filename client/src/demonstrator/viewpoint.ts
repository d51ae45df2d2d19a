import { Euler, Quaternion, Vector3, type Object3D } from "three";
import type { XRPose } from "../generated/messages";
import { poseOf } from "../tracking/pose-reader";

/** Positions of the demonstrator's head in the world frame, m; the person sits at its origin and faces −y. */
const VIEWS_W: readonly (readonly [x: number, y: number])[] = [
  [0.35, -1.35],
  [-1.2, -0.9],
  [-0.9, 0.9],
  [1.3, 0.1],
];
/** The point that all views face. */
const CHEST_W = new Vector3(0, -0.1, 0);
const SPEED_M_S = 1;
const TURN_RAD_S = 1.2;
const DEAD_ZONE = 0.2;
const UP = new Vector3(0, 1, 0);
const Z_UP = new Quaternion().setFromEuler(new Euler(-Math.PI / 2, 0, 0));

/** The demonstrator's place in the scene: the pose of the world in their own `local-floor` space. */
export class Viewpoint {
  private view = -1;

  constructor(private readonly root: Object3D) {}

  /** The pose of the world in `local-floor`. */
  get xrFromWorld(): XRPose {
    return poseOf(this.root.position, this.root.quaternion);
  }

  /** Whether a view was chosen. */
  get placed(): boolean {
    return this.view >= 0;
  }

  /** Moves the world until the head is at the next fixed view and faces the person. */
  next(head: XRPose): void {
    this.view = (this.view + 1) % VIEWS_W.length;
    const [x, y] = VIEWS_W[this.view]!;
    const eye = toYUp(new Vector3(x, y, 0));
    const wanted = yawOf(toYUp(CHEST_W.clone()).sub(eye));
    this.setYaw(yawOf(forwardOf(head)) - wanted);
    const [[headX, , headZ]] = head;
    this.root.position.set(headX, 0, headZ).sub(eye.applyAxisAngle(UP, this.yaw));
    this.root.updateMatrixWorld();
  }

  /** Moves and turns by stick deflections from −1 to 1, seen from the head. */
  move(head: XRPose, [right, back]: readonly [number, number], turn: number, seconds: number): void {
    const away = new Vector3(dead(right), 0, dead(back)).applyAxisAngle(UP, yawOf(forwardOf(head)));
    const angle = dead(turn) * TURN_RAD_S * seconds;
    const [[x, , z]] = head;
    const pivot = new Vector3(x, 0, z);
    this.root.position.sub(pivot).applyAxisAngle(UP, angle).add(pivot).addScaledVector(away, -SPEED_M_S * seconds);
    this.setYaw(this.yaw + angle);
    this.root.updateMatrixWorld();
  }

  private yaw = 0;

  private setYaw(yaw: number): void {
    this.yaw = yaw;
    this.root.quaternion.setFromAxisAngle(UP, yaw).multiply(Z_UP);
  }
}

function toYUp(inWorld: Vector3): Vector3 {
  return inWorld.applyQuaternion(Z_UP);
}

function forwardOf([, [x, y, z, w]]: XRPose): Vector3 {
  return new Vector3(0, 0, -1).applyQuaternion(new Quaternion(x, y, z, w));
}

/** The yaw about y of a direction; 0 is −z. */
function yawOf({ x, z }: Vector3): number {
  return Math.atan2(-x, -z);
}

function dead(value: number): number {
  return Math.abs(value) < DEAD_ZONE ? 0 : value;
}
