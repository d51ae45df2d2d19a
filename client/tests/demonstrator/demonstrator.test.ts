import { Group, Quaternion, Vector3 } from "three";
import { expect, test } from "vitest";
import { countText, stageText } from "../../src/demonstrator/progress-texts";
import { ControlReader, episodeButton, ForceHaptics, steerMessage } from "../../src/demonstrator/steering";
import { Viewpoint } from "../../src/demonstrator/viewpoint";
import type { DemonstrationProgress, XRPose } from "../../src/generated/messages";

const progress: DemonstrationProgress = {
  type: "demonstration_progress",
  stage: "ready",
  goal: "Feed the person.",
  episodes: 20,
  completed: 4,
  successes: 3,
  discarded: 1,
  seconds: 20,
  policy: "",
};

function headAt(x: number, z: number, yaw: number): XRPose {
  const turn = new Quaternion().setFromAxisAngle(new Vector3(0, 1, 0), yaw);
  return [[x, 1.6, z], [turn.x, turn.y, turn.z, turn.w]];
}

function inRoom(root: Group, x: number, y: number): Vector3 {
  root.updateMatrixWorld(true);
  return root.localToWorld(new Vector3(x, y, 0));
}

test.each([0, 1.1, -2.5])("every view places the person ahead of a head with yaw %d, on the same floor", (yaw) => {
  const root = new Group();
  const viewpoint = new Viewpoint(root);
  const head = headAt(0.4, -0.7, yaw);
  for (let view = 0; view < 4; view++) {
    viewpoint.next(head);
    const way = inRoom(root, 0, -0.1).sub(new Vector3(0.4, 0, -0.7));
    const ahead = new Vector3(0, 0, -1).applyAxisAngle(new Vector3(0, 1, 0), yaw);
    expect(way.clone().normalize().dot(ahead)).toBeCloseTo(1, 6);
    expect(way.length()).toBeGreaterThan(0.8);
    expect(way.y).toBeCloseTo(0, 9);
  }
});

test("a stick moves the demonstrator and not the floor's height, and turns them on the spot", () => {
  const root = new Group();
  const viewpoint = new Viewpoint(root);
  const head = headAt(0, 0, 0);
  viewpoint.next(head);
  const before = inRoom(root, 0, 0);
  viewpoint.move(head, [0, -1], 0, 0.1);
  expect(inRoom(root, 0, 0).sub(before).toArray()).toEqual([0, 0, 0.1].map((value) => expect.closeTo(value, 6)));
  viewpoint.move(head, [0.1, 0.1], 0.1, 0.1);
  const still = inRoom(root, 0, 0);
  viewpoint.move(head, [0, 0], 1, 0.5);
  expect(inRoom(root, 0, 0).length()).toBeCloseTo(still.length(), 6);
  expect(inRoom(root, 0, 0).distanceTo(still)).toBeGreaterThan(0.3);
});

interface Pad {
  pressed?: number[];
  axes?: number[];
}

function sources(pads: { left?: Pad; right?: Pad }): XRInputSourceArray {
  const made = Object.entries(pads).map(([handedness, { pressed = [], axes = [0, 0, 0, 0] }]) => ({
    handedness,
    gripSpace: {},
    targetRayMode: "tracked-pointer",
    gamepad: { axes, buttons: [0, 1, 2, 3, 4, 5].map((index) => ({ pressed: pressed.includes(index) })) },
  }));
  return made as unknown as XRInputSourceArray;
}

test("the hand whose grip is held steers, until it is released", () => {
  const reader = new ControlReader();
  expect(reader.read(sources({ left: { pressed: [1] }, right: {} }))).toMatchObject({ hand: "left", clutch: true });
  const both = sources({ left: { pressed: [1] }, right: { pressed: [1] } });
  expect(reader.read(both)).toMatchObject({ hand: "left", clutch: true });
  expect(reader.read(sources({ left: {}, right: { pressed: [1] } }))).toMatchObject({ hand: "right", clutch: true });
  expect(reader.read(sources({ left: {}, right: {} }))).toMatchObject({ hand: "right", clutch: false });
});

test("a held button acts once, and accepts by the stage", () => {
  const reader = new ControlReader();
  const down = sources({ left: {}, right: { pressed: [4] } });
  expect(episodeButton(reader.read(down), false)).toBe("start");
  expect(episodeButton(reader.read(down), true)).toBe(null);
  reader.read(sources({ left: {}, right: {} }));
  expect(episodeButton(reader.read(down), true)).toBe("success");
  expect(episodeButton(reader.read(sources({ left: { pressed: [5] }, right: {} })), true)).toBe("discard");
  const trigger = sources({ left: { pressed: [0] }, right: {} });
  expect([1, 2].map(() => reader.read(trigger).toggledCamera)).toEqual([true, false]);
});

test("the message has the pose of the steering hand, or none", () => {
  const controls = new ControlReader().read(sources({ left: {}, right: { pressed: [1] } }));
  const pose = headAt(1, 2, 0);
  const modalities = { left_modality: "controller", right_modality: "controller" } as const;
  const poses = { head: null, left: null, right: pose, ...modalities };
  expect(steerMessage(controls, poses, pose, 0.5)).toMatchObject({ clutch: true, grip: pose, scale: 0.5 });
  expect(steerMessage(controls, { ...poses, right: null }, pose, 0.5)).toMatchObject({ grip: null });
});

test("force is felt in proportion, and no force is not felt", () => {
  const felt: number[] = [];
  const haptics = new ForceHaptics((_, strength) => felt.push(strength));
  haptics.frame("right", 0);
  haptics.forceN = 3;
  for (const ms of [10, 20, 80]) haptics.frame("right", ms);
  haptics.forceN = 100;
  haptics.frame("right", 200);
  expect(felt).toEqual([expect.closeTo(0.28), expect.closeTo(0.28), 1]);
});

test("the texts contain the next step, counts and the success rate", () => {
  expect(stageText(progress)).toBe("Feed the person. Press A or Start to begin.");
  const running = { ...progress, stage: "running", policy: "clone.safetensors" } as const;
  expect(stageText(running)).toBe(
    "The policy clone.safetensors drives. Hold a grip button or Space to take over. " +
      "Press A or Success when the task is done.",
  );
  expect(stageText({ ...running, policy: "" })).toBe("Press A or Success when the task is done.");
  expect(countText(progress)).toBe("4 of 20 recorded, 3 successes (75 %), 1 discarded.");
  expect(countText({ ...progress, episodes: null, completed: 0, successes: 0 })).toMatch(/^0 recorded, 0 successes, 1/);
});
