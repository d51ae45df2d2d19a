import { describe, expect, it } from "vitest";
import type { InputProfileMessage, OfferedTargets } from "../../src/generated/messages";
import { Dwell, FLICKER_MS } from "../../src/input/dwell";
import { CONTROLLERS, pointsWith, switchOfButton, switchOfHand, switchOfKey } from "../../src/input/input-profile";
import { GUARD_MS, Scanner } from "../../src/input/scanner";
import { Selection } from "../../src/input/selection";
import { stopMethodOf } from "../../src/input/stop-gestures";

const TARGETS = [7, -1, 3].map((value) => ({ value, label: `${value}` }));
const DWELL_S = 0.8;
const SCAN_S = 1.2;

function profile(changes: Partial<InputProfileMessage>): InputProfileMessage {
  return { ...CONTROLLERS, dwell_s: DWELL_S, scan_s: SCAN_S, ...changes };
}

/** A selection with targets at time 0, what it selected, and what it announced. */
function offered(method: InputProfileMessage["method"]) {
  const selected: number[] = [];
  const announced: OfferedTargets[] = [];
  const selection = new Selection((value) => selected.push(value), (offer) => announced.push(offer));
  selection.change(profile({ method }), 0);
  selection.offer(TARGETS, "first", 0);
  return { selection, selected, announced };
}

describe("a dwell", () => {
  it("selects once, after its whole time", () => {
    const dwell = new Dwell(1000);
    const times = Array.from({ length: 400 }, (_, step) => 10 * step);
    expect(times.filter((ms) => dwell.look(5, ms) === 5)).toEqual([1000]);
  });

  it("is cancelled by leaving, and restarts on return", () => {
    const dwell = new Dwell(1000);
    dwell.look(5, 0);
    dwell.look(5, 900);
    expect(dwell.progress).toBeCloseTo(0.9);
    dwell.look(null, 900 + FLICKER_MS + 1);
    expect([dwell.highlighted, dwell.progress]).toEqual([null, 0]);
    expect(dwell.look(5, 1100)).toBeNull();
    expect(dwell.look(5, 2000)).toBeNull();
    expect(dwell.look(5, 2100)).toBe(5);
  });

  it("goes on after a flicker, but selects nothing during it", () => {
    const dwell = new Dwell(1000);
    dwell.look(5, 0);
    dwell.look(5, 950);
    expect(dwell.look(null, 1010)).toBeNull();
    expect(dwell.look(5, 1020)).toBe(5);
  });

  it("of one target does not count for another", () => {
    const dwell = new Dwell(1000);
    dwell.look(5, 0);
    expect(dwell.look(6, 999)).toBeNull();
    expect(dwell.look(6, 1500)).toBeNull();
    expect(dwell.look(6, 1999)).toBe(6);
  });
});

describe("a head that rests where targets appear", () => {
  it("selects nothing until it has left the target and come back", () => {
    const { selection, selected } = offered("head");
    for (let ms = 0; ms < 60_000; ms += 100) selection.look(3, ms);
    expect([selection.highlighted, selected]).toEqual([null, []]);
    selection.look(null, 60_000);
    for (let ms = 60_100; ms < 62_000; ms += 100) selection.look(3, ms);
    expect(selected).toEqual([3]);
    selection.offer(TARGETS, "second", 62_000);
    for (let ms = 62_000; ms < 70_000; ms += 100) selection.look(3, ms);
    expect(selected).toEqual([3]);
  });

  it("keeps its ring while the same targets are offered again", () => {
    const { selection, selected } = offered("head");
    selection.look(null, 0);
    selection.look(7, 10);
    selection.look(7, 500);
    selection.offer(TARGETS, "first", 500);
    selection.look(7, 10 + 1000 * DWELL_S);
    expect(selected).toEqual([7]);
  });
});

describe("a scan", () => {
  it("highlights all targets in order, the first one for two intervals", () => {
    const scanner = new Scanner(1000);
    scanner.offer([7, -1, 3], 0);
    const seen = Array.from({ length: 8 }, (_, second) => {
      scanner.tick(1000 * second);
      return scanner.highlighted;
    });
    expect(seen).toEqual([7, 7, -1, 3, 7, -1, 3, 7]);
  });

  it("with steps moves only by steps", () => {
    const scanner = new Scanner(null);
    scanner.offer([7, -1, 3], 0);
    scanner.tick(1e9);
    const seen = [scanner.highlighted];
    for (let step = 0; step < 3; step++) {
      scanner.step();
      seen.push(scanner.highlighted);
    }
    expect(seen).toEqual([7, -1, 3, 7]);
  });

  it("ignores a press as targets appear, and a press without targets", () => {
    const scanner = new Scanner(1000);
    scanner.offer([7], 0);
    expect([scanner.select(GUARD_MS - 1), scanner.select(GUARD_MS)]).toEqual([null, 7]);
    scanner.offer([], 0);
    scanner.step();
    expect(scanner.select(5000)).toBeNull();
  });

  it("without a press never selects", () => {
    const { selection, selected } = offered("one-switch");
    for (let ms = 0; ms < 600_000; ms += 100) selection.tick(ms);
    expect(selected).toEqual([]);
  });

  it.each(["one-switch", "two-switches"] as const)("of %s reaches each target", (method) => {
    for (const { value } of TARGETS) {
      const { selection, selected } = offered(method);
      for (let ms = GUARD_MS; selection.highlighted !== value; ms += 100)
        if (method === "two-switches") selection.press("step", ms);
        else selection.tick(ms);
      selection.press("select", 1e6);
      expect(selected).toEqual([value]);
    }
  });
});

describe("the experimenter", () => {
  it("selects only what is offered now", () => {
    const { selection, selected, announced } = offered("experimenter");
    const { number } = announced.at(-1)!;
    expect(announced.at(-1)!.targets).toEqual(TARGETS);
    selection.pressRemotely({ number: number - 1, value: 7 });
    selection.pressRemotely({ number, value: 99 });
    expect(selected).toEqual([]);
    selection.pressRemotely({ number, value: -1 });
    expect(selected).toEqual([-1]);
  });

  it("learns of no offers with other profiles", () => {
    expect(offered("head").announced).toEqual([]);
  });
});

describe("a change of the profile", () => {
  it("discards what was begun", () => {
    const { selection, selected } = offered("head");
    selection.look(null, 0);
    selection.look(7, 10);
    selection.change(profile({ method: "one-switch" }), 500);
    expect([selection.highlighted, selection.progress]).toEqual([7, 0]);
    selection.press("select", 500);
    expect(selected).toEqual([]);
  });
});

describe("switches", () => {
  const [one, two] = [profile({ method: "one-switch" }), profile({ method: "two-switches", select_key: "Enter" })];

  it.each(["a", " ", "Enter", "1", "ArrowUp", "AudioVolumeUp", "MediaPlayPause"])("may be the key %j", (key) => {
    expect(switchOfKey(one, { key, code: "X" })).toBe("select");
    expect(switchOfKey(two, { key, code: "X" })).toBe(key === "Enter" ? "select" : "step");
    expect(switchOfKey(profile({}), { key, code: "X" })).toBeNull();
  });

  it.each(["Escape", "Tab", "Shift", "F5"])("are never the key %s", (key) => {
    expect(switchOfKey(one, { key, code: key })).toBeNull();
  });

  it("may be buttons of gamepads and controllers", () => {
    expect([0, 1, 5].map((index) => switchOfButton(two, index))).toEqual(["step", "select", "select"]);
    expect((["left", "right", "none"] as const).map((hand) => switchOfHand(two, hand))).toEqual(["step", "select", "select"]);
    expect(switchOfButton(one, 0)).toBe("select");
  });
});

describe("a profile", () => {
  it("points with the sources of its arms", () => {
    const hands = ["left", "right", "none"] as const;
    const used = (changes: Partial<InputProfileMessage>) => hands.filter((handedness) => pointsWith(profile(changes), { handedness }));
    expect(used({ method: "controllers" })).toEqual(["left", "right", "none"]);
    expect(used({ method: "controllers", absent_arms: ["left"] })).toEqual(["right", "none"]);
    expect(used({ method: "left-hand" })).toEqual(["left", "none"]);
    expect(used({ method: "head" })).toEqual([]);
  });

  it("shows its own way to stop, and that of the device where it points", () => {
    expect(stopMethodOf(profile({ method: "one-switch", stops: ["switch"] }))).toBe("switch");
    expect(stopMethodOf(profile({ method: "head", stops: ["gaze"] }))).toBe("gaze");
    expect(stopMethodOf(profile({ method: "experimenter", stops: ["experimenter"] }))).toBe("experimenter");
    expect(stopMethodOf(profile({ method: "left-hand" }))).toBeNull();
  });
});

describe("a selection while a text is read aloud", () => {
  it("does not move the highlight, and then moves it after an interval", () => {
    const { selection } = offered("one-switch");
    for (let ms = 0; ms <= 9000; ms += 20) selection.tick(ms, true);
    expect(selection.highlighted).toBe(7);
    selection.tick(9000 + 1000 * SCAN_S - 100);
    expect(selection.highlighted).toBe(7);
    selection.tick(9000 + 1000 * SCAN_S);
    expect(selection.highlighted).toBe(-1);
  });
});

describe("reduced motion", () => {
  it("fills a ring in steps, and selects after the same time", () => {
    const { selection, selected } = offered("head");
    const { presentation } = selection.profile;
    selection.change({ ...selection.profile, presentation: { ...presentation, reduced_motion: true } }, 0);
    selection.look(null, 0);
    const shares = new Set<number>();
    for (let ms = 0; selected.length === 0 && ms < 2000; ms += 10) {
      selection.look(7, ms);
      shares.add(selection.progress);
    }
    expect([...shares]).toEqual([0, 0.25, 0.5, 0.75]);
    expect(selected).toEqual([7]);
  });
});
