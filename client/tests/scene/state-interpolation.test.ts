import { Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { POSE, StateBuffer, TELEPORT_M } from "../../src/scene/state-interpolation";
import { MAX_DELAY_S } from "../../src/scene/playback-clock";
import type { WorldState } from "../../src/session/state-decoder";

type Pose = [x: number, y: number, z: number, qw: number, qx: number, qy: number, qz: number];
const UPRIGHT = [1, 0, 0, 0] as const;

function state(sequence: number, timeS: number, ...poses: Pose[]): WorldState {
  const numbers = new Float32Array(poses.flat());
  return { sequence, simulation_time_s: timeS, tracking_sequence: -1, joint_targets: new Float64Array(), deviating_parts: [], poses: numbers };
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

function filled(...states: WorldState[]): StateBuffer {
  const buffer = new StateBuffer(states[0]!.poses.length / POSE);
  for (const one of states) expect(buffer.push(one)).toBe(true);
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
      expect(sampled(buffer, one.simulation_time_s, 2)).toEqual(one.poses);
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
    const oldest = 4.99 - MAX_DELAY_S;
    expect(sampled(buffer, oldest)[0]).toBeCloseTo(oldest, 5);
  });
});

describe("what is taken", () => {
  it("drops states that are old, repeated or of another scene", () => {
    const buffer = filled(state(5, 0.1, at(1)));
    expect(buffer.push(state(5, 0.1, at(2)))).toBe(false);
    expect(buffer.push(state(4, 0.08, at(2)))).toBe(false);
    expect(buffer.push(state(6, 0.12, at(2), at(2)))).toBe(false);
    expect(sampled(buffer, 1)[0]).toBe(1);
  });

  it("restarts with the simulation", () => {
    const buffer = filled(state(0, 10, at(1)), state(1, 10.02, at(1)));
    expect(buffer.push(state(2, 0, at(0.2)))).toBe(true);
    expect(sampled(buffer, 10)[0]).toBeCloseTo(0.2, 6);
  });

  it("shows the newest world while the simulation's time stands still", () => {
    const buffer = filled(state(0, 1, at(0)), state(1, 1.02, at(0.1)), state(2, 1.02, at(0.2)));
    expect(sampled(buffer, 1.02)[0]).toBeCloseTo(0.2, 6);
    expect(sampled(buffer, 1.01)[0]).toBeCloseTo(0.1, 6);
  });
});

describe("drawing by local time", () => {
  it("draws nothing before the first state, then between states by the clock of playback", () => {
    const buffer = new StateBuffer(1);
    const out = new Float32Array(POSE);
    expect(buffer.draw(100, out)).toBe(false);
    for (let n = 0; n < 100; n++) {
      buffer.push(state(n, n / 100, at(n / 100)));
      expect(buffer.draw(100 + n / 100, out)).toBe(true);
      expect(out[0]).toBeCloseTo(Math.max(buffer.drawnTimeS, 0), 6);
    }
    expect(buffer.drawnTimeS).toBeGreaterThan(0.97);
  });

  it("resets with the simulation", () => {
    const buffer = filled(state(0, 10, at(1)));
    buffer.draw(1, new Float32Array(POSE));
    buffer.push(state(1, 0.5, at(0.2)));
    buffer.draw(1.01, new Float32Array(POSE));
    expect(buffer.drawnTimeS).toBeLessThanOrEqual(0.5);
  });
});
