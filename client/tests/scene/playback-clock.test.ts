import { describe, expect, it } from "vitest";
import { TICK_S } from "../../src/generated/messages";
import { MAX_RATE_CHANGE, SKIP_DELAY_S, MAX_DELAY_S, Playback } from "../../src/scene/playback-clock";
import { seededRandom } from "../../src/scene/random";

const START_S = 5000;
const FRAME_S = 1 / 90;
/** What drawing this far behind the newest state that could be here would cost on loopback, at most. */
const NEAR_S = 0.015;

interface Picture {
  nowS: number;
  newestS: number;
  drawnS: number;
}

/** When the state of tick `n` has come, how late; states overtake nobody. */
type Late = (n: number) => number;

/** All pictures of some seconds; each has the states that came until then. */
function pictures(seconds: number, late: Late, frameS: (frame: number) => number = () => FRAME_S): Picture[] {
  const playback = new Playback();
  const shown: Picture[] = [];
  let [tick, cameS] = [0, 0];
  const comes = (n: number) => Math.max(cameS, n * TICK_S + late(n));
  for (let [nowS, frame] = [late(0), 0]; nowS < seconds; nowS += frameS(frame++)) {
    for (; comes(tick + 1) <= nowS; tick++) cameS = comes(tick + 1);
    const newestS = tick * TICK_S;
    shown.push({ nowS, newestS, drawnS: playback.advance(START_S + nowS, newestS) });
  }
  return shown;
}

function jitter(mostS: number, seed = 1): Late {
  const random = seededRandom(seed);
  return () => 0.001 + mostS * random();
}

/** A few come far too late, and all behind them, as over a radio that repeats what was lost. */
function hiccups(mostS: number, share: number): Late {
  const random = seededRandom(3);
  return () => (random() < share ? mostS : 0.002 * random());
}

function pauseAt(n: number, lastsS: number): Late {
  return (tick) => (tick >= n && tick < n + lastsS / TICK_S ? lastsS - (tick - n) * TICK_S : 0) + 0.001;
}

const WAYS: Record<string, Late> = {
  loopback: jitter(0.001),
  "a good radio": jitter(0.01),
  "a bad radio": jitter(0.08),
  bursts: (n) => (10 - (n % 10)) * TICK_S,
  hiccups: hiccups(0.15, 0.02),
  "a pause": pauseAt(300, 1),
  "half the states": (n) => (n % 2 ? TICK_S : 0),
  "a simulation that lost a second": (n) => (n < 300 ? 0.001 : 1.001),
  "a simulation that loses a tenth of its time": (n) => 0.1 * n * TICK_S,
  "clocks that drift by 200 ppm": (n) => 0.01 + 2e-4 * n * TICK_S,
};
const FRAMES: Record<string, (frame: number) => number> = {
  "90 Hz": () => FRAME_S,
  "72 Hz": () => 1 / 72,
  "a page that stutters": (frame) => (frame % 50 ? FRAME_S : 0.3),
  "a slow page": () => 0.04,
};

function behindS(shown: Picture[]): number[] {
  return shown.map(({ nowS, drawnS }) => nowS - drawnS);
}

function after(shown: Picture[], fromS: number): Picture[] {
  return shown.filter(({ nowS }) => nowS >= fromS);
}

describe.each(Object.entries(WAYS))("over %s", (_, late) => {
  it.each(Object.entries(FRAMES))("at %s, pictures go on and are never ahead of the states", (_, frameS) => {
    let before = -Infinity;
    let freshest = -Infinity;
    for (const { nowS, newestS, drawnS } of pictures(7, late, frameS)) {
      freshest = Math.max(freshest, newestS - nowS);
      expect(drawnS).toBeLessThanOrEqual(newestS);
      expect(newestS - drawnS).toBeLessThan(MAX_DELAY_S + SKIP_DELAY_S + 0.1);
      expect(drawnS).toBeGreaterThanOrEqual(before);
      if (newestS - nowS > freshest - 0.01)
        expect(nowS + freshest - drawnS).toBeLessThan(MAX_DELAY_S + SKIP_DELAY_S);
      before = drawnS;
    }
  });
});

describe("how far behind", () => {
  it.each([
    ["72 Hz", 1 / 72],
    ["80 Hz", 1 / 80],
    ["90 Hz", 1 / 90],
    ["120 Hz", 1 / 120],
    ["25 Hz", 1 / 25],
  ])("is at most 15 ms on loopback, at %s", (_, frameS) => {
    const shown = after(pictures(20, jitter(0.001), () => frameS), 1);
    expect(Math.max(...behindS(shown))).toBeLessThan(NEAR_S);
  });

  it("grows as far as the network jitters, and no farther", () => {
    for (const mostS of [0.005, 0.02, 0.05]) {
      const behind = behindS(after(pictures(20, jitter(mostS)), 5));
      expect(Math.max(...behind)).toBeLessThan(mostS + NEAR_S);
    }
  });

  it("stays bounded where states come a second apart", () => {
    const shown = pictures(30, (n) => (100 - (n % 100)) * TICK_S);
    for (const { nowS, newestS, drawnS } of after(shown, 3)) {
      expect(nowS - drawnS).toBeLessThan(1 + MAX_DELAY_S + SKIP_DELAY_S);
      expect(newestS - drawnS).toBeLessThan(MAX_DELAY_S + SKIP_DELAY_S);
    }
  });

  it.each(["bad radio", "pause"])("is as before soon after a %s", (trouble) => {
    const bad = trouble === "pause" ? pauseAt(500, 1) : jitter(0.1);
    const good = jitter(0.001);
    const shown = pictures(15, (n) => (n >= 500 && n < 700 ? bad(n) : good(n)));
    expect(Math.max(...behindS(after(shown, 12)))).toBeLessThan(NEAR_S);
  });

  it("does not grow for a single hiccup", () => {
    const shown = pictures(10, (n) => (n === 500 ? 0.03 : 0.001));
    expect(Math.max(...behindS(after(shown, 5.2)))).toBeLessThan(NEAR_S + 0.005);
  });
});

describe("pictures", () => {
  it.each(["loopback", "a good radio", "bursts"])("move evenly over %s once the delay is found", (way) => {
    const shown = after(pictures(20, WAYS[way]!), 6);
    const steps = shown.slice(1).map(({ drawnS }, n) => (drawnS - shown[n]!.drawnS) / FRAME_S);
    const uneven = steps.filter((step) => Math.abs(step - 1) > MAX_RATE_CHANGE + 1e-6);
    expect(uneven.length / steps.length).toBeLessThan(0.03);
  });
});
