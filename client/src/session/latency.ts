import type { Latency, TrackingFrameTimes } from "../generated/messages";
import type { WorldState } from "./state-decoder";
import type { FrameTimes } from "../tracking/pose-reader";

const SEND_INTERVAL_MS = 1000;
/** Number of recent frames for clock alignment: ten seconds at 90 Hz. */
const CLOCK_SAMPLES = 900;
/** Maximum duration of a stage that the server accepts. */
const MAX_MS = 60_000;
/** Maximum number of frames in a message. */
const MAX_FRAMES = 256;

/** The times of one frame, by the client's clock, and in the server by the server's clock; milliseconds. */
interface FrameJourney extends FrameTimes {
  sequence: number;
  receivedMs: number;
  simulatedMs: number;
  leftMs: number;
  cameMs: number;
  simulationTimeS: number;
  drawnMs: number;
}

/** Measures the latency from tracking to display by stage. */
export class LatencyMeter {
  private passed: TrackingFrameTimes | null = null;
  private waiting: FrameJourney[] = [];
  private drawn: FrameJourney[] = [];
  private toldMs = 0;
  private readonly ways: { upMs: number; downMs: number }[] = [];

  /** `times` returns when a frame was read and sent. */
  constructor(private readonly times: (sequence: number) => FrameTimes | null) {}

  /** The next state is the first that includes this frame. */
  announce(passed: TrackingFrameTimes): void {
    this.passed = passed;
  }

  onState({ tracking_sequence, simulation_time_s }: WorldState, cameMs: number): void {
    const { passed } = this;
    this.passed = null;
    const times = passed?.tracking_sequence === tracking_sequence ? this.times(tracking_sequence) : null;
    if (!passed || !times) return;
    const [receivedMs, simulatedMs, leftMs] = [passed.received_s, passed.simulated_s, passed.sent_s].map(
      (seconds) => 1000 * seconds,
    ) as [number, number, number];
    this.ways.push({ upMs: receivedMs - times.sentMs, downMs: cameMs - leftMs });
    if (this.ways.length > CLOCK_SAMPLES) this.ways.shift();
    this.waiting.push({
      ...{ ...times, sequence: tracking_sequence, receivedMs, simulatedMs, leftMs, cameMs },
      ...{ simulationTimeS: simulation_time_s, drawnMs: NaN },
    });
    if (this.waiting.length > MAX_FRAMES) this.waiting.shift();
  }

  /** Notes that a frame with this simulation time was drawn. */
  pictureDrawn(simulationTimeS: number, nowMs: number): void {
    const isShown = (journey: FrameJourney) => journey.simulationTimeS <= simulationTimeS;
    for (const journey of this.waiting) if (isShown(journey)) this.drawn.push({ ...journey, drawnMs: nowMs });
    this.waiting = this.waiting.filter((journey) => !isShown(journey));
  }

  /** The message of the last second when it is due. */
  take(nowMs: number): Latency | null {
    if (nowMs < this.toldMs + SEND_INTERVAL_MS || this.drawn.length === 0) return null;
    const journeys = this.drawn.slice(-MAX_FRAMES);
    this.toldMs = nowMs;
    this.drawn = [];
    return latencyOf(journeys, this.serverAheadMs());
  }

  /** The offset of the server's clock, assuming equal minimum delays in both directions. */
  private serverAheadMs(): number {
    const least = (way: "upMs" | "downMs") => Math.min(...this.ways.map((each) => each[way]));
    return (least("upMs") - least("downMs")) / 2;
  }
}

function latencyOf(journeys: FrameJourney[], aheadMs: number): Latency {
  const stage = (took: (journey: FrameJourney) => number) =>
    journeys.map((journey) => Math.min(Math.max(took(journey), 0), MAX_MS));
  return {
    type: "latency",
    sequence: journeys.map(({ sequence }) => sequence),
    sample_ms: stage(({ readMs, sentMs }) => sentMs - readMs),
    up_ms: stage(({ sentMs, receivedMs }) => receivedMs - aheadMs - sentMs),
    simulate_ms: stage(({ receivedMs, simulatedMs }) => simulatedMs - receivedMs),
    send_ms: stage(({ simulatedMs, leftMs }) => leftMs - simulatedMs),
    down_ms: stage(({ leftMs, cameMs }) => cameMs - (leftMs - aheadMs)),
    draw_ms: stage(({ cameMs, drawnMs }) => drawnMs - cameMs),
  };
}
