import { describe, expect, it } from "vitest";
import { kinematics, solveArm } from "../../src/body/arm-solver";
import { fromQuaternion, fromEulerXYZ, multiplyTransposed, multiply, rotationVector, rotate, rotateInverse, toEulerXYZ } from "../../src/body/linear-algebra";
import { BodySolver, type BodyPose } from "../../src/body/body-solver";
import { solveSymmetric } from "../../src/body/linear-algebra";
import type { Skeleton } from "../../src/generated/messages";
import { seededRandom } from "../../src/scene/random";
import few from "../data/bodies.json";

/** As Python solves it; see `tests/helpers/vr/body_examples.py`. */
interface Example {
  skeleton: Skeleton;
  pose: BodyPose;
  start: number[];
  turn: number;
  angles: number[];
}

const ALIKE_RAD = 1e-5;
/** The few that are kept, or those that Python's tests have left in a file. */
const path = import.meta.env["VITE_BODIES"] as string | undefined;
const examples = (path ? JSON.parse(files().readFileSync(path, "utf8")) : few) as Example[];

/** Node's own, whose types the client does without. */
function files(): { readFileSync(path: string, encoding: string): string } {
  const { process } = globalThis as unknown as { process: { getBuiltinModule(name: string): unknown } };
  return process.getBuiltinModule("node:fs") as ReturnType<typeof files>;
}

function farthest({ skeleton, pose, start, turn, angles }: Example): number {
  const solved = new BodySolver(skeleton).solve(pose, Float64Array.from(start), turn);
  return Math.max(...solved.map((angle, joint) => Math.abs(angle - angles[joint]!)));
}

describe("the participant's own body", () => {
  it("has the very angles that the server gives it", () => {
    const apart = examples.map(farthest);
    console.log(`${apart.length} poses, at most ${Math.max(...apart)} rad apart`);
    expect(apart.flatMap((rad, number) => (rad < ALIKE_RAD ? [] : [number]))).toEqual([]);
    expect(examples.length).toBeGreaterThan(50);
  });

  it("brings the right hand where it is wanted", () => {
    const lengths = { upper: 0.264, fore: 0.261, hand: 0.0355 };
    const random = seededRandom(3);
    for (let n = 0; n < 200; n++) {
      const start = [0.2, -0.6, 0.1, -1.4, 0.1, 0.2, 0.1];
      const wanted = kinematics(lengths, start.map((angle) => angle + 0.4 * (random() - 0.5)));
      const found = kinematics(lengths, solveArm(lengths, wanted, start, 0.5));
      expect(Math.hypot(...found.position.map((x, at) => x - wanted.position[at]!))).toBeLessThan(1e-3);
      expect(Math.hypot(...rotationVector(found.axes, wanted.axes))).toBeLessThan(0.01);
    }
  });
});

describe("axes", () => {
  const random = seededRandom(5);
  const some = () => fromEulerXYZ(6 * random() - 3, 3 * random() - 1.5, 6 * random() - 3);

  it("give back the angles that they were made of", () => {
    for (let n = 0; n < 50; n++) {
      const angles = [6 * random() - 3, 3 * random() - 1.5, 6 * random() - 3] as const;
      toEulerXYZ(fromEulerXYZ(...angles)).forEach((angle, at) => expect(angle).toBeCloseTo(angles[at]!, 9));
    }
  });

  it("turn back what they turned", () => {
    for (let n = 0; n < 20; n++) {
      const [axes, vector] = [some(), [random(), random(), random()] as [number, number, number]];
      rotateInverse(axes, rotate(axes, vector)).forEach((x, at) => expect(x).toBeCloseTo(vector[at]!, 12));
    }
  });

  it("are a rotation vector apart", () => {
    for (let n = 0; n < 20; n++) {
      const [from, to] = [some(), some()];
      const vector = rotationVector(from, to);
      const half = 0.5 * Math.hypot(...vector);
      const scale = Math.sin(half) / (2 * half);
      const q = [Math.cos(half), ...vector.map((x) => scale * x)] as [number, number, number, number];
      multiply(fromQuaternion(q), from).forEach((entry, at) =>
        expect(entry).toBeCloseTo(to[at]!, 9),
      );
      expect(multiplyTransposed(from, from)[0]).toBeCloseTo(1, 12);
    }
  });
});

describe("symmetric equations", () => {
  it("are solved", () => {
    const a = [
      [4, 1, 0.5],
      [1, 3, -0.2],
      [0.5, -0.2, 2],
    ];
    const x = solveSymmetric(a, [1, 2, 3]);
    a.forEach((row, i) => expect(row.reduce((sum, entry, j) => sum + entry * x[j]!, 0)).toBeCloseTo(i + 1, 12));
  });
});
