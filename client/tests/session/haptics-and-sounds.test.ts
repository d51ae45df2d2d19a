import { describe, expect, it, vi } from "vitest";
import type { HapticAndAudioFeedback } from "../../src/generated/messages";
import { Senses } from "../../src/session/haptics-and-sounds";

const felt = (left_touched: boolean, right_touched: boolean, events = 0): HapticAndAudioFeedback => ({
  type: "feedback",
  left_touched,
  right_touched,
  events,
});

describe("touches", () => {
  it("are felt in the touched hand once, when they begin", () => {
    const pulse = vi.fn();
    const senses = new Senses(pulse, () => ({ haptics: true, sounds: false }));
    for (const touch of [felt(false, true), felt(false, true), felt(true, true), felt(false, false)])
      senses.take(touch);
    senses.take(felt(false, true));
    expect(pulse.mock.calls.map(([hand]) => hand)).toEqual(["right", "left", "right"]);
  });

  it("cause no vibration when haptics are disabled", () => {
    const pulse = vi.fn();
    const senses = new Senses(pulse, () => ({ haptics: false, sounds: true }));
    senses.take(felt(true, true));
    expect(pulse).not.toHaveBeenCalled();
  });
});

describe("successes", () => {
  function listen(sounds: boolean): number {
    const started = vi.fn();
    class Oscillator {
      connect = vi.fn();
      stop = vi.fn();
      start = started;
    }
    const gain = { setValueAtTime: vi.fn(), exponentialRampToValueAtTime: vi.fn() };
    class Audio {
      state = "running";
      currentTime = 0;
      resume = () => Promise.resolve();
      createGain = () => ({ gain, connect: vi.fn() });
    }
    vi.stubGlobal("AudioContext", Audio);
    vi.stubGlobal("OscillatorNode", Oscillator);
    const senses = new Senses(vi.fn(), () => ({ haptics: true, sounds }));
    senses.take(felt(false, false, 1));
    expect(started).not.toHaveBeenCalled();
    senses.wake();
    senses.take(felt(false, false, 0));
    expect(started).not.toHaveBeenCalled();
    senses.take(felt(false, false, 3));
    vi.unstubAllGlobals();
    return started.mock.calls.length;
  }

  it("are heard after a press, if they are wanted", () => {
    expect(listen(true)).toBeGreaterThan(0);
    expect(listen(false)).toBe(0);
  });
});
