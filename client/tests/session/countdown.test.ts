import { describe, expect, it } from "vitest";
import { Countdown } from "../../src/session/countdown";

describe("the countdown of a phase", () => {
  it("shows whole seconds until the end, and reports when the number changes", () => {
    const countdown = new Countdown();
    countdown.begin(2, 1000);
    expect(countdown.secondsLeft).toBe(2);
    expect(countdown.advance(1900)).toBe(false);
    expect([countdown.advance(2100), countdown.secondsLeft]).toEqual([true, 1]);
    expect([countdown.advance(3000), countdown.secondsLeft]).toEqual([true, null]);
  });

  it("is absent in a phase without an end", () => {
    const countdown = new Countdown();
    countdown.begin(2, 0);
    countdown.begin(null, 100);
    expect([countdown.advance(200), countdown.secondsLeft]).toEqual([false, null]);
  });
});
