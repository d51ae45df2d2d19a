import { describe, expect, it } from "vitest";
import { RobotCommandInput, commandOfKey } from "../../src/input/robot-commands";
import type { CommandLabel, AvailableRobotCommands } from "../../src/generated/messages";

const COMMANDS: CommandLabel[] = [
  { name: "ready", label: "Bereit" },
  { name: "wait", label: "Warten" },
];
const PLAIN = { repeat: false, ctrlKey: false, altKey: false, metaKey: false };

function gamepad(...pressed: boolean[]): Gamepad {
  return { buttons: pressed.map((each) => ({ pressed: each })) } as unknown as Gamepad;
}

/** An input whose buttons are already displayed. */
function input(sent: string[], offered: CommandLabel[]): RobotCommandInput {
  const group = { dataset: {}, hidden: false, replaceChildren: () => undefined } as unknown as HTMLElement;
  const commands = new RobotCommandInput(group, ({ name, source }) => sent.push(`${name} ${source}`));
  (commands as unknown as { offered: CommandLabel[] }).offered = offered;
  const message = { type: "robot_commands", commands: offered, sources: ["button"], mode: "waiting" };
  commands.show({ ...message, speed_factor: 1, distance_m: 0.15 } as AvailableRobotCommands);
  expect(group.hidden).toBe(offered.length === 0);
  return commands;
}

describe("number keys", () => {
  it("give the command at their place", () => {
    expect(commandOfKey({ ...PLAIN, key: "2" }, COMMANDS)).toBe("wait");
  });

  it("give none beyond the offered ones, with a modifier, or while held", () => {
    for (const event of [{ key: "3" }, { key: "0" }, { key: "a" }, { key: "1", ctrlKey: true }, { key: "1", repeat: true }])
      expect(commandOfKey({ ...PLAIN, ...event }, COMMANDS)).toBeNull();
  });
});

describe("gamepad buttons", () => {
  it("give their command once for each press", () => {
    const sent: string[] = [];
    const commands = input(sent, COMMANDS);
    for (const pressed of [true, true, false, true]) commands.watchGamepads([null, gamepad(false, pressed)]);
    expect(sent).toEqual(["wait button", "wait button"]);
  });

  it("give none while nothing is offered", () => {
    const sent: string[] = [];
    input(sent, []).watchGamepads([gamepad(true)]);
    expect(sent).toEqual([]);
  });
});
