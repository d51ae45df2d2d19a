import { InstancedMesh, Matrix4, Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { BareHands, JOINTS, type HandJoints } from "../../src/body/bare-hands";
import type { Pose } from "../../src/body/body-solver";

/** Where the simulated world's root stands in the room. */
const FLOOR = new Matrix4().compose(
  new Vector3(0.3, 0.1, -0.2),
  new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), -Math.PI / 2),
  new Vector3(1, 1, 1),
);
const TRACKED: Pose = { position: [0.1, -0.4, 0.9], q: [1, 0, 0, 0] };
const MOVED: Pose = { position: [0.1, -0.37, 0.9], q: [1, 0, 0, 0] };

/** Joints along a line in the room, a centimetre apart. */
function joints(): HandJoints {
  const hand = { matrices: new Float32Array(16 * JOINTS), radii: new Float32Array(JOINTS).fill(0.008) };
  for (let joint = 0; joint < JOINTS; joint++)
    new Matrix4().makeTranslation(0.2, 0.9, -0.5 + 0.01 * joint).toArray(hand.matrices, 16 * joint);
  return hand;
}

/** Where a joint is drawn in the room. */
function drawn(hands: BareHands, joint: number): Vector3 {
  const [spheres] = hands.group.children as InstancedMesh[];
  const matrix = new Matrix4();
  spheres!.getMatrixAt(joint, matrix);
  return new Vector3().setFromMatrixPosition(matrix).applyMatrix4(FLOOR);
}

describe("bare hands", () => {
  it("are where they are tracked while nothing is in the way", () => {
    const hands = new BareHands();
    hands.draw("left", joints(), FLOOR, TRACKED, TRACKED);
    for (let joint = 0; joint < JOINTS; joint++)
      expect(drawn(hands, joint).distanceTo(new Vector3(0.2, 0.9, -0.5 + 0.01 * joint))).toBeLessThan(1e-6);
  });

  it("go along with a hand that is held back", () => {
    const hands = new BareHands();
    hands.draw("left", joints(), FLOOR, TRACKED, TRACKED);
    const free = drawn(hands, 9);
    hands.draw("left", joints(), FLOOR, TRACKED, MOVED);
    expect(drawn(hands, 9).distanceTo(free)).toBeCloseTo(0.03, 6);
  });

  it("are seen only while they are drawn", () => {
    const hands = new BareHands();
    const seen = () => hands.group.children.map(({ visible }) => visible);
    expect(seen()).toEqual([false, false, false, false]);
    hands.draw("right", joints(), FLOOR, TRACKED, TRACKED);
    expect(seen()).toEqual([false, false, true, true]);
    hands.hide("right");
    expect(seen()).toEqual([false, false, false, false]);
  });

  it("have bones as long as their joints are apart", () => {
    const hands = new BareHands();
    hands.draw("left", joints(), FLOOR, TRACKED, TRACKED);
    const bones = hands.group.children[1] as InstancedMesh;
    const matrix = new Matrix4();
    bones.getMatrixAt(1, matrix);
    const scale = new Vector3().setFromMatrixScale(matrix);
    expect(scale.x).toBeCloseTo(0.008, 5);
    expect(scale.y).toBeCloseTo(0.01, 5);
  });
});
