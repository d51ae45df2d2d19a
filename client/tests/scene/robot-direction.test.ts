import { PerspectiveCamera, Scene, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import type { XRPose } from "../../src/generated/messages";
import { freeOf } from "../../src/scene/view";
import { RobotPointer, arrowTo, pointerTo, without } from "../../src/scene/robot-direction";

const AREA = { left: 0, top: 0, right: 800, bottom: 600 };
const CARD = { left: 0, top: 0, right: 300, bottom: 600 };
const NO_CARD = { left: 0, top: 700, right: 0, bottom: 700 };

/** A camera at the origin that looks along -z. */
function camera(): PerspectiveCamera {
  const camera = new PerspectiveCamera(60, 800 / 600, 0.03, 30);
  camera.updateMatrixWorld();
  return camera;
}

function arrow(x: number, y: number, z: number, card = NO_CARD) {
  return arrowTo(new Vector3(x, y, z), camera(), AREA, card, freeOf(AREA, card));
}

describe("where the robot is", () => {
  it("needs no arrow while it is in view", () => {
    expect(arrow(0, 0, -1)).toBeNull();
    expect(arrow(0.5, 0.3, -1)).toBeNull();
  });

  it("is shown at the edge on its side, also when it is behind", () => {
    expect(arrow(5, 0, -1)).toMatchObject({ y: 300, turn: 0 });
    expect(arrow(5, 0, -1)!.x).toBeGreaterThan(700);
    expect(arrow(-5, 0, -1)!.x).toBeLessThan(100);
    expect(arrow(0, 5, -1)!.y).toBeLessThan(100);
    expect(arrow(0, -5, -1)!.y).toBeGreaterThan(500);
    expect(arrow(0.5, 0, 2)!.x).toBeGreaterThan(700);
    expect(arrow(-0.5, 0, 2)!.x).toBeLessThan(100);
    expect(arrow(0, 0, 2)).not.toBeNull();
  });

  it("is shown within the picture wherever it is", () => {
    for (let turn = 0; turn < 6.2; turn += 0.1) {
      for (const height of [-1, 0, 0.4, 2]) {
        const found = arrow(Math.sin(turn), height, -Math.cos(turn), CARD);
        if (!found) continue;
        expect(found.x).toBeGreaterThanOrEqual(300 + 55);
        expect(found.x).toBeLessThanOrEqual(800 - 55);
        expect(found.y).toBeGreaterThanOrEqual(55);
        expect(found.y).toBeLessThanOrEqual(600 - 55);
      }
    }
  });

  it("needs an arrow where the card covers it", () => {
    expect(arrow(-0.5, 0, -1)).toBeNull();
    expect(arrow(-0.5, 0, -1, CARD)!.x).toBeGreaterThan(300);
  });

  it("is free of a card at the left, the top or the bottom", () => {
    expect(freeOf(AREA, CARD)).toEqual({ left: 300, top: 0, right: 800, bottom: 600 });
    const below = { left: 0, top: 400, right: 800, bottom: 600 };
    expect(freeOf(AREA, below)).toEqual({ left: 0, top: 0, right: 800, bottom: 400 });
    const above = { left: 0, top: 0, right: 800, bottom: 150 };
    expect(freeOf(AREA, above)).toEqual({ left: 0, top: 150, right: 800, bottom: 600 });
    const bar = { left: 10, top: 10, right: 500, bottom: 50 };
    expect(freeOf(AREA, bar)).toEqual({ left: 0, top: 50, right: 800, bottom: 600 });
  });

  it("stands clear of buttons above and below", () => {
    const hidden = { left: 0, top: 0, right: 0, bottom: 0 };
    const stop = { left: 10, top: 10, right: 790, bottom: 80 };
    const hand = { left: 500, top: 400, right: 780, bottom: 560 };
    expect(without(AREA, hidden)).toEqual(AREA);
    expect(without(AREA, stop)).toEqual({ ...AREA, top: 80 });
    expect(without(AREA, hand)).toEqual({ ...AREA, bottom: 400 });
  });
});

describe("the pointer in VR", () => {
  const STANDING: XRPose = [[0, 1.2, 0], [0, 0, 0, 1]];
  const TURNED: XRPose = [[0, 1.2, 0], [0, Math.SQRT1_2, 0, Math.SQRT1_2]];

  it("is hidden while the robot is in view", () => {
    expect(pointerTo(new Vector3(0.2, 1.1, -0.6), STANDING)).toBeNull();
    expect(pointerTo(new Vector3(-0.6, 1.1, 0.1), TURNED)).toBeNull();
  });

  it("is before the eyes, on the robot's side, and points to that side", () => {
    for (const [head, place, side] of [
      [STANDING, new Vector3(2, 1.2, 0), new Vector3(1, 0, 0)],
      [STANDING, new Vector3(-1, 1.2, 1), new Vector3(-1, 0, 0)],
      [TURNED, new Vector3(0, 1.2, -2), new Vector3(0, 0, -1)],
    ] as const) {
      const { position, turn } = pointerTo(place, head)!;
      const eyes = new Vector3(0, 1.2, 0);
      expect(position.clone().sub(eyes).dot(side)).toBeCloseTo(0.24);
      expect(position.distanceTo(eyes)).toBeCloseTo(Math.hypot(0.7, 0.24));
      expect(new Vector3(0, 1, 0).applyQuaternion(turn).distanceTo(side)).toBeCloseTo(0);
    }
  });

  it("is drawn in the scene while the robot is out of view", () => {
    const scene = new Scene();
    const pointer = new RobotPointer(scene);
    const shown = () => scene.children.filter(({ visible }) => visible).length;
    for (const [place, count] of [[new Vector3(2, 1.2, 0), 1], [new Vector3(0, 1.2, -2), 0], [null, 0]] as const) {
      pointer.update(STANDING, place);
      expect(shown()).toBe(count);
    }
  });
});
