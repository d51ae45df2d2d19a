import { Group, Quaternion, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { BareHands, NO_TRACKED_HANDS, type TrackedHands } from "../body/bare-hands";
import { SceneContent } from "./scene-content";
import { POSE, StateBuffer } from "./state-interpolation";
import { bodyPose } from "../body/body-pose";
import { PERSON } from "../generated/body-model";
import type { BodyPose, Pose, Side } from "../body/body-solver";
import type { Placed, Scene, XRPose } from "../generated/messages";
import { ParticipantBody } from "../body/participant-body";
import { Hands } from "../tracking/modality-switch";
import type { State } from "../session/state-decoder";
import { poseOf, type Poses } from "../tracking/pose-reader";

/** A way of the world, from one place in `local-floor` to another. */
interface Motion {
  from: Vector3;
  to: Vector3;
  beginsMs: number;
  lastsMs: number;
}

const SIDES = ["left", "right"] as const;
const TOOL = "robot/tool";
const loader = new GLTFLoader();

/** The simulated world: its root stands where the server says, its bodies follow the states. */
export class World {
  /** Carries the transform from the simulation's z-up world to WebXR's `local-floor`. */
  readonly root = uprightRoot();
  readonly hands = new BareHands();
  private followed = new Hands();
  private content: SceneContent | null = null;
  private states: StateBuffer | null = null;
  private own: ParticipantBody | null = null;
  /** The bodies' poses as they are simulated and as they are drawn, and where the participant is, in the latest frame. */
  simulated = new Float32Array();
  drawn = new Float32Array();
  tracked: BodyPose | null = null;
  private newest: Scene | null = null;
  private shown: Scene | null = null;
  private firstPerson = false;
  private motion: Motion | null = null;

  constructor() {
    this.root.add(this.hands.group);
  }

  /** Replaces the scene; until the new one is here, the earlier one stays as it is. */
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

  /** The whole world goes to another place, evenly. */
  move({ xr_from_world: [to], seconds }: Placed, nowMs: number): void {
    const from = this.root.position.clone();
    this.motion = { from, to: new Vector3(...to), beginsMs: nowMs, lastsMs: 1000 * seconds };
  }

  /** False when the state is old or of another scene. */
  push(state: State): boolean {
    const taken = this.states?.push(state) ?? false;
    if (taken) this.own?.take(state);
    return taken;
  }

  /** A restarted server counts its states from the beginning. */
  forgetStates(): void {
    if (this.newest) this.states = new StateBuffer(posesIn(this.newest));
  }

  /**
   * Draws what is simulated, and over it the body of who takes part, where they are tracked in this frame.
   *
   * `lagMs` is the age of the pose that the newest state follows.
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

  /** From now on the hands follow their tracked poses without corrections. */
  forgetHands(): void {
    this.followed = new Hands();
  }

  /** Draws these poses at once. */
  show(poses: Float32Array): void {
    this.content?.place(poses);
  }

  /** Where the robot's tool is drawn, in `local-floor`; null before the first picture. */
  get robot(): Vector3 | null {
    const at = (this.shown?.bodies.indexOf(TOOL) ?? -1) * POSE;
    if (at < 0 || this.drawn[at + 3] === 0) return null;
    return this.root.localToWorld(new Vector3().fromArray(this.drawn, at));
  }

  /** The simulation time of the picture that was drawn last. */
  get drawnTimeS(): number {
    return this.states?.drawnTimeS ?? -Infinity;
  }

  /** From inside, the participant's own head is not drawn. */
  setFirstPerson(inside: boolean): void {
    this.firstPerson = inside;
    this.content?.setFirstPerson(inside);
  }

  /** Points on all that stands around, x, y, z of each. */
  surfacePoints(eyes: Vector3): Float32Array {
    this.root.updateMatrixWorld();
    return this.content?.surfaces.around(eyes) ?? new Float32Array();
  }

  /** The fingers of a hand that is `seen` at a pose go along with it to where it is drawn. */
  private drawHand(side: Side, bareHands: TrackedHands, seen: Pose | null | undefined): void {
    const body = `${PERSON.prefix}${side}_hand`;
    const joints = bareHands[side];
    const at = this.shown!.bodies.indexOf(body) * POSE;
    this.content?.collapse(body, !!(joints && seen));
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
    const share = Math.min(Math.max((nowMs - beginsMs) / lastsMs, 0), 1);
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
  }
}

function posesIn(scene: Scene): number {
  return scene.bodies.length + scene.marks;
}

/** Before the server has said where the world stands, only its up is known. */
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
