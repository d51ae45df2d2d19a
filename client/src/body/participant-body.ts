import { Quaternion, Vector3 } from "three";
import { ARM } from "../generated/body-model";
import { BodySolver, type BodyPose, type JointAngles } from "./body-solver";
import { chainsOf, drawChain, type Chain, type Place } from "./kinematic-chain";
import { TICK_S, type TrackedBodyPart, type Scene } from "../generated/messages";
import type { WorldState } from "../session/state-decoder";

/** Time for blending a deviating part from the tracked to the simulated pose, and back. */
export const BLEND_MS = 100;
/** Fraction of the difference to the server's angles that each frame's start angles add. It makes elbows converge. */
const PULL = 0.2;
const LONGEST_LAG_MS = 1000;

/**
 * The participant's trunk and arms, drawn at the poses of headset and controllers of the same frame.
 *
 * The server simulates them with a delay. Parts that deviate from tracking are drawn at their simulated pose.
 */
export class ParticipantBody {
  private readonly solver: BodySolver;
  private readonly hips: Place;
  private readonly chains: [trunk: Chain, ...arms: Chain[]];
  private targets: JointAngles | null = null;
  private angles: JointAngles | null = null;
  private deviating: ReadonlySet<TrackedBodyPart> = new Set();
  private lastMs: number | null = null;

  constructor({ skeleton, bodies }: Scene) {
    const [w, x, y, z] = skeleton.hips_q_w;
    this.solver = new BodySolver(skeleton);
    this.hips = { origin: new Vector3(...skeleton.hips_pos_w), turn: new Quaternion(x, y, z, w) };
    this.chains = chainsOf(skeleton, bodies);
  }

  /** Stores the joint targets and deviating parts of the newest state. */
  take({ joint_targets: targets, deviating_parts: deviating }: WorldState): void {
    this.targets = targets.length ? targets : null;
    this.deviating = new Set(deviating);
  }

  /** Resets while nobody is tracked. The next participant is blended in from the simulated pose. */
  rest(): void {
    this.angles = this.lastMs = null;
    for (const chain of this.chains) chain.simulatedShare = 1;
  }

  /**
   * Replaces the simulated poses of the body by tracked ones.
   *
   * `lagMs`: the age of the pose in the newest state, which limits how far its joints can have moved since.
   */
  draw(poses: Float32Array, pose: BodyPose, nowMs: number, lagMs: number): void {
    if (!this.targets) return;
    this.angles = this.solve(pose, this.targets, lagMs);
    const share = Math.min(Math.max(nowMs - (this.lastMs ?? nowMs), 0) / BLEND_MS, 1);
    this.lastMs = nowMs;
    for (const chain of this.chains) {
      const difference = (this.deviating.has(chain.part) ? 1 : 0) - chain.simulatedShare;
      chain.simulatedShare += Math.min(Math.max(difference, -share), share);
    }
    const [trunk, ...arms] = this.chains;
    const torso = drawChain(trunk, poses, this.angles, this.hips);
    for (const arm of arms) drawChain(arm, poses, this.angles, torso);
  }

  private solve(pose: BodyPose, targets: JointAngles, lagMs: number): JointAngles {
    const ticks = 1 + Math.ceil(Math.min(Math.max(lagMs, 0), LONGEST_LAG_MS) / (1000 * TICK_S));
    const turn = ticks * ARM.most_turn_rad;
    const before = this.angles ?? targets;
    const start = targets.map((target, joint) => {
      const pulled = before[joint]! + PULL * (target - before[joint]!);
      return Math.min(Math.max(pulled, target - turn), target + turn);
    });
    return this.solver.solve(pose, start, turn);
  }
}
