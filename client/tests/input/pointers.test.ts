import { Quaternion, Vector3 } from "three";
import { beforeAll, describe, expect, it } from "vitest";
import { panelContent } from "../../src/session/display-state";
import type { Question } from "../../src/generated/messages";
import { Panel } from "../../src/panel/panel";
import { MOVED_M } from "../../src/input/arrival";
import { Pointers } from "../../src/input/pointers";
import { ENGLISH_TEXTS } from "../../src/page/texts";

const QUESTION: Question = {
  ...{ type: "question", item: "L1", text: "Safe?", points: 7, labels: [], low: "no", high: "yes" },
  ...{ number: 2, count: 4, previous_answer: null },
};
const SPACE = {} as XRReferenceSpace;
const ANY = () => true;
const EYES = new Vector3(0, 1.2, 0);
const NOBODY = () => new Float32Array();

beforeAll(() => {
  const context = new Proxy({}, { get: (_, name) => (name === "measureText" ? () => ({ width: 1 }) : () => undefined), set: () => true });
  Object.assign(globalThis, { document: { createElement: () => ({ getContext: () => context }) } });
});

/** A panel that asks a question, straight ahead. */
function askingPanel(): Panel {
  const panel = new Panel(1);
  const display = { phase: null, body: null, answered: null, problem: null, secondsLeft: null, participates: true, staged: false, segment: null };
  panel.show(panelContent({ texts: ENGLISH_TEXTS, link: "connected", code: 0, input: "trigger", question: QUESTION, ...display }));
  panel.place(EYES, new Vector3(0, 0, -1), NOBODY);
  panel.mesh.updateMatrixWorld();
  return panel;
}

interface Ray {
  from: Vector3;
  to: Vector3;
}

type Source = XRInputSource & { targetRaySpace: { ray: Ray | null } };

function source(targetRayMode: XRTargetRayMode, handedness: XRHandedness, ray: Ray | null): Source {
  return { targetRayMode, handedness, profiles: [], targetRaySpace: { ray } } as unknown as Source;
}

function frame(...inputSources: Source[]): XRFrame {
  const getPose = ({ ray }: { ray: Ray | null }) => {
    if (!ray) return null;
    const direction = ray.to.clone().sub(ray.from).normalize();
    const orientation = new Quaternion().setFromUnitVectors(new Vector3(0, 0, -1), direction);
    return { transform: { position: ray.from, orientation } };
  };
  return { session: { inputSources }, getPose } as unknown as XRFrame;
}

/** From the eyes to the middle of a button. */
function towards(panel: Panel, value: number, from = EYES): Ray {
  return { from, to: panel.centreOf(panel.buttons.find((button) => button.value === value)!) };
}

const ASIDE: Ray = { from: EYES, to: new Vector3(5, 1.2, 0) };
const MODES = ["tracked-pointer", "gaze", "transient-pointer", "screen"] as const;
const HANDS = ["left", "right", "none"] as const;
const KINDS = MODES.flatMap((mode) => HANDS.map((hand) => [mode, hand] as const));

describe("an input source", () => {
  it.each(KINDS)("with a ray of kind %s and handedness %s chooses each button, and nothing outside of them", (mode, hand) => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    for (const { value } of panel.buttons) {
      const pointing = source(mode, hand, towards(panel, value));
      expect(pointers.pointedAt(pointing, frame(pointing), SPACE, panel).value).toBe(value);
    }
    const aside = source(mode, hand, ASIDE);
    expect(pointers.pointedAt(aside, frame(aside), SPACE, panel).value).toBeNull();
    const lost = source(mode, hand, null);
    expect(pointers.pointedAt(lost, frame(lost), SPACE, panel).value).toBeNull();
  });

  it.each(["transient-pointer", "screen"] as const)("with a ray of kind %s points as it begins, whatever follows", (mode) => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    const pinch = source(mode, "none", towards(panel, 3));
    expect(pointers.pointedAt(pinch, frame(pinch), SPACE, panel)).toEqual({ value: 3, rests: false });
    const end = () => pointers.group.children[0]!.quaternion.toArray();
    const began = end();
    pinch.targetRaySpace.ray = towards(panel, 6);
    expect(pointers.point(frame(pinch), SPACE, panel, ANY)).toBeNull();
    expect(end()).toEqual(began);
  });

  it("that is gone leaves no ray", () => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    const gone = source("tracked-pointer", "right", ASIDE);
    pointers.point(frame(gone), SPACE, panel, ANY);
    gone.targetRaySpace.ray = towards(panel, 2);
    expect(pointers.point(frame(gone), SPACE, panel, ANY)).toBe(2);
    expect(pointers.point(frame(), SPACE, panel, ANY)).toBeNull();
    expect(pointers.group.children.some(({ visible }) => visible)).toBe(false);
  });

  it("takes the ray of one that is gone, so that pinches add nothing to the scene", () => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    for (let pinch = 0; pinch < 100; pinch++) {
      const pinching = source("transient-pointer", "none", towards(panel, 2));
      pointers.pointedAt(pinching, frame(pinching), SPACE, panel);
      pointers.point(frame(), SPACE, panel, ANY);
    }
    expect(pointers.group.children.length).toBe(1);
  });
});

describe("a ray that rests on a button when the panel appears", () => {
  it("is not on the button until it has moved", () => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    const resting = source("tracked-pointer", "right", towards(panel, 4));
    const at = () => pointers.pointedAt(resting, frame(resting), SPACE, panel);
    expect(pointers.point(frame(resting), SPACE, panel, ANY)).toBeNull();
    expect(at()).toEqual({ value: 4, rests: true });
    resting.targetRaySpace.ray!.to.x += MOVED_M + 0.001;
    expect(at()).toEqual({ value: 4, rests: false });
    panel.offer++;
    expect(at()).toEqual({ value: 4, rests: true });
    resting.targetRaySpace.ray = towards(panel, 5);
    expect(at()).toEqual({ value: 5, rests: false });
  });
});

describe("of several sources", () => {
  it("the one that came to a button last counts", () => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    const [left, right] = [source("tracked-pointer", "left", ASIDE), source("tracked-pointer", "right", ASIDE)];
    const both = frame(left, right);
    pointers.point(both, SPACE, panel, ANY);
    right.targetRaySpace.ray = towards(panel, 5);
    expect(pointers.point(both, SPACE, panel, ANY)).toBe(5);
    left.targetRaySpace.ray = towards(panel, 1);
    expect(pointers.point(both, SPACE, panel, ANY)).toBe(1);
    right.targetRaySpace.ray = towards(panel, 6);
    expect(pointers.point(both, SPACE, panel, ANY)).toBe(6);
    right.targetRaySpace.ray = ASIDE;
    expect(pointers.point(both, SPACE, panel, ANY)).toBe(1);
  });

  it("each chooses what it points at itself", () => {
    const [panel, pointers] = [askingPanel(), new Pointers()];
    const [gaze, hand] = [source("gaze", "none", towards(panel, 4)), source("tracked-pointer", "right", towards(panel, 2))];
    pointers.point(frame(gaze, hand), SPACE, panel, ANY);
    expect(pointers.pointedAt(gaze, frame(gaze, hand), SPACE, panel).value).toBe(4);
    expect(pointers.pointedAt(hand, frame(gaze, hand), SPACE, panel).value).toBe(2);
  });
});
