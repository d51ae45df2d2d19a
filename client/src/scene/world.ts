import { Group, Quaternion, Vector3, type PerspectiveCamera } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { BareHands, NO_TRACKED_HANDS, type TrackedHands } from "../body/bare-hands";
import { SceneContent } from "./scene-content";
import { POSE, StateBuffer } from "./state-interpolation";
import { bodyPose } from "../body/body-pose";
import { PERSON } from "../generated/body-model";
import type { BodyPose, Pose, Side } from "../body/body-solver";
import type { WorldMotion, Scene, XRPose } from "../generated/messages";
import { ParticipantBody } from "../body/participant-body";
import { Hands } from "../tracking/modality-switch";
import type { WorldState } from "../session/state-decoder";
import { poseOf, type Poses } from "../tracking/pose-reader";

/** A linear motion of the world in `local-floor`. */
interface Motion {
  from: Vector3;
  to: Vector3;
  beginsMs: number;
  lastsMs: number;
}

const SIDES = ["left", "right"] as const;
const TOOL = "robot/tool";
const loader = new GLTFLoader();

/** The simulated world: its root is at the pose from the server, its bodies follow the states. */
export class World {
  /** The pose of the z-up world frame in `local-floor`. */
  readonly root = uprightRoot();
  readonly hands = new BareHands();
  private followed = new Hands();
  private content: SceneContent | null = null;
  private states: StateBuffer | null = null;
  private own: ParticipantBody | null = null;
  /** In the last frame: the bodies' poses as simulated and as drawn, and the participant's tracked pose. */
  simulated = new Float32Array();
  drawn = new Float32Array();
  tracked: BodyPose | null = null;
  private newest: Scene | null = null;
  private shown: Scene | null = null;
  private firstPerson = false;
  /** Amputated arms, which are not drawn. */
  absentArms: readonly Side[] = [];
  /** Whether the world moves to its new pose in one step. */
  reducedMotion = false;
  private motion: Motion | null = null;
  private highlighted = false;

  constructor() {
    this.root.add(this.hands.group);
  }

  /** Loads a scene; the previous one remains until it is loaded. */
  async load(scene: Scene, glb: Promise<ArrayBuffer>): Promise<void> {
    this.newest = scene;
    this.states = new StateBuffer(posesIn(scene));
    this.simulated = new Float32Array(posesIn(scene) * POSE);
    this.drawn = new Float32Array(posesIn(scene) * POSE);
    this.own = new ParticipantBody(scene);
    placeRoot(this.root, scene.xr_from_world);
    this.motion = null;
    const content = new SceneContent((await loader.parseAsync(await glb, "")).scene, scene);
    if (scene === this.newest) this.replace(content, scene);
    else content.dispose();
  }

  /** Moves the whole world linearly to another pose, or in one step with reduced motion. */
  move({ xr_from_world: [to], seconds }: WorldMotion, nowMs: number): void {
    const from = this.root.position.clone();
    const lastsMs = this.reducedMotion ? 0 : 1000 * seconds;
    this.motion = { from, to: new Vector3(...to), beginsMs: nowMs, lastsMs };
  }

  /** Adds a state; returns false if it is old or of another scene. */
  push(state: WorldState): boolean {
    const taken = this.states?.push(state) ?? false;
    if (taken) this.own?.take(state);
    return taken;
  }

  /** Discards all states: a restarted server numbers them from 0. */
  forgetStates(): void {
    if (this.newest) this.states = new StateBuffer(posesIn(this.newest));
  }

  /**
   * Draws the simulated bodies, and the participant's body at its tracked pose.
   *
   * `lagMs`: the age of the pose in the newest state.
   */
  update(nowMs: number, poses: Poses | null, lagMs: number, bareHands: TrackedHands = NO_TRACKED_HANDS): void {
    this.advance(nowMs);
    const followed = poses && this.followed.follow(poses, nowMs);
    if (!poses) this.forgetHands();
    if (this.shown !== this.newest || !this.states?.draw(nowMs / 1000, this.simulated)) return;
    this.drawn.set(this.simulated);
    this.tracked = followed && bodyPose(followed, this.standing);
    if (this.tracked) this.own?.draw(this.drawn, this.tracked, nowMs, lagMs);
    else this.own?.rest();
    this.content?.place(this.drawn);
    const seen = poses && bodyPose(poses, this.standing);
    for (const side of SIDES) this.drawHand(side, bareHands, seen?.[side]);
  }

  /** Discards corrections of the hands. */
  forgetHands(): void {
    this.followed = new Hands();
  }

  /** Highlights the robot's tool, or ends this. */
  highlightTool(on: boolean): void {
    this.highlighted = on;
    this.content?.highlight(TOOL, on);
  }

  /** Draws these poses. */
  show(poses: Float32Array): void {
    this.content?.place(poses);
  }

  /** The drawn position of the robot's tool in `local-floor`; null before the first frame. */
  get robot(): Vector3 | null {
    const at = (this.shown?.bodies.indexOf(TOOL) ?? -1) * POSE;
    if (at < 0 || this.drawn[at + 3] === 0) return null;
    return this.root.localToWorld(new Vector3().fromArray(this.drawn, at));
  }

  /** The camera at the robot's wrist; null before the first frame. */
  get wristCamera(): PerspectiveCamera | null {
    return this.content?.wristCamera ?? null;
  }

  /** The simulation time of the last frame. */
  get drawnTimeS(): number {
    return this.states?.drawnTimeS ?? -Infinity;
  }

  /** In the first-person view, the participant's own head is hidden. */
  setFirstPerson(inside: boolean): void {
    this.firstPerson = inside;
    this.content?.setFirstPerson(inside);
  }

  /** The participant's angle of leaning back in the seat or bed. */
  get reclineRad(): number {
    const [w, x] = this.newest?.skeleton.hips_q_w ?? [1, 0];
    return 2 * Math.atan2(Math.abs(x), w);
  }

  /** Sample points x, y, z on the surrounding surfaces. */
  surfacePoints(eyes: Vector3): Float32Array {
    this.root.updateMatrixWorld();
    return this.content?.surfaces.around(eyes) ?? new Float32Array();
  }

  /** Draws the tracked fingers of a hand at the drawn pose of the hand; `seen` is the tracked one. */
  private drawHand(side: Side, bareHands: TrackedHands, seen: Pose | null | undefined): void {
    const body = `${PERSON.prefix}${side}_hand`;
    const absent = this.absentArms.includes(side);
    for (const part of ["upper_arm", "forearm"]) this.content?.collapse(`${PERSON.prefix}${side}_${part}`, absent);
    const joints = absent ? null : bareHands[side];
    const at = this.shown!.bodies.indexOf(body) * POSE;
    this.content?.collapse(body, absent || !!(joints && seen));
    if (!joints || !seen) return this.hands.hide(side);
    const [x, y, z, ...q] = this.drawn.subarray(at, at + POSE);
    const [w, qx, qy, qz] = q;
    const turn = new Quaternion(qx, qy, qz, w);
    const centre = new Vector3(0, 0, -this.shown!.skeleton.hand_m).applyQuaternion(turn).add({ x: x!, y: y!, z: z! });
    const drawn: Pose = { position: centre.toArray(), q: [w!, qx!, qy!, qz!] };
    this.hands.draw(side, joints, this.root.matrix, seen, drawn);
  }

  private advance(nowMs: number): void {
    if (!this.motion) return;
    const { from, to, beginsMs, lastsMs } = this.motion;
    const share = lastsMs > 0 ? Math.min(Math.max((nowMs - beginsMs) / lastsMs, 0), 1) : 1;
    this.root.position.lerpVectors(from, to, share);
    this.root.updateMatrixWorld();
    if (share === 1) this.motion = null;
  }

  private get standing(): XRPose {
    return poseOf(this.root.position, this.root.quaternion);
  }

  private replace(content: SceneContent, scene: Scene): void {
    this.content?.dispose();
    this.root.add(content.group);
    this.content = content;
    this.shown = scene;
    content.setFirstPerson(this.firstPerson);
    content.highlight(TOOL, this.highlighted);
  }
}

function posesIn(scene: Scene): number {
  return scene.bodies.length + scene.marks;
}

/** The initial pose: only the up direction is known. */
function uprightRoot(): Group {
  const root = new Group();
  root.rotation.x = -Math.PI / 2;
  root.updateMatrixWorld();
  return root;
}

function placeRoot(root: Group, [position, orientation]: XRPose): void {
  root.position.set(...position);
  root.quaternion.set(...orientation);
  root.updateMatrixWorld();
}
