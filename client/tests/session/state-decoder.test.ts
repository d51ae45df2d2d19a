import { describe, expect, it } from "vitest";
import { decode } from "../../src/session/connection";
import type { WorldStateChange } from "../../src/generated/messages";
import { StateDecoder } from "../../src/session/state-decoder";
import examples from "../data/states.json";

const changes = examples.map(
  ({ bytes }) => decode(Uint8Array.from(atob(bytes), (letter) => letter.charCodeAt(0)).buffer) as WorldStateChange,
);

function check(decoder: StateDecoder): void {
  changes.forEach((change, number) => {
    const { poses, joint_targets: targets } = examples[number]!;
    const state = decoder.decode(change);
    expect(state.sequence).toBe(number);
    expect([...state.poses]).toEqual(poses);
    expect([...Float32Array.from(state.joint_targets)]).toEqual(targets);
  });
}

describe("states that come as changes", () => {
  it("are the numbers that the server told, far jumps too", () => {
    check(new StateDecoder());
  });

  it("differ from nothing after a scene", () => {
    const decoder = new StateDecoder();
    check(decoder);
    decoder.beginScene();
    check(decoder);
  });
});
