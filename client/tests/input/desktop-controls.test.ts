import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { DesktopControls } from "../../src/input/desktop-controls";

/** An element or window that only passes events on. */
class Emitter {
  private readonly listeners = new Map<string, (event: object) => void>();

  addEventListener(kind: string, listener: (event: object) => void): void {
    this.listeners.set(kind, listener);
  }

  send(kind: string, event: object = {}): void {
    this.listeners.get(kind)?.(event);
  }
}

describe("playing without a headset", () => {
  let view: Emitter;
  let page: Emitter;
  let play: DesktopControls;

  beforeEach(() => {
    [view, page] = [new Emitter(), new Emitter()];
    vi.stubGlobal("window", page);
    play = new DesktopControls(view as unknown as HTMLElement);
    play.playing = true;
  });
  afterEach(() => vi.unstubAllGlobals());

  it("gives sound poses that say that a mouse made them", () => {
    const frames = [0, 14, 28].map((ms) => play.frame(ms));
    expect(frames.every(({ right_modality }) => right_modality === "mouse")).toBe(true);
    for (const pose of [frames[0]!.head!, frames[0]!.left!, frames[0]!.right!])
      expect(Math.hypot(...pose[1])).toBeCloseTo(1);
  });

  it("turns the head only while a button is held, and no further than a neck", () => {
    const still = play.frame(0).head!;
    view.send("pointermove", { buttons: 0, movementX: 50, movementY: 0 });
    expect(play.frame(10).head).toEqual(still);
    view.send("pointermove", { buttons: 1, movementX: -1e6, movementY: 1e6 });
    const turned = play.frame(20).head!;
    expect(turned[0]).toEqual(still[0]);
    const cosine = Math.abs(turned[1].reduce((sum, part, at) => sum + part * still[1][at]!, 0));
    expect(2 * Math.acos(cosine)).toBeLessThan(1.8);
    expect(2 * Math.acos(cosine)).toBeGreaterThan(1);
  });

  it("moves the right hand while a key is down, within reach", () => {
    const before = play.frame(0);
    expect(play.press("KeyW")).toBe(true);
    const after = play.frame(100);
    expect(after.right![0][2]).toBeLessThan(before.right![0][2] - 0.02);
    expect(after.left).toEqual(before.left);
    for (let ms = 200; ms < 20_000; ms += 100) play.frame(ms);
    const [x, y, z] = play.frame(20_000).right![0];
    expect(Math.hypot(x - 0.17, y - 0.98, z - 0.08)).toBeLessThan(0.63);
    page.send("keyup", { code: "KeyW" });
    const rest = play.frame(20_100).right![0][2];
    expect(play.frame(20_200).right![0][2]).toBeCloseTo(rest, 9);
  });

  it("leaves other keys, and all keys while nobody plays", () => {
    expect(play.press("KeyP")).toBe(false);
    play.playing = false;
    expect(play.press("KeyW")).toBe(false);
  });
});
