import { Matrix4, Quaternion, Vector3 } from "three";
import { P_SPACE, type XRDevice } from "iwer";

type Hand = "left" | "right";

const UP = new Vector3(0, 1, 0);
/** The position of a raised hand's wrist relative to the eyes, metres. */
const RAISED = { aside: 0.15, below: 0.24, ahead: 0.4 };

/** Raises an open hand before the face, fingers up, palm away from the eyes. */
export function raisePalm(device: XRDevice, hand: Hand): void {
  const { position, quaternion } = device.hands[hand]!;
  const head = new Quaternion(device.quaternion.x, device.quaternion.y, device.quaternion.z, device.quaternion.w);
  const ahead = new Vector3(0, 0, -1).applyQuaternion(head).setY(0).normalize();
  const aside = ahead.clone().cross(UP).multiplyScalar(hand === "right" ? RAISED.aside : -RAISED.aside);
  const wrist = new Vector3(device.position.x, device.position.y - RAISED.below, device.position.z)
    .addScaledVector(ahead, RAISED.ahead)
    .add(aside);
  const own = basis(along(device, hand, "middle-finger-phalanx-proximal", "middle-finger-tip"), palmOf(device, hand));
  const turn = new Quaternion().setFromRotationMatrix(basis(UP, ahead).multiply(own.transpose()));
  wrist.sub(joint(device, hand, "wrist").applyQuaternion(turn));
  position.set(wrist.x, wrist.y, wrist.z);
  quaternion.set(turn.x, turn.y, turn.z, turn.w);
}

/** The normal of the palm, outwards. */
function palmOf(device: XRDevice, hand: Hand): Vector3 {
  const thumbwards = along(device, hand, "pinky-finger-phalanx-proximal", "index-finger-phalanx-proximal");
  const fingers = along(device, hand, "wrist", "middle-finger-phalanx-proximal");
  return hand === "left" ? thumbwards.cross(fingers).negate() : thumbwards.cross(fingers);
}

function along(device: XRDevice, hand: Hand, from: string, to: string): Vector3 {
  return joint(device, hand, to).sub(joint(device, hand, from));
}

/** The position of a joint in the hand's frame. */
function joint(device: XRDevice, hand: Hand, name: string): Vector3 {
  const space = device.hands[hand]!.inputSource.hand!.get(name as never)!;
  return new Vector3().setFromMatrixPosition(new Matrix4().fromArray(Array.from(space[P_SPACE].offsetMatrix)));
}

/** A matrix whose x axis is `first` and whose z axis is perpendicular to both. */
function basis(first: Vector3, second: Vector3): Matrix4 {
  const x = first.clone().normalize();
  const z = x.clone().cross(second).normalize();
  return new Matrix4().makeBasis(x, z.clone().cross(x), z);
}
