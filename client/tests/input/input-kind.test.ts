import { describe, expect, it } from "vitest";
import { INPUTS, inputKind, inputKindOf, type InputKind } from "../../src/input/input-kind";
import PROFILES from "../data/profiles.json";

function source(profiles: string[], buttons = 0, targetRayMode: XRTargetRayMode = "tracked-pointer", hand = false): XRInputSource {
  const gamepad = buttons > 0 ? { buttons: Array(buttons) } : undefined;
  return { profiles, gamepad, targetRayMode, hand: hand ? new Map() : undefined } as unknown as XRInputSource;
}

/** By the last name of a profile, which is the most general one. */
function expected(profiles: string[]): InputKind {
  if (profiles.includes("generic-hand-select")) return "pinch";
  const general = profiles.at(-1)!;
  if (general === "generic-touchscreen") return "tap";
  return general.startsWith("generic-trigger") ? "trigger" : (general.replace("generic-", "") as InputKind);
}

describe("what a participant selects with", () => {
  it.each(PROFILES)("is what the profile $profiles has", ({ profiles, buttons }) => {
    expect(inputKind(source(profiles, buttons))).toBe(expected(profiles));
    expect(INPUTS).toContain(expected(profiles));
  });

  it("is a pinch with a hand, whatever else its profile names, and with a pinch alone", () => {
    expect(inputKind(source(["generic-trigger"], 1, "tracked-pointer", true))).toBe("pinch");
    expect(inputKind(source([], 0, "transient-pointer"))).toBe("pinch");
  });

  it("is a tap on a screen and the button of a viewer without controllers", () => {
    expect(inputKind(source([], 0, "screen"))).toBe("tap");
    expect(inputKind(source([], 0, "gaze"))).toBe("gaze");
    expect(inputKind(source([]))).toBe("button");
  });

  it("is a controller's trigger next to a bare hand, and unknown without any input", () => {
    const hand = source(["generic-hand-select"], 1, "tracked-pointer", true);
    expect(inputKindOf([hand, source(["generic-trigger-squeeze"], 2)])).toBe("trigger");
    expect(inputKindOf([])).toBeNull();
  });
});
