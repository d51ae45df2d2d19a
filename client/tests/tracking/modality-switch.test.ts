import { Quaternion } from "three";
import { describe, expect, it } from "vitest";
import type { Side } from "../../src/body/body-solver";
import type { Modality, XRPose } from "../../src/generated/messages";
import { Hands, HandFollower } from "../../src/tracking/modality-switch";
import type { Poses } from "../../src/tracking/pose-reader";
import examples from "../data/switches.json";

/** As Python follows them; see `tests/helpers/vr/device_switch_examples.py`. */
interface Example {
  side: Side;
  frames: { ms: number; pose: XRPose; modality: Modality; grip: XRPose }[];
}

function apart([at, turn]: XRPose, [otherAt, otherTurn]: XRPose): { m: number; rad: number } {
  const m = Math.hypot(...at.map((x, axis) => x - otherAt[axis]!));
  return { m, rad: new Quaternion(...turn).angleTo(new Quaternion(...otherTurn)) };
}

describe("a hand whose device changes", () => {
  it("is followed as the server follows it", () => {
    let [most, rad] = [0, 0];
    for (const { side, frames } of examples as unknown as Example[]) {
      const hand = new HandFollower(side);
      for (const { ms, pose, modality, grip } of frames) {
        const found = apart(hand.grip(pose, modality, ms), grip);
        [most, rad] = [Math.max(most, found.m), Math.max(rad, found.rad)];
      }
    }
    console.log(`${examples.length} hands, at most ${most} m and ${rad} rad apart`);
    expect(most).toBeLessThan(1e-6);
    expect(rad).toBeLessThan(1e-6);
  });

  it("stays where it is while it rests, and comes back to its first device", () => {
    const wrist: XRPose = [[0.23, 0.93, -0.22], [0.5, 0.5, 0.5, 0.5]]; // prettier-ignore
    const seen = (right: XRPose | null, right_modality: Modality): Poses => {
      return { head: wrist, left: null, right, left_modality: "none", right_modality };
    };
    const [[x, y, z], turn] = new Hands().follow(seen(wrist, "hand"), 0).right!;
    const grip: XRPose = [[x + 0.06, y - 0.03, z], turn]; // prettier-ignore
    const hands = new Hands();
    expect(apart(hands.follow(seen(grip, "controller"), 0).right!, grip).m).toBeLessThan(1e-9);
    expect(hands.follow(seen(null, "none"), 100).right).toBeNull();
    const bare = hands.follow(seen(wrist, "hand"), 600);
    expect(bare.right_modality).toBe("controller");
    expect(apart(bare.right!, grip).m).toBeLessThan(1e-9);
    expect(apart(hands.follow(seen(grip, "controller"), 700).right!, grip).m).toBeLessThan(1e-9);
  });
});
