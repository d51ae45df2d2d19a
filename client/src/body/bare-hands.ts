import {
  CylinderGeometry,
  Group,
  InstancedMesh,
  Matrix4,
  MeshStandardMaterial,
  Quaternion,
  SphereGeometry,
  SRGBColorSpace,
  Vector3,
} from "three";
import type { Pose, Side } from "./body-solver";
import type { ParticipantBody } from "../generated/messages";

/** Joints of a bare hand in the order of WebXR Hand InputProfileMessage: matrices in `local-floor`, and radii in metres. */
export interface HandJoints {
  matrices: Float32Array;
  radii: Float32Array;
}

export type TrackedHands = Record<Side, HandJoints | null>;
export const NO_TRACKED_HANDS: TrackedHands = { left: null, right: null };

export const JOINTS = 25;
const WRIST = 0;
/** The first and the last joint of thumb and fingers. */
const FINGERS = [[1, 4], [5, 9], [10, 14], [15, 19], [20, 24]] as const;
/** The knuckles, from the thumb to the little finger. */
const KNUCKLES = [2, 6, 11, 16, 21] as const;
/** Pairs of connected joints: along each finger, and across the palm. */
const BONES: readonly (readonly [number, number])[] = [
  ...FINGERS.flatMap(([first, last]) => [
    [WRIST, first] as const,
    ...Array.from({ length: last - first }, (_, at) => [first + at, first + at + 1] as const),
  ]),
  ...KNUCKLES.slice(1).map((knuckle, at) => [KNUCKLES[at]!, knuckle] as const),
];

/** Draws the participant's tracked bare hands instead of the body's hands. */
export class BareHands {
  readonly group = new Group();
  private readonly material = new MeshStandardMaterial({ roughness: 0.7 });
  private readonly hands: Record<Side, { joints: InstancedMesh; bones: InstancedMesh }> = {
    left: this.hand(),
    right: this.hand(),
  };

  /** Sets the colour to that of the skin. */
  colour({ skin_tone, skin_tones, skin_tones_rgb }: ParticipantBody): void {
    this.material.color.setRGB(...skin_tones_rgb[skin_tones.indexOf(skin_tone)]!, SRGBColorSpace);
  }

  hide(side: Side): void {
    this.hands[side].joints.visible = this.hands[side].bones.visible = false;
  }

  /** Draws a hand: moves its joints with its centre from the tracked to the drawn pose. `floor`: that of `local-floor`. */
  draw(side: Side, { matrices, radii }: HandJoints, floor: Matrix4, tracked: Pose, drawn: Pose): void {
    const { joints, bones } = this.hands[side];
    carry.copy(matrixOf(drawn, drawnMatrix)).multiply(matrixOf(tracked, trackedMatrix).invert());
    carry.multiply(inverse.copy(floor).invert());
    for (let joint = 0; joint < JOINTS; joint++) {
      const at = places[joint]!.fromArray(matrices, 16 * joint + 12).applyMatrix4(carry);
      joints.setMatrixAt(joint, matrix.compose(at, straight, scale.setScalar(radii[joint]!)));
    }
    BONES.forEach(([from, to], index) => bones.setMatrixAt(index, between(from, to, radii)));
    joints.instanceMatrix.needsUpdate = bones.instanceMatrix.needsUpdate = true;
    joints.visible = bones.visible = true;
  }

  private hand(): { joints: InstancedMesh; bones: InstancedMesh } {
    const joints = new InstancedMesh(new SphereGeometry(1, 12, 8), this.material, JOINTS);
    const bones = new InstancedMesh(new CylinderGeometry(1, 1, 1, 12, 1, true), this.material, BONES.length);
    for (const mesh of [joints, bones]) {
      mesh.frustumCulled = mesh.visible = false;
      mesh.castShadow = mesh.receiveShadow = true;
      this.group.add(mesh);
    }
    return { joints, bones };
  }
}

const UP = new Vector3(0, 1, 0);
const straight = new Quaternion();
const turn = new Quaternion();
const scale = new Vector3();
const along = new Vector3();
const middle = new Vector3();
const matrix = new Matrix4();
const carry = new Matrix4();
const inverse = new Matrix4();
const drawnMatrix = new Matrix4();
const trackedMatrix = new Matrix4();
const places = Array.from({ length: JOINTS }, () => new Vector3());

/** The matrix of a cylinder between two joints, with the smaller of their radii. */
function between(from: number, to: number, radii: Float32Array): Matrix4 {
  along.copy(places[to]!).sub(places[from]!);
  const length = along.length();
  const radius = Math.min(radii[from]!, radii[to]!);
  middle.copy(places[from]!).add(places[to]!).multiplyScalar(0.5);
  if (length > 0) turn.setFromUnitVectors(UP, along.divideScalar(length));
  return matrix.compose(middle, turn, scale.set(radius, length, radius));
}

function matrixOf({ position, q: [w, x, y, z] }: Pose, into: Matrix4): Matrix4 {
  return into.compose(middle.fromArray(position), turn.set(x, y, z, w), scale.setScalar(1));
}
