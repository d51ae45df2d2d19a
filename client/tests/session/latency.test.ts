import { describe, expect, it } from "vitest";
import { LatencyMeter } from "../../src/session/latency";
import type { Latency } from "../../src/generated/messages";
import type { WorldState } from "../../src/session/state-decoder";

/** The server's clock is ahead by this. */
const AHEAD_MS = 123_456;

/** Stages of one frame, milliseconds. */
interface Stages {
  sample: number;
  up: number;
  simulate: number;
  send: number;
  down: number;
  draw: number;
}

function told(frames: Stages[]): Latency[] {
  const times = new Map<number, { readMs: number; sentMs: number }>();
  const meter = new LatencyMeter((sequence) => times.get(sequence) ?? null);
  return frames.flatMap((stages, sequence) => {
    const readMs = 5000 + 20 * sequence;
    const sentMs = readMs + stages.sample;
    const receivedMs = sentMs + stages.up;
    const simulatedMs = receivedMs + stages.simulate;
    const leftMs = simulatedMs + stages.send;
    const cameMs = leftMs + stages.down;
    times.set(sequence, { readMs, sentMs });
    const [received_s, simulated_s, sent_s] = [receivedMs, simulatedMs, leftMs].map((ms) => (ms + AHEAD_MS) / 1000);
    meter.announce({ type: "passed", tracking_sequence: sequence, received_s: received_s!, simulated_s: simulated_s!, sent_s: sent_s! });
    meter.onState({ tracking_sequence: sequence, simulation_time_s: sequence } as WorldState, cameMs);
    meter.pictureDrawn(sequence - 0.5, cameMs + stages.draw / 2);
    meter.pictureDrawn(sequence, cameMs + stages.draw);
    const latency = meter.take(cameMs + stages.draw);
    return latency ? [latency] : [];
  });
}

const STAGES: Stages = { sample: 1, up: 4, simulate: 8, send: 0.5, down: 4, draw: 45 };

describe("how late pictures are", () => {
  it("is measured by stage, independent of the server's clock", () => {
    const all = told(Array.from({ length: 200 }, (_, n) => ({ ...STAGES, up: 4 + (n % 7), down: 4 + (n % 5) })));
    expect(all.length).toBeGreaterThan(2);
    for (const { sequence, up_ms, down_ms, ...stages } of all.slice(1)) {
      up_ms.forEach((ms, at) => expect(ms).toBeCloseTo(4 + (sequence[at]! % 7), 3));
      down_ms.forEach((ms, at) => expect(ms).toBeCloseTo(4 + (sequence[at]! % 5), 3));
      stages.sample_ms.forEach((ms) => expect(ms).toBeCloseTo(1, 3));
      stages.simulate_ms.forEach((ms) => expect(ms).toBeCloseTo(8, 3));
      stages.send_ms.forEach((ms) => expect(ms).toBeCloseTo(0.5, 3));
      stages.draw_ms.forEach((ms) => expect(ms).toBeCloseTo(45, 3));
    }
    const sequences = all.flatMap(({ sequence }) => sequence);
    expect(sequences).toEqual(sequences.map((_, n) => n));
  });

  it("is never told as less than nothing", () => {
    const all = told(Array.from({ length: 120 }, (_, n) => ({ ...STAGES, sample: -1, up: n % 2 ? 1 : 30 })));
    for (const { type: _, sequence: __, ...stages } of all)
      for (const stage of Object.values(stages)) expect(Math.min(...stage)).toBeGreaterThanOrEqual(0);
  });

  it("is not known of a state that nobody announced, or of a frame that nobody remembers", () => {
    const meter = new LatencyMeter(() => null);
    meter.announce({ type: "passed", tracking_sequence: 3, received_s: 1, simulated_s: 1, sent_s: 1 });
    meter.onState({ tracking_sequence: 3, simulation_time_s: 1 } as WorldState, 2000);
    meter.onState({ tracking_sequence: 4, simulation_time_s: 1 } as WorldState, 2000);
    meter.pictureDrawn(2, 2010);
    expect(meter.take(9000)).toBeNull();
  });
});
