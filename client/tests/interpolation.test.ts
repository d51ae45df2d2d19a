import { Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { DELAY_S, POSE, StateBuffer, TELEPORT_M } from "../src/interpolation";
import type { State } from "../src/messages";

type Pose = [x: number, y: number, z: number, qw: number, qx: number, qy: number, qz: number];
const UPRIGHT = [1, 0, 0, 0] as const;

function state(sequence: number, timeS: number, ...poses: Pose[]): State {
  const bytes = new Uint8Array(new Float32Array(poses.flat()).buffer);
  return { type: "state", sequence, simulation_time_s: timeS, tracking_sequence: -1, joint_targets: bytes, held: [], poses: bytes };
}

function at(x: number): Pose {
  return [x, 0, 0, ...UPRIGHT];
}

function turned(angle: number): Pose {
  const { w, x, y, z } = new Quaternion().setFromAxisAngle(new Vector3(1, 2, -1).normalize(), angle);
  return [0, 0, 0, w, x, y, z];
}

function sampled(buffer: StateBuffer, timeS: number, bodies = 1): Float32Array {
  const out = new Float32Array(bodies * POSE);
  expect(buffer.sample(timeS, out)).toBe(true);
  return out;
}

function filled(...states: State[]): StateBuffer {
  const buffer = new StateBuffer(states[0]!.poses.byteLength / (POSE * 4));
  for (const one of states) expect(buffer.push(one, one.simulation_time_s)).toBe(true);
  return buffer;
}

describe("sampling by simulation time", () => {
  it("has nothing to draw before the first state", () => {
    expect(new StateBuffer(1).sample(0, new Float32Array(POSE))).toBe(false);
  });

  it("returns a state exactly at its own time", () => {
    const states = [0, 1, 2, 3].map((n) => state(n, 0.1 + 0.02 * n, turned(0.3 * n * n), at(0.1 * n)));
    const buffer = filled(...states);
    for (const one of states) {
      expect(sampled(buffer, one.simulation_time_s, 2)).toEqual(new Float32Array(one.poses.slice().buffer));
    }
  });

  it("moves linearly between states, whatever their distance in time", () => {
    const times = [0, 0.02, 0.05, 0.06, 0.1];
    const buffer = filled(...times.map((timeS, n) => state(n, timeS, at(2 * timeS))));
    for (let timeS = 0; timeS <= 0.1; timeS += 0.003)
      expect(sampled(buffer, timeS)[0]).toBeCloseTo(2 * timeS, 6);
  });

  it("stays at its ends outside of its states", () => {
    const buffer = filled(state(0, 1, at(1)), state(1, 1.02, at(1.1)));
    expect(sampled(buffer, 0)[0]).toBe(1);
    expect(sampled(buffer, 9)[0]).toBeCloseTo(1.1, 6);
  });

  it("turns at a constant rate and keeps quaternions unit", () => {
    const buffer = filled(state(0, 0, turned(0.2)), state(1, 1, turned(2.4)));
    for (let share = 0; share <= 1; share += 0.05) {
      const [, , , w, x, y, z] = sampled(buffer, share);
      expect(Math.hypot(w!, x!, y!, z!)).toBeCloseTo(1, 6);
      expect(2 * Math.acos(w!)).toBeCloseTo(0.2 + 2.2 * share, 5);
    }
  });

  it("takes the short way between opposite signs of one orientation", () => {
    const opposite = turned(0.4).map((value, n) => (n < 3 ? value : -value)) as Pose;
    const buffer = filled(state(0, 0, turned(0.2)), state(1, 1, opposite));
    expect(2 * Math.acos(sampled(buffer, 0.5)[3]!)).toBeCloseTo(0.3, 5);
  });

  it("does not draw a teleport's way, but that of the other bodies", () => {
    const far = TELEPORT_M + 0.01;
    const buffer = filled(state(0, 0, at(0), at(0)), state(1, 1, at(far), at(TELEPORT_M - 0.01)));
    const before = sampled(buffer, 0.999, 2);
    expect(before[0]).toBe(0);
    expect(before[POSE]).toBeGreaterThan(0.4);
    expect(sampled(buffer, 1, 2)[0]).toBeCloseTo(far, 6);
  });

  it("remembers enough for the delay after many states", () => {
    const buffer = filled(...Array.from({ length: 500 }, (_, n) => state(n, n / 100, at(n / 100))));
    expect(sampled(buffer, 4.99 - DELAY_S)[0]).toBeCloseTo(4.99 - DELAY_S, 5);
  });
});

describe("what is taken", () => {
  it("drops states that are old, repeated or of another scene", () => {
    const buffer = filled(state(5, 0.1, at(1)));
    expect(buffer.push(state(5, 0.1, at(2)), 0.1)).toBe(false);
    expect(buffer.push(state(4, 0.08, at(2)), 0.1)).toBe(false);
    expect(buffer.push(state(6, 0.12, at(2), at(2)), 0.12)).toBe(false);
    expect(sampled(buffer, 1)[0]).toBe(1);
  });

  it("starts anew when the simulation does", () => {
    const buffer = filled(state(0, 10, at(1)), state(1, 10.02, at(1)));
    expect(buffer.push(state(2, 0, at(0.2)), 10.04)).toBe(true);
    expect(sampled(buffer, 10)[0]).toBeCloseTo(0.2, 6);
  });

  it("shows the newest world while the simulation's time stands still", () => {
    const buffer = filled(state(0, 1, at(0)), state(1, 1.02, at(0.1)), state(2, 1.02, at(0.2)));
    expect(sampled(buffer, 1.02)[0]).toBeCloseTo(0.2, 6);
    expect(sampled(buffer, 1.01)[0]).toBeCloseTo(0.1, 6);
  });
});

describe("drawing by local time", () => {
  function drawnAfter(buffer: StateBuffer, nowS: number): number {
    const out = new Float32Array(POSE);
    buffer.drawn(nowS, out);
    return out[0]!;
  }

  it("stays the delay behind the newest state and goes on between states", () => {
    const buffer = new StateBuffer(1);
    for (let n = 0; n < 50; n++) buffer.push(state(n, n / 50, at(n / 50)), 100 + n / 50);
    expect(drawnAfter(buffer, 100.98)).toBeCloseTo(0.98 - DELAY_S, 5);
    expect(drawnAfter(buffer, 100.99)).toBeCloseTo(0.99 - DELAY_S, 5);
  });

  it("moves evenly although states come late", () => {
    const buffer = new StateBuffer(1);
    const late = (n: number) => (n % 3) * 0.008;
    for (let n = 0; n < 200; n++) buffer.push(state(n, n / 50, at(n / 50)), n / 50 + late(n));
    const step = drawnAfter(buffer, 3.99) - drawnAfter(buffer, 3.98);
    expect(step).toBeCloseTo(0.01, 5);
  });

  it("follows at once when the simulation has paused", () => {
    const buffer = filled(state(0, 1, at(0)), state(1, 1.02, at(0.02)));
    for (let n = 0; n < 10; n++) buffer.push(state(2 + n, 1.04 + n / 50, at(0.04 + n / 50)), 61 + n / 50);
    expect(drawnAfter(buffer, 61.18)).toBeCloseTo(0.22 - DELAY_S, 4);
  });
});
