import { Quaternion, Vector3 } from "three";
import { describe, expect, it } from "vitest";
import { ARM, DEVICES, PERSON } from "../../src/generated/body-model";
import { BodySolver, type BodyPose, type JointAngles, type Pose } from "../../src/body/body-solver";
import { chainsOf, drawChain } from "../../src/body/kinematic-chain";
import { POSE } from "../../src/scene/state-interpolation";
import { bodyPose } from "../../src/body/body-pose";
import type { Modality, TrackedBodyPart, Scene, XRPose } from "../../src/generated/messages";
import { BLEND_MS, ParticipantBody } from "../../src/body/participant-body";
import type { WorldState } from "../../src/session/state-decoder";
import { Hands } from "../../src/tracking/modality-switch";
import { poseOf as xrPoseOf, type Poses } from "../../src/tracking/pose-reader";
import examples from "../data/bodies.json";

const { skeleton } = examples[0] as unknown as Scene;
const BODIES = ["torso", "head", ...["left", "right"].flatMap((side) => ["upper_arm", "forearm", "hand"].map((part) => `${side}_${part}`))]; // prettier-ignore
const SCENE = { skeleton, bodies: ["floor", ...BODIES.map((name) => PERSON.prefix + name)] } as unknown as Scene;
const FRAME_MS = 11;
/** So many frames the server's newest state is behind. */
const LATE = 7;

const REST = new Float64Array(20);
REST.set([0.14, -0.26, 0, -1.57, 0, 0, 0], PERSON.joints.right[0]);
REST.set([-0.14, -0.26, 0, -1.57, 0, 0, 0], PERSON.joints.left[0]);

/** The poses of all bodies with these joint angles. */
function simulated(angles: JointAngles): Float32Array {
  const poses = new Float32Array(SCENE.bodies.length * POSE);
  for (let at = 3; at < poses.length; at += POSE) poses[at] = 1;
  const [trunk, ...arms] = chainsOf(skeleton, SCENE.bodies);
  const [w, x, y, z] = skeleton.hips_q_w;
  const hips = { origin: new Vector3(...skeleton.hips_pos_w), turn: new Quaternion(x, y, z, w) };
  const torso = drawChain({ ...trunk, simulatedShare: 0 }, poses, angles, hips);
  for (const arm of arms) drawChain({ ...arm, simulatedShare: 0 }, poses, angles, torso);
  return poses;
}

function body(poses: Float32Array, name: string): { at: Vector3; turn: Quaternion } {
  const at = SCENE.bodies.indexOf(PERSON.prefix + name) * POSE;
  const [x, y, z, qw, qx, qy, qz] = poses.subarray(at, at + POSE);
  return { at: new Vector3(x, y, z), turn: new Quaternion(qx, qy, qz, qw) };
}

/** The centre of a part, so far along its z axis. */
function centre(poses: Float32Array, name: string, z: number): Pose {
  const { at, turn } = body(poses, name);
  const { x, y, z: qz, w } = turn;
  return { position: new Vector3(0, 0, z).applyQuaternion(turn).add(at).toArray(), q: [w, x, y, qz] };
}

const handOf = (poses: Float32Array, side: "left" | "right") => centre(poses, `${side}_hand`, -skeleton.hand_m);

function poseOf(angles: JointAngles): BodyPose {
  const poses = simulated(angles);
  return {
    head: centre(poses, "head", skeleton.head_centre_m),
    left: handOf(poses, "left"),
    right: handOf(poses, "right"),
  };
}

function apart(a: Pose, b: Pose): { m: number; deg: number } {
  const turn = (q: Pose["q"]) => new Quaternion(q[1], q[2], q[3], q[0]);
  const m = new Vector3(...a.position).distanceTo(new Vector3(...b.position));
  return { m, deg: (turn(a.q).angleTo(turn(b.q)) * 180) / Math.PI };
}

function state(targets: JointAngles, deviating: TrackedBodyPart[] = []): WorldState {
  return { joint_targets: targets, deviating_parts: deviating } as unknown as WorldState;
}

/** A person who waves both arms and leans, at up to 1.5 m/s. */
function waving(frame: number): JointAngles {
  const wave = Math.sin((frame * FRAME_MS) / 160);
  const angles = REST.slice();
  angles.set([0.15 * wave, 0.05 * wave, 0.02, 0.1, 0, 0.2 * wave]);
  for (const side of ["left", "right"] as const) {
    const [y, x, , elbow, forearm] = PERSON.joints[side];
    angles[y]! += (side === "left" ? -1 : 1) * (0.2 + 0.15 * wave);
    angles[x]! -= 0.4 + 0.4 * wave;
    angles[elbow]! += 0.3 * wave;
    angles[forearm]! += 0.3 * wave;
  }
  return angles;
}

/** The server's targets frame by frame, and its messages. */
function served(frames: number, moving: (frame: number) => JointAngles): { pose: BodyPose; targets: JointAngles }[] {
  const solver = new BodySolver(skeleton);
  let targets: JointAngles = REST;
  return Array.from({ length: frames }, (_, frame) => {
    const pose = poseOf(moving(frame));
    return { pose, targets: (targets = solver.solve(pose, targets, ARM.most_turn_rad)) };
  });
}

class Client {
  readonly own = new ParticipantBody(SCENE);
  private frames = 0;

  constructor() {
    this.own.rest();
  }

  /** What is drawn of a pose, over what is simulated for the server's targets of some frames ago. */
  draw(pose: BodyPose, targets: JointAngles, deviating: TrackedBodyPart[] = [], where: JointAngles = targets): Float32Array {
    this.own.take(state(targets, deviating));
    const poses = simulated(where);
    this.own.draw(poses, pose, FRAME_MS * this.frames++, LATE * FRAME_MS);
    return poses;
  }
}

describe("the participant's own arms", () => {
  it("are where the controllers are in the very frame, however late the server is", () => {
    const client = new Client();
    const way = served(150, waving);
    let latest = 0;
    way.forEach(({ pose }, frame) => {
      const { targets } = way[Math.max(frame - LATE, 0)]!;
      const poses = client.draw(pose, targets);
      if (frame * FRAME_MS < BLEND_MS + 30) return;
      for (const side of ["left", "right"] as const) {
        const { m, deg } = apart(handOf(poses, side), pose[side]!);
        expect(m).toBeLessThan(0.01);
        expect(deg).toBeLessThan(3);
        latest = Math.max(latest, apart(handOf(simulated(targets), side), pose[side]!).m);
      }
    });
    expect(latest).toBeGreaterThan(0.05);
  });

  it("move as smoothly as the server's, elbows too", () => {
    const client = new Client();
    const way = served(150, waving);
    const drawn = way.map(({ pose }, frame) => client.draw(pose, way[Math.max(frame - LATE, 0)]!.targets));
    const jerk = (all: Float32Array[], name: string) =>
      all.slice(22).map((poses, n) => {
        const [a, b, c] = [all[n + 20]!, all[n + 21]!, poses].map((each) => body(each, name).at);
        return a!.clone().add(c!).addScaledVector(b!, -2).length();
      });
    const server = way.map(({ targets }) => simulated(targets));
    for (const name of ["left_forearm", "right_forearm"])
      expect(Math.max(...jerk(drawn, name))).toBeLessThan(Math.max(...jerk(server, name)) + 0.003);
  });

  it("come to rest where the server has them", () => {
    const client = new Client();
    const way = served(200, (frame) => waving(Math.min(frame, 60)));
    const drawn = way.map(({ pose }, frame) => client.draw(pose, way[Math.max(frame - LATE, 0)]!.targets)).at(-1)!;
    const rest = simulated(way.at(-1)!.targets);
    for (const name of BODIES) expect(body(drawn, name).at.distanceTo(body(rest, name).at)).toBeLessThan(0.003);
  });

  it("go over to the simulated ones within a tenth of a second when they are held back, and return, without a jump", () => {
    const client = new Client();
    const blocked = REST.slice();
    blocked[PERSON.joints.right[1]]! += 0.25;
    const reaching = REST.slice();
    reaching[PERSON.joints.right[1]]! -= 0.15;
    const pose = poseOf(reaching);
    const gap = apart(handOf(simulated(blocked), "right"), pose.right!).m;
    const frames = Math.ceil(BLEND_MS / FRAME_MS) + 1;
    const show = (count: number, deviating: TrackedBodyPart[]) =>
      Array.from({ length: count }, () => client.draw(pose, reaching, deviating, blocked));
    const [free, over, back] = [show(60, []), show(frames, ["right"]), show(frames, [])];
    expect(apart(handOf(free.at(-1)!, "right"), pose.right!).m).toBeLessThan(0.01);
    for (const name of ["upper_arm", "forearm", "hand"].map((part) => `right_${part}`))
      expect(body(over.at(-1)!, name).at.distanceTo(body(simulated(blocked), name).at)).toBeLessThan(1e-6);
    expect(apart(handOf(over.at(-1)!, "left"), pose.left!).m).toBeLessThan(0.01);
    expect(apart(handOf(back.at(-1)!, "right"), pose.right!).m).toBeLessThan(0.01);
    expect(gap).toBeGreaterThan(0.1);
    const all = [...free.slice(-1), ...over, ...back];
    for (let n = 1; n < all.length; n++)
      expect(apart(handOf(all[n]!, "right"), handOf(all[n - 1]!, "right")).m).toBeLessThan((2 * gap * FRAME_MS) / BLEND_MS);
  });

  const HERE: XRPose = [[0, 0, 0], [0, 0, 0, 1]]; // prettier-ignore
  const quaternion = ([w, x, y, z]: readonly [number, number, number, number]) => new Quaternion(x, y, z, w);

  /** What a device tells of a part of the body, misjudged by some centimetres and degrees. */
  function measured({ position, q }: Pose, turn: Quaternion, offset: readonly number[], cm = 0, deg = 0): XRPose {
    const device = quaternion(q).multiply(turn.clone().conjugate());
    device.multiply(new Quaternion().setFromAxisAngle(new Vector3(0, 0.6, 0.8), (deg * Math.PI) / 180));
    const [x, y, z] = offset;
    const away = new Vector3(x, y, z! + cm / 100).applyQuaternion(device);
    return xrPoseOf(new Vector3(...position).sub(away), device);
  }

  const WAYS = [["controller", "hand"], ["hand", "controller"]] as const; // prettier-ignore
  const SWITCHES = (["left", "right"] as const).flatMap((side) =>
    WAYS.flatMap((way) => [0, 100, 300, 1000].map((gapMs) => ({ side, way, gapMs }))),
  );

  it.each(SWITCHES)("stay where they are while a hand rests whose device changes: $side, $way, $gapMs ms", (change) => {
    const { side, way, gapMs } = change;
    const pose = poseOf(waving(20));
    const bodyAxes = quaternion(DEVICES.body_from_device_q);
    const seen = (modality: Modality): Poses => {
      const bare = modality === "hand";
      const turn = bare ? quaternion(DEVICES.hand_from_wrist_q[side]) : bodyAxes;
      const hand = measured(pose[side]!, turn, bare ? DEVICES.hand_centre_from_wrist : [0, 0, 0], bare ? 6 : 0, bare ? 30 : 0);
      const head = measured(pose.head, bodyAxes, DEVICES.head_centre_from_headset);
      const none = { left: null, right: null, left_modality: "none", right_modality: "none" } as const;
      if (modality === "none") return { head, ...none };
      return { head, ...none, [side]: hand, [`${side}_modality`]: modality };
    };
    const [client, hands, server] = [new Client(), new Hands(), new BodySolver(skeleton)];
    let targets: JointAngles = waving(20);
    const drawn: Pose[] = [];
    for (let frame = 0, nowMs = 0; nowMs < 2500 + gapMs; nowMs = FRAME_MS * ++frame) {
      const modality = nowMs < 1000 ? way[0] : nowMs < 1000 + gapMs ? "none" : way[1];
      const tracked = bodyPose(hands.follow(seen(modality), nowMs), HERE)!;
      targets = server.solve(tracked, targets, ARM.most_turn_rad);
      drawn.push(handOf(client.draw(tracked, targets), side));
    }
    const rest = drawn[Math.floor(990 / FRAME_MS)]!;
    for (const each of drawn.slice(Math.floor(990 / FRAME_MS))) {
      expect(apart(each, rest).m).toBeLessThan(0.02);
      expect(apart(each, rest).deg).toBeLessThan(5);
    }
  });

  it("begin where they are simulated", () => {
    const client = new Client();
    const pose = poseOf(waving(20));
    const first = client.draw(pose, REST);
    expect(apart(handOf(first, "right"), handOf(simulated(REST), "right")).m).toBeLessThan(1e-6);
    const next = client.draw(pose, REST);
    expect(apart(handOf(next, "right"), handOf(first, "right")).m).toBeLessThan(0.05);
  });

  it("keep an arm that is not tracked as the server keeps it", () => {
    const client = new Client();
    const pose = { ...poseOf(waving(20)), left: null };
    let poses = client.draw(pose, REST);
    for (let n = 0; n < 40; n++) poses = client.draw(pose, REST);
    const { at, turn } = body(poses, "left_hand");
    expect(Number.isFinite(at.x) && Math.abs(turn.length() - 1) < 1e-6).toBe(true);
    const torso = body(poses, "torso");
    const rest = [body(simulated(REST), "left_hand"), body(simulated(REST), "torso")] as const;
    const seen = at.clone().sub(torso.at).applyQuaternion(torso.turn.invert());
    expect(seen.distanceTo(rest[0].at.sub(rest[1].at).applyQuaternion(rest[1].turn.invert()))).toBeLessThan(0.005);
  });
});
