import { Euler, Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { DEVICES } from "../../src/generated/body-model";
import { NO_TRACKED_HANDS, type TrackedHands } from "../../src/body/bare-hands";
import type { Side } from "../../src/body/body-solver";
import { standingMiddle } from "../../src/input/stop-sign";
import { StopGestures, type VrStopMethod } from "../../src/input/stop-gestures";
import { handJoints, placed } from "../helpers/hand-joints";
import KEPT from "../data/motions.json";

/**
 * How simulated participants move at rest, while robots help them and after: `tests/helpers/vr/motion_examples.py` writes
 * it. Of each frame head, left and right hand: positions in millimetres, quaternions in thousandths.
 */
type Motion = (typeof KEPT)[number];
/** Those that are kept, or more in a file. */
const path = import.meta.env["VITE_MOTIONS"] as string | undefined;
const MOTIONS: Motion[] = path ? (JSON.parse(files().readFileSync(path, "utf8")) as Motion[]) : KEPT;
const SECONDS = MOTIONS.reduce((sum, { frames, everyMs }) => sum + (frames.length * everyMs) / 1000, 0);

/** Node's own, whose types the client does without. */
function files(): { readFileSync(path: string, encoding: string): string } {
  const { process } = globalThis as unknown as { process: { getBuiltinModule(name: string): unknown } };
  return process.getBuiltinModule("node:fs") as ReturnType<typeof files>;
}

const FORWARD = new Vector3(0, 0, -1);
/** As long as a press is that means something else, milliseconds. */
const LONGEST_PRESS_MS = 400;

interface WorldMotion {
  place: Vector3;
  turn: Quaternion;
}

function poseAt(frame: readonly number[], part: 0 | 1 | 2): WorldMotion {
  const [x, y, z, ...q] = frame.slice(7 * part, 7 * part + 7).map((number) => number / 1000) as [number, number, number, ...number[]];
  return { place: new Vector3(x, y, z), turn: new Quaternion(...(q as [number, number, number, number])).normalize() };
}

const BODY_AXES = quaternionOf(DEVICES.body_from_device_q);
const SYNTHETIC_FROM_WRIST = new Quaternion().setFromAxisAngle(new Vector3(1, 0, 0), -Math.PI / 2);

/** How a bare hand is turned where a controller's grip is turned so. */
function handTurn(side: Side, grip: Quaternion): Quaternion {
  const wrist = grip.clone().multiply(BODY_AXES).multiply(quaternionOf(DEVICES.hand_from_wrist_q[side]).invert());
  return wrist.multiply(SYNTHETIC_FROM_WRIST);
}

function quaternionOf([w, x, y, z]: readonly number[]): Quaternion {
  return new Quaternion(x, y, z, w);
}

/** Nobody holds a hand just as another: so much may each be turned about each axis. */
const TURNS = [-40, 0, 40].flatMap((x) =>
  [-40, 0, 40].flatMap((y) =>
    [-40, 0, 40].map((z) => new Quaternion().setFromEuler(new Euler(...([x, y, z].map((angle) => (angle * Math.PI) / 180) as [number, number, number])))),
  ),
);

/** All stops in a motion with some input sources; `hands` are those of a frame. */
function stopsIn(
  { frames, everyMs }: Motion,
  sources: XRInputSource[],
  hands: (frame: readonly number[]) => TrackedHands = () => NO_TRACKED_HANDS,
  before: (session: EventTarget, nowMs: number) => void = () => undefined,
): VrStopMethod[] {
  const [session, stopping] = [new EventTarget(), new StopGestures()];
  stopping.listen(session as XRSession);
  let sign: Vector3 | null = null;
  return frames.flatMap((frame, at) => {
    const { place: eyes, turn } = poseAt(frame, 0);
    if (at % 25 === 0) sign = standingMiddle(eyes, turn);
    before(session, at * everyMs);
    const gaze = FORWARD.clone().applyQuaternion(turn);
    const method = stopping.watch({ sources, eyes, gaze, hands: hands(frame), sign }, true, at * everyMs);
    return method ? [method] : [];
  });
}

function source(has: object): XRInputSource {
  return { profiles: [], targetRayMode: "tracked-pointer", handedness: "right", ...has } as unknown as XRInputSource;
}

describe("by accident", () => {
  it("no participant looks at the stop sign for a second, wherever they looked when it appeared", () => {
    const stops = MOTIONS.flatMap((motion) => stopsIn(motion, []));
    console.info(`${stops.length} stops by gaze in ${MOTIONS.length} sessions, ${SECONDS.toFixed(0)} s`);
    expect(stops).toEqual([]);
  });

  it.each([0, 0.2, 0.5])("no participant raises a palm, with an open hand that is turned by up to 40° about each axis; fingers bent by %f", (bent) => {
    const open = { left: handJoints("left", bent), right: handJoints("right", bent) };
    const hand = (side: Side, { place, turn }: WorldMotion, to: Quaternion) => placed(open[side], place, handTurn(side, turn).multiply(to));
    const stops = TURNS.flatMap((to) =>
      MOTIONS.flatMap((motion) =>
        stopsIn(motion, [source({ hand: new Map() })], (frame) => ({
          left: hand("left", poseAt(frame, 1), to),
          right: hand("right", poseAt(frame, 2), to),
        })),
      ),
    );
    console.info(`${stops.length} stops by palm in ${TURNS.length} times ${SECONDS.toFixed(0)} s`);
    expect(stops).toEqual([]);
  });

  it.each([1, 2])("no participant with %i controllers presses for so long, who presses all the time", (count) => {
    const sources = Array.from({ length: count }, () => source({}));
    let seed = count;
    const random = () => (seed = (seed * 48271) % 2147483647) / 2147483647;
    const stops = MOTIONS.flatMap((motion) => {
      const until = new Map<string, number>();
      return stopsIn(motion, sources, undefined, (session, nowMs) => {
        for (const [at, inputSource] of sources.entries())
          for (const kind of ["select", "squeeze"]) {
            const name = `${kind}${at}`;
            const ends = until.get(name);
            if (ends === undefined && random() < 0.5) {
              until.set(name, nowMs + LONGEST_PRESS_MS * random());
              session.dispatchEvent(Object.assign(new Event(`${kind}start`), { inputSource }));
            } else if (ends !== undefined && nowMs >= ends) {
              until.delete(name);
              session.dispatchEvent(Object.assign(new Event(`${kind}end`), { inputSource }));
            }
          }
      });
    });
    console.info(`${stops.length} stops by ${count} controllers in ${SECONDS.toFixed(0)} s`);
    expect(stops).toEqual([]);
  });
});
