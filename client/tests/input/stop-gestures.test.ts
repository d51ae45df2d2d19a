import { Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { NO_TRACKED_HANDS, type TrackedHands } from "../../src/body/bare-hands";
import { SIGN_RADIUS_RAD, StopGestures, STOP_METHODS, kindOf, menuIsDown, stopMethodFor, type Seen, type VrStopMethod } from "../../src/input/stop-gestures";
import { TEXTS } from "../../src/generated/interface-texts";
import { raisedHand } from "../helpers/hand-joints";
import PROFILES from "../data/profiles.json";

/** The buttons of a source; which of them are pressed changes in place. */
interface Pressable extends XRInputSource {
  pressed: Set<number>;
}

interface Kind {
  profiles?: string[];
  buttons?: number;
  mode?: XRTargetRayMode;
  handedness?: XRHandedness;
  joints?: boolean;
}

function source({ profiles = [], buttons, mode = "tracked-pointer", handedness = "right", joints }: Kind): Pressable {
  const pressed = new Set<number>();
  const made = Array.from({ length: buttons ?? 0 }, (_, at) => ({ get pressed() { return pressed.has(at); } }));
  const gamepad = buttons === undefined ? undefined : { buttons: made };
  return { profiles, gamepad, targetRayMode: mode, handedness, hand: joints ? new Map() : undefined, pressed } as never;
}

const SIGN = new Vector3(-0.5, 1.5, -1);
const EYES = new Vector3(0, 1.2, 0);
const AHEAD = new Vector3(0, 0, -1);
const AT_SIGN = SIGN.clone().sub(EYES).normalize();
const FRAME_MS = 1000 / 72;

/** A participant with some input sources, frame by frame. */
class Participant {
  readonly stopping = new StopGestures();
  gaze = AHEAD;
  hands: TrackedHands = NO_TRACKED_HANDS;
  possible = true;
  nowMs = 0;
  private readonly session = new EventTarget();

  constructor(public sources: Pressable[]) {
    this.stopping.listen(this.session as XRSession);
    this.frame();
  }

  /** `select` or `squeeze` goes down or up. */
  press(kind: "select" | "squeeze", down: boolean, ...which: XRInputSource[]): void {
    for (const inputSource of which)
      this.session.dispatchEvent(Object.assign(new Event(kind + (down ? "start" : "end")), { inputSource }));
  }

  frame(): VrStopMethod | null {
    this.nowMs += FRAME_MS;
    const seen: Seen = { sources: this.sources, eyes: EYES, gaze: this.gaze, hands: this.hands, sign: SIGN };
    return this.stopping.watch(seen, this.possible, this.nowMs);
  }

  /** All ways in which the robot was stopped within so many seconds. */
  wait(seconds: number): VrStopMethod[] {
    const ends = this.nowMs + 1000 * seconds;
    const stops: VrStopMethod[] = [];
    while (this.nowMs < ends) stops.push(...[this.frame()].filter((method) => method !== null));
    return stops;
  }
}

/** What a browser has of a profile of the registry: both hands, or the one there is. */
function sourcesOf({ profiles, hands, buttons }: (typeof PROFILES)[number], joints: boolean): Pressable[] {
  const mode = profiles[0] === "generic-touchscreen" ? "screen" : "tracked-pointer";
  const sides = hands.filter((hand) => hand !== "none");
  const both = sides.length > 0 ? ["left", "right"] : ["none"];
  return both.map((handedness) => source({ profiles, buttons, mode, handedness: handedness as XRHandedness, joints }));
}

/** Does what the sign says. */
function obey(participant: Participant, method: VrStopMethod): void {
  const { sources } = participant;
  if (method === "triggers" || method === "select") participant.press("select", true, ...sources);
  if (method === "palm") participant.hands = { left: null, right: raisedHand("right", EYES) };
  if (method === "gaze") participant.gaze = AT_SIGN;
}

describe("of every input profile in the registry", () => {
  const each = PROFILES.map((profile) => [profile.profiles[0]!, profile.hands.join(" "), profile] as const);

  it.each(each)("%s (%s) has a stop, alone and as a pair, with joints or without", (_, __, profile) => {
    for (const joints of profile.profiles.includes("generic-hand-select") ? [true, false] : [false])
      for (const count of [2, 1]) {
        const sources = sourcesOf(profile, joints).slice(0, count);
        const participant = new Participant(sources);
        const { method } = participant.stopping;
        expect(stopMethodFor(sources)).toBe(method);
        if (method === "button") {
          sources.at(-1)!.pressed.add(profile.buttons > 4 ? 4 : 5);
          expect(menuIsDown(sources)).toBe(true);
          continue;
        }
        obey(participant, method);
        expect(participant.wait(STOP_METHODS[method].heldMs / 1000 - 0.05)).toEqual([]);
        expect(participant.stopping.progress).toBeGreaterThan(0.9);
        expect(participant.wait(3)).toEqual([method]);
      }
  });

  it("all that have a squeeze and no menu button stop with it, too", () => {
    const squeezed = PROFILES.filter(({ squeezes }) => squeezes).map((profile) => sourcesOf(profile, false));
    const without = squeezed.filter((sources) => kindOf(sources[0]!) === "trigger");
    expect(without.length).toBeGreaterThan(5);
    for (const sources of without) {
      const participant = new Participant(sources);
      participant.press("squeeze", true, sources[0]!);
      expect(participant.wait(0.65)).toEqual([]);
      expect(participant.wait(1)).toEqual(["squeeze"]);
    }
  });

  it("no fist counts as a menu button", () => {
    const grasping = source({ profiles: ["generic-hand-select-grasp", "generic-hand-select"], buttons: 5 });
    grasping.pressed.add(4);
    expect(menuIsDown([grasping])).toBe(false);
  });
});

describe("sources that are there for a moment or not at all", () => {
  it.each(["transient-pointer", "gaze", "screen"] as const)("with a ray of kind %s stop by looking at the sign", (mode) => {
    expect(stopMethodFor([source({ mode, handedness: "none" })])).toBe("gaze");
  });

  it("leave the eyes after a second", () => {
    const participant = new Participant([source({ buttons: 6 })]);
    participant.sources = [];
    participant.wait(0.9);
    expect(participant.stopping.method).toBe("button");
    participant.wait(0.2);
    expect(participant.stopping.method).toBe("gaze");
    participant.gaze = AT_SIGN;
    expect(participant.wait(1.2)).toEqual(["gaze"]);
  });

  it("leave the palm to hands beside which a pinch comes and goes", () => {
    const hand = source({ joints: true });
    expect(stopMethodFor([hand, source({ mode: "transient-pointer", handedness: "none" })])).toBe("palm");
  });
});

describe("a stop", () => {
  const vive = () => [source({ buttons: 4, handedness: "left" }), source({ buttons: 4 })];

  it("is not made by a press that ends earlier, nor by one trigger of two", () => {
    const participant = new Participant(vive());
    for (let n = 0; n < 20; n++) {
      participant.press("select", true, ...participant.sources);
      expect(participant.wait(0.6)).toEqual([]);
      participant.press("select", false, ...participant.sources);
      participant.wait(0.05);
    }
    participant.press("select", true, participant.sources[0]!);
    expect(participant.wait(5)).toEqual([]);
  });

  it("is not made by two short squeezes that overlap", () => {
    const participant = new Participant(vive());
    const [left, right] = participant.sources as [Pressable, Pressable];
    participant.press("squeeze", true, left);
    participant.wait(0.4);
    participant.press("squeeze", true, right);
    participant.wait(0.1);
    participant.press("squeeze", false, left);
    expect(participant.wait(0.6)).toEqual([]);
    expect(participant.wait(0.2)).toEqual(["squeeze"]);
  });

  it.each(["triggers", "select"] as const)("with %s is not made by the press that began the trial", (method) => {
    const participant = new Participant(method === "triggers" ? vive() : vive().slice(1));
    participant.possible = false;
    participant.press("select", true, ...participant.sources);
    participant.wait(0.2);
    participant.possible = true;
    expect(participant.wait(5)).toEqual([]);
    participant.press("select", false, ...participant.sources);
    participant.wait(0.1);
    participant.press("select", true, ...participant.sources);
    expect(participant.wait(1)).toEqual([method]);
  });

  it("is made once, until it is let go", () => {
    const participant = new Participant(vive().slice(1));
    participant.press("select", true, ...participant.sources);
    expect(participant.wait(5)).toEqual(["select"]);
    expect(participant.stopping.progress).toBe(0);
  });

  it("is made by a palm that was raised before, and through a flicker of tracking", () => {
    const participant = new Participant([source({ joints: true })]);
    const raised = { left: null, right: raisedHand("right", EYES) };
    participant.possible = false;
    participant.hands = raised;
    participant.wait(2);
    participant.possible = true;
    expect(participant.wait(0.4)).toEqual([]);
    participant.hands = NO_TRACKED_HANDS;
    expect(participant.wait(0.1)).toEqual([]);
    participant.hands = raised;
    expect(participant.wait(0.3)).toEqual(["palm"]);
  });

  it("is not made by eyes that pass the sign, nor by those that look past it", () => {
    const participant = new Participant([]);
    participant.wait(2);
    for (let n = 0; n < 20; n++) {
      participant.gaze = AT_SIGN;
      expect(participant.wait(0.8)).toEqual([]);
      participant.gaze = AHEAD;
      participant.wait(0.3);
    }
    participant.gaze = AT_SIGN.clone().applyAxisAngle(new Vector3(0, 1, 0), 1.1 * SIGN_RADIUS_RAD);
    expect(participant.wait(5)).toEqual([]);
  });

  it("is said in every language, in words of its own for each way but the squeeze, which is said with the triggers", () => {
    for (const { texts } of Object.values(TEXTS)) {
      const said = Object.values(STOP_METHODS).map(({ text: key }) => texts[key]);
      expect(new Set(said).size).toBe(said.length - 1);
    }
  });
});
