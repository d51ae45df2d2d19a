/// <reference types="vite/client" />
import { describe, expect, it } from "vitest";
import { onThePage } from "../src/words";

const CONTROLLER = /trigger|menu button/i;
const SOURCES: Record<string, string> = import.meta.glob(
  ["../../src/avrgym/vr/session/phases/*.py", "../../src/avrgym/vr/tracking/frames.py"],
  { query: "?raw", import: "default", eager: true },
);

/** All that the server says of a controller, from its own source. */
function said(): string[] {
  return Object.values(SOURCES)
    .flatMap((source) => source.replace(/"""[^]*?"""/g, "").match(/"[^"\n]*"/g) ?? [])
    .filter((words) => CONTROLLER.test(words));
}

describe("words on the page", () => {
  it("never speak of a trigger or a menu button", () => {
    expect(said().length).toBeGreaterThan(8);
    for (const words of said()) expect(onThePage(words)).not.toMatch(CONTROLLER);
  });

  it("name the buttons of the page", () => {
    expect(onThePage("Lie back. Then press the trigger.")).toBe("Lie back. Then choose Go on.");
    expect(onThePage("The robot holds still. Press the trigger to repeat the trial.")).toBe(
      "The robot holds still. Choose Go on to repeat the trial.",
    );
  });
});
