import { Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { isPalmRaised } from "../../src/input/palm-gesture";
import { handJoints, placed, raisedHand } from "../helpers/hand-joints";

const EYES = new Vector3(0.3, 1.2, -0.4);
const SIDES = ["left", "right"] as const;
const DEGREE = Math.PI / 180;
const about = (x: number, y: number, z: number, degrees: number) =>
  new Quaternion().setFromAxisAngle(new Vector3(x, y, z), degrees * DEGREE);

describe.each(SIDES)("an open palm of the %s hand", (side) => {
  const other = side === "left" ? "right" : "left";
  const says = (turn?: Quaternion, bent?: number) => isPalmRaised(side, raisedHand(side, EYES, turn, bent).matrices, EYES);

  it("says stop when it is raised away from the face", () => {
    expect(says()).toBe(true);
  });

  it("may lean to every side a little", () => {
    for (const degrees of [-30, 30])
      for (const turn of [about(1, 0, 0, degrees), about(0, 1, 0, degrees / 3), about(0, 0, 1, degrees)])
        expect(says(turn), `${degrees}`).toBe(true);
    expect(says(undefined, 0.25)).toBe(true);
  });

  it("does not say stop with the back of the hand, nor when the fingers point ahead, aside or down", () => {
    for (const turn of [about(0, 1, 0, 180), about(1, 0, 0, -90), about(0, 0, 1, 90), about(0, 0, 1, -90), about(0, 0, 1, 180)])
      expect(says(turn)).toBe(false);
  });

  it("does not say stop with a fist or a hand that is half closed", () => {
    for (const bent of [0.7, 1, 1.5]) expect(says(undefined, bent)).toBe(false);
  });

  it("does not say stop in the lap or at the face", () => {
    const joints = handJoints(side);
    for (const where of [new Vector3(0.1, -0.6, -0.3), new Vector3(0.02, -0.1, -0.1)])
      expect(isPalmRaised(side, placed(joints, where.add(EYES), new Quaternion()).matrices, EYES)).toBe(false);
  });

  it("says it in whatever direction the participant sits", () => {
    for (let degrees = 0; degrees < 360; degrees += 15) {
      const turn = about(0, 1, 0, degrees);
      const wrist = new Vector3(side === "right" ? 0.18 : -0.18, -0.25, -0.35).applyQuaternion(turn).add(EYES);
      expect(isPalmRaised(side, placed(handJoints(side), wrist, turn).matrices, EYES)).toBe(true);
    }
  });

  it("is not that of the other hand", () => {
    expect(isPalmRaised(other, raisedHand(side, EYES).matrices, EYES)).toBe(false);
  });
});
