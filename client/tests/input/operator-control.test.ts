import { describe, expect, it } from "vitest";
import { drivingText, gamepadCommand, keyboardCommand } from "../../src/input/operator-control";
import type { SessionStatus } from "../../src/generated/messages";

const still = [0, 0, 0];

function pad(axes: number[], held: Record<number, number>): Pick<Gamepad, "axes" | "buttons"> {
  const buttons = Array.from({ length: 17 }, (_, i) => {
    const value = held[i] ?? 0;
    return { value, pressed: value > 0.5, touched: value > 0 };
  });
  return { axes, buttons };
}

describe("the operator's keys", () => {
  it("move nothing without the dead-man's key", () => {
    expect(keyboardCommand(new Set(["KeyW"])).engaged).toBe(false);
    expect(keyboardCommand(new Set(["Space"]))).toEqual({ type: "drive", engaged: true, linear: still, angular: still, source: "operator" });
  });

  it("add up, and opposite ones cancel out", () => {
    const wish = keyboardCommand(new Set(["Space", "KeyW", "KeyA", "KeyE", "KeyQ", "ArrowRight", "KeyP"]));
    expect(wish).toEqual({ type: "drive", engaged: true, linear: [1, 1, 0], angular: [0, 0, -1], source: "operator" });
  });
});

describe("the operator's gamepad", () => {
  it("moves nothing without a shoulder button", () => {
    expect(gamepadCommand(pad([0, -1, 0, 0], {})).engaged).toBe(false);
    expect(gamepadCommand(pad([0, -1, 0, 0], { 5: 1 }))).toMatchObject({ engaged: true, linear: [1, 0, 0] });
  });

  it("ignores sticks that barely rest off centre, and reaches the end of each axis", () => {
    expect(gamepadCommand(pad([0.1, -0.1, 0.1, 0.1], { 4: 1 }))).toMatchObject({ linear: [0, 0, 0], angular: [0, 0, 0] });
    const { linear, angular } = gamepadCommand(pad([1, 1, -1, -1], { 4: 1, 7: 1, 12: 1 }));
    expect([linear, angular]).toEqual([[-1, -1, 1], [1, -1, 1]]);
  });
});

describe("the words beside the keys", () => {
  const words = (phase: SessionStatus["phase"], idle: boolean) => drivingText({ phase, idle } as SessionStatus);

  it("say who moves the robot, in a trial and where an environment is viewed", () => {
    for (const phase of ["trial", "viewing"] as const) {
      expect(words(phase, false)).toBe("You drive the robot.");
      expect(words(phase, true)).toBe("The robot holds still.");
    }
    expect(words("countdown", true)).toContain("until it begins");
  });
});
