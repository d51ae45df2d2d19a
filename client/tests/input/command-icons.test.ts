import { Quaternion, Vector3 } from "three";
import { beforeEach, describe, expect, it, vi } from "vitest";
import type { CommandLabel, InputProfileMessage } from "../../src/generated/messages";
import { CommandIcons, FIRST_ICON } from "../../src/input/command-icons";
import { CONTROLLERS, PRESENTATION, commandSource } from "../../src/input/input-profile";

const EYES = new Vector3(0, 1.2, 0);
const NAMES = ["ready", "wait", "slower", "faster", "closer", "farther", "other_side", "again", "stop"] as const;
const DEGREE = Math.PI / 180;
const NOWHERE = () => new Float32Array();

beforeEach(() => {
  const context = new Proxy({}, { get: (_, name) => (name === "measureText" ? () => ({ width: 10 }) : () => undefined), set: () => true });
  vi.stubGlobal("document", { createElement: () => ({ getContext: () => context }) });
});

/** A viewer that looks from the eyes in a direction. */
function looking(to: Vector3): XRViewerPose {
  const orientation = new Quaternion().setFromUnitVectors(new Vector3(0, 0, -1), to.clone().normalize());
  return { transform: { position: EYES, orientation } } as unknown as XRViewerPose;
}

/** Icons next to a tool at an angle to the right. */
function placed(count: number, toolDeg: number, position: "left" | "centre" = "centre"): CommandIcons {
  const icons = new CommandIcons();
  const commands: CommandLabel[] = NAMES.slice(0, count).map((name) => ({ name, label: name }));
  const presentation = { ...PRESENTATION, position };
  icons.show(commands, presentation);
  const tool = new Vector3(Math.sin(toolDeg * DEGREE), 0, -Math.cos(toolDeg * DEGREE)).multiplyScalar(0.6).add(EYES);
  icons.place(looking(new Vector3(0, 0, -1)), tool, NOWHERE, presentation);
  return icons;
}

describe("the icons of robot commands", () => {
  it.each([1, 3, 5, 9])("are selected by a look at each of %d", (count) => {
    const icons = placed(count, 5);
    const values = icons.targets.map(({ value }) => value);
    expect(values.map((value) => icons.look(looking(icons.centreOf(value)!.sub(EYES))))).toEqual(values);
    expect(values.map((value) => icons.commandOf(value))).toEqual(NAMES.slice(0, count));
    expect(icons.look(looking(new Vector3(0, 1, -1)))).toBeNull();
  });

  it.each([-60, -20, 0, 10, 40])("are in view and next to a tool at %d°", (toolDeg) => {
    const angle = ({ x, z }: Vector3) => Math.atan2(x, -z) / DEGREE;
    const right = angle(placed(3, toolDeg).centreOf(FIRST_ICON + 1)!);
    const left = angle(placed(3, toolDeg, "left").centreOf(FIRST_ICON + 1)!);
    expect(Math.max(Math.abs(left), Math.abs(right))).toBeLessThan(29);
    expect(left).toBeLessThanOrEqual(right);
    if (Math.abs(toolDeg) < 5) expect([left, right].map(Math.round)).toEqual([-22, 22]);
  });

  it.each([[-60, 0], [0, -40], [0, 20], [40, -20], [40, 0]])("are upright and in the view in bed with a tool at %d°, %d° high", (toolDeg, highDeg) => {
    const recline = 30 * DEGREE;
    const [gaze, up] = [new Vector3(0, Math.sin(recline), -Math.cos(recline)), new Vector3(0, Math.cos(recline), Math.sin(recline))];
    const icons = new CommandIcons();
    icons.show(NAMES.slice(0, 3).map((name) => ({ name, label: name })), PRESENTATION);
    const tool = new Vector3().setFromSphericalCoords(0.6, (90 - highDeg) * DEGREE, (180 - toolDeg) * DEGREE).add(EYES);
    icons.place(looking(gaze), tool, NOWHERE, PRESENTATION, recline);
    const centres = icons.targets.map(({ value }) => icons.centreOf(value)!.sub(EYES));
    expect(Math.max(...centres.map((centre) => centre.angleTo(gaze) / DEGREE))).toBeLessThan(40);
    expect(centres[0]!.clone().sub(centres[2]!).normalize().dot(up)).toBeGreaterThan(0.9);
  });

  it("disappear when no command is possible", () => {
    const icons = placed(3, 0);
    icons.show([], PRESENTATION);
    expect([icons.targets, icons.group.visible, icons.look(looking(new Vector3(0, 0, -1)))]).toEqual([[], false, null]);
  });
});

describe("the source of a selected command", () => {
  it.each([
    ["head", ["gaze"], "dwell"],
    ["one-switch", ["gaze"], "switch"],
    ["two-switches", ["switch"], null],
    ["controllers", ["buttons"], null],
    ["experimenter", ["gaze"], null],
  ] as const)("of %s with a stop by %s is %s", (method, stops, source) => {
    expect(commandSource({ ...CONTROLLERS, method, stops: [...stops] } as InputProfileMessage)).toBe(source);
  });
});
