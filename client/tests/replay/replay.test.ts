import { describe, expect, it } from "vitest";
import { points, rangeOf, successes } from "../../src/replay/chart";
import { Clock, SPEEDS } from "../../src/replay/replay-clock";
import { latest, phasesOf, robotsPart, type Timeline } from "../../src/replay/replay-data";
import { Frames } from "../../src/replay/recorded-frames";
import { unpackPoses } from "../../src/replay/packed-trials";
import { timelineEntries, simulatedText } from "../../src/replay/replay-texts";

const TIMES = [0, 0.02, 0.04];

/** One body that moves along x by 0.1 m from frame to frame, unturned. */
function moving(): Float32Array {
  return new Float32Array(TIMES.flatMap((_, at) => [0.1 * at, 0, 0, 1, 0, 0, 0]));
}

function sampled(timeS: number): number[] {
  const out = new Float32Array(7);
  new Frames(TIMES, moving()).sample(timeS, out);
  return [...out].map((value) => Number(value.toFixed(6)));
}

describe("frames", () => {
  it("are given as recorded at their own times", () => {
    TIMES.forEach((timeS, at) => expect(sampled(timeS)[0]).toBeCloseTo(0.1 * at));
  });

  it("are blended between two times, and stay as they are outside", () => {
    expect(sampled(0.03)).toEqual([0.15, 0, 0, 1, 0, 0, 0]);
    expect(sampled(-1)).toEqual(sampled(0));
    expect(sampled(9)).toEqual(sampled(0.04));
  });
});

describe("the latest of ascending times", () => {
  it("is the one that is not after", () => {
    for (const timeS of [-1, 0, 0.01, 0.02, 0.03, 0.04, 5]) {
      expect(latest(TIMES, timeS)).toBe(TIMES.filter((each) => each <= timeS).length - 1);
    }
    expect(latest([], 1)).toBe(-1);
  });
});

describe("the clock", () => {
  it("moves on by what has passed times its speed, only while it plays", () => {
    const clock = new Clock({ from: 0, to: 10 });
    clock.tick(1000);
    clock.tick(2000);
    expect(clock.timeS).toBe(0);
    clock.toggle();
    clock.speed = 0.25;
    clock.tick(4000);
    expect(clock.timeS).toBe(0.5);
    clock.toggle();
    clock.tick(9000);
    expect(clock.timeS).toBe(0.5);
  });

  it("rests at the end and begins again from there", () => {
    const clock = new Clock({ from: 0, to: 1 });
    clock.toggle();
    clock.tick(0);
    clock.tick(5000);
    expect([clock.timeS, clock.playing]).toEqual([1, false]);
    clock.toggle();
    expect([clock.timeS, clock.playing]).toEqual([0, true]);
  });

  it("stays within the trial and within its speeds", () => {
    const clock = new Clock({ from: 0, to: 3 });
    clock.seek(-1);
    expect(clock.timeS).toBe(0);
    clock.seek(99);
    expect(clock.timeS).toBe(3);
    for (const _ of SPEEDS) clock.change(1);
    expect(clock.speed).toBe(4);
    for (const _ of SPEEDS) clock.change(-1);
    expect(clock.speed).toBe(0.25);
  });
});

describe("a part of a trial", () => {
  it("confines the clock, which begins again where the part does", () => {
    const clock = new Clock({ from: 0, to: 10 });
    clock.confine({ from: 2, to: 4 });
    expect(clock.timeS).toBe(2);
    clock.toggle();
    clock.tick(0);
    clock.tick(9000);
    expect([clock.timeS, clock.playing]).toEqual([4, false]);
    clock.toggle();
    expect(clock.timeS).toBe(2);
    clock.confine({ from: 0, to: 10 });
    clock.seek(0);
    expect(clock.timeS).toBe(0);
  });

  it("fills the chart", () => {
    expect(points([0, 2, 3, 4], [0, 0, 1, 1], { from: 2, to: 4 }, [0, 1])).toBe(
      "-1000.0,96.0 0.0,96.0 500.0,4.0 1000.0,4.0",
    );
  });

  it("is the robot's where it helps in any of the trials", () => {
    const trial = (from: number, to: number) => ({
      events: [
        { time_s: 0, kind: "free_before", text: "free before" },
        { time_s: from, kind: "trial", text: "trial" },
        { time_s: to, kind: "free_after", text: "free after" },
      ],
      seconds: 9,
    });
    const timelines = (...of: [number, number][]) => of.map(([from, to]) => trial(from, to)) as unknown as Timeline[];
    expect(robotsPart(timelines([2, 5], [2, 6]))).toEqual({ from: 2, to: 6 });
    expect(robotsPart([{ events: [], seconds: 3 } as unknown as Timeline])).toBeNull();
  });
});

describe("phases", () => {
  it("end where the next begins, the last with the recording; answers are none", () => {
    const events = [
      { time_s: 0, kind: "free_before", text: "free before" },
      { time_s: 2, kind: "trial", text: "trial" },
      { time_s: 3, kind: "answer", text: "L1: 4" },
    ];
    const found = phasesOf({ events, seconds: 5 } as Timeline);
    expect(found).toEqual([
      { name: "free before", from: 0, to: 2 },
      { name: "trial", from: 2, to: 5 },
    ]);
  });
});

describe("a line of the chart", () => {
  it("spans the box from its lowest to its highest value, nought included", () => {
    const values = [0, 1, -1];
    expect(points([0, 5, 10], values, { from: 0, to: 10 }, rangeOf(values))).toBe("0.0,50.0 500.0,4.0 1000.0,96.0");
    expect(points([], [], { from: 0, to: 10 }, rangeOf([]))).toBe("");
    expect(rangeOf([2, 3])).toEqual([0, 3]);
  });
});

describe("success", () => {
  it("lasts until a control step says otherwise, or to the end", () => {
    const spans = (success: boolean[]) =>
      successes({ steps: { time_s: [1, 2, 3, 4], success } } as Timeline, 9);
    expect(spans([false, true, true, false])).toEqual([{ from: 2, to: 4 }]);
    expect(spans([true, false, false, true])).toEqual([
      { from: 1, to: 2 },
      { from: 4, to: 9 },
    ]);
    expect(spans([false, false, false, false])).toEqual([]);
  });
});

describe("packed poses", () => {
  it("add up to multiples of the step, each number of a frame for itself", () => {
    const numbers = new Int32Array([4, 1, -5, -300, 0, 70000]);
    const bytes = new Uint8Array(numbers.buffer);
    const planes = Uint8Array.from(bytes, (_, at) => bytes[4 * (at % 6) + Math.floor(at / 6)]!);
    expect([...unpackPoses(planes, 3, 0.5)]).toEqual([2, -150, 2.5, -150, 0, 34850]);
  });
});

describe("words", () => {
  const trial = (simulated: boolean) => ({ simulated, events: [] }) as unknown as Timeline;

  it("say who was simulated", () => {
    expect(simulatedText([trial(false)])).toBe("");
    expect(simulatedText([trial(true)])).toBe("Simulated participant");
    expect(simulatedText([trial(true), trial(true)])).toBe("Simulated participants");
    expect(simulatedText([trial(false), trial(true)])).toBe("B: simulated participant");
  });

  it("list what happened in two trials in the order of time", () => {
    const [one, other] = [[1, 4], [2, 3]].map((times) => ({
      events: times.map((time_s) => ({ time_s, kind: "event", text: "stop" })),
    })) as unknown as Timeline[];
    const entries = timelineEntries([one!, other!]).map(({ label, time_s }) => `${label}${time_s}`);
    expect(entries).toEqual(["A1", "B2", "B3", "A4"]);
  });
});
