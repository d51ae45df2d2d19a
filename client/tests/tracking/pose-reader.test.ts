import { describe, expect, it } from "vitest";
import { HIGHEST_RATE_HZ, Numbering, Reader, Throttle, findSource } from "../../src/tracking/pose-reader";

function passedPerSecond(rateHz: number, jitterMs = 0): number {
  const throttle = new Throttle();
  let passed = 0;
  for (let n = 0; n < 10 * rateHz; n++) {
    if (throttle.pass((1000 * n) / rateHz + (n % 2 ? jitterMs : -jitterMs))) passed++;
  }
  return passed / 10;
}

describe("the throttle", () => {
  it.each([10, 60, 72, 90])("lets every frame of %i Hz through, also when they jitter", (rateHz) => {
    expect(passedPerSecond(rateHz)).toBeCloseTo(rateHz, 0);
    expect(passedPerSecond(rateHz, 0.9)).toBeCloseTo(rateHz, 0);
  });

  it.each([120, 144, 500, 1000])("lets no more than the limit of %i Hz through", (rateHz) => {
    expect(passedPerSecond(rateHz)).toBeLessThanOrEqual(HIGHEST_RATE_HZ + 0.2);
    expect(passedPerSecond(rateHz)).toBeGreaterThan(HIGHEST_RATE_HZ * 0.95);
  });

  it("does not make up for a pause", () => {
    const throttle = new Throttle();
    throttle.pass(0);
    const burst = Array.from({ length: 20 }, (_, n) => throttle.pass(5000 + n));
    expect(burst.filter(Boolean).length).toBeLessThanOrEqual(3);
  });
});

type Seen = { x: number; emulatedPosition?: boolean } | null;

function pose(seen: Seen | undefined): XRPose | null {
  if (!seen) return null;
  const position = { x: seen.x, y: 1.25, z: -0.5, w: 1 };
  const orientation = { x: 0.5, y: -0.5, z: 0.5, w: 0.5 };
  return {
    transform: { position, orientation },
    emulatedPosition: seen.emulatedPosition ?? false,
  } as unknown as XRPose;
}

function source(handedness: XRHandedness, kind: "controller" | "hand", seen: Seen): XRInputSource {
  const space = { seen };
  const hand = kind === "hand" ? new Map([["wrist", space]]) : undefined;
  return { handedness, gripSpace: space, hand } as unknown as XRInputSource;
}

function frame(head: Seen, ...inputSources: XRInputSource[]): XRFrame {
  const getPose = ({ seen }: { seen: Seen }) => pose(seen);
  return {
    session: { inputSources },
    getViewerPose: () => pose(head),
    getPose,
    getJointPose: getPose,
  } as unknown as XRFrame;
}

const SPACE = {} as XRReferenceSpace;
const Q = [0.5, -0.5, 0.5, 0.5];

describe("the reader", () => {
  it("reads head and controllers", () => {
    const seen = frame(
      { x: 0 },
      source("right", "controller", { x: 2 }),
      source("left", "controller", { x: 1 }),
    );
    expect(new Reader().read(seen, SPACE)).toEqual({
      head: [[0, 1.25, -0.5], Q],
      left: [[1, 1.25, -0.5], Q],
      right: [[2, 1.25, -0.5], Q],
      left_modality: "controller",
      right_modality: "controller",
    });
  });

  it("gives null for what is not tracked or only guessed", () => {
    const guessed = source("left", "controller", { x: 1, emulatedPosition: true });
    const read = new Reader().read(frame(null, guessed), SPACE);
    expect(read).toMatchObject({ head: null, left: null, right: null });
    expect(read).toMatchObject({ left_modality: "controller", right_modality: "none" });
  });

  it("takes the wrist of a hand that holds no controller", () => {
    const hands = [source("left", "hand", { x: 1 }), source("right", "hand", { x: 2 })];
    const read = new Reader().read(frame({ x: 0 }, ...hands), SPACE);
    expect(read.left?.[0][0]).toBe(1);
    expect(read).toMatchObject({ left_modality: "hand", right_modality: "hand" });
  });

  it("tells a controller in one hand from the other, bare hand", () => {
    const mixed = [source("left", "hand", { x: 1 }), source("right", "controller", { x: 2 })];
    const read = new Reader().read(frame({ x: 0 }, ...mixed), SPACE);
    expect(read).toMatchObject({ left_modality: "hand", right_modality: "controller" });
  });

  it("stays with a tracked hand while its fingers pinch, whatever the order of the sources", () => {
    const hand = source("right", "hand", { x: 2 });
    const pinch = { ...source("right", "controller", { x: 2.1 }), targetRayMode: "transient-pointer" } as XRInputSource;
    for (const sources of [[hand, pinch], [pinch, hand]]) { // prettier-ignore
      const read = new Reader().read(frame({ x: 0 }, ...sources), SPACE);
      expect(read.right?.[0][0]).toBe(2);
      expect(read.right_modality).toBe("hand");
    }
    const alone = new Reader().read(frame({ x: 0 }, pinch), SPACE);
    expect(alone.right?.[0][0]).toBe(2.1);
  });

  it("prefers a controller to the hand that holds it, whatever the order of the sources", () => {
    const [hand, held] = [source("left", "hand", { x: 1 }), source("left", "controller", { x: 1.1 })];
    for (const sources of [[hand, held], [held, hand]]) // prettier-ignore
      expect(new Reader().read(frame({ x: 0 }, ...sources), SPACE).left_modality).toBe("controller");
  });

  it("notices a controller that is lost, and its return", () => {
    const reader = new Reader();
    const held = source("right", "controller", { x: 2 });
    expect(reader.read(frame({ x: 0 }, held), SPACE).right).not.toBeNull();
    expect(reader.read(frame({ x: 0 }), SPACE)).toMatchObject({ right: null, right_modality: "none" });
    expect(reader.read(frame({ x: 0 }, held), SPACE)).toMatchObject({ right_modality: "controller" });
  });

  it("says none without any input", () => {
    const read = new Reader().read(frame({ x: 0 }), SPACE);
    expect(read).toMatchObject({ left_modality: "none", right_modality: "none" });
  });
});

describe("the numbers of frames", () => {
  const poses = () => new Reader().read(frame({ x: 0 }), SPACE);

  it("count up by one", () => {
    const numbering = new Numbering();
    expect(numbering.next(poses(), 16.5)).toMatchObject({ type: "tracking", sequence: 0, client_time_ms: 16.5, ...poses() });
    expect(numbering.next(poses(), 27).sequence).toBe(1);
    expect(numbering.count).toBe(2);
  });

  it("tell how old a frame's poses are", () => {
    const numbering = new Numbering();
    for (let n = 0; n < 5000; n++) numbering.next(poses(), 10 * n);
    expect(numbering.ageMs(4999, 50_000)).toBe(10);
    expect(numbering.ageMs(4000, 50_000)).toBe(10_000);
    for (const unknown of [-1, 5000, 0]) expect(numbering.ageMs(unknown, 50_000)).toBe(0);
  });
});

describe("finding a hand's input", () => {
  const hand = source("left", "hand", null);
  const controller = source("left", "controller", null);

  it("prefers the controller in either order", () => {
    for (const both of [
      [hand, controller],
      [controller, hand],
    ]) {
      expect(findSource(both as unknown as XRInputSourceArray, "left")).toBe(controller);
    }
  });

  it("passes over gaze and screen input", () => {
    const gaze = { handedness: "left" } as XRInputSource;
    expect(findSource([gaze] as unknown as XRInputSourceArray, "left")).toBeNull();
  });
});
