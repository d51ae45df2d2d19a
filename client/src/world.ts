import {
  Group,
  InstancedMesh,
  Material,
  Matrix4,
  Mesh,
  MeshStandardMaterial,
  type Object3D,
  SphereGeometry,
  SRGBColorSpace,
  type Texture,
} from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { POSE, StateBuffer } from "./interpolation";
import type { Scene, State, XRPose } from "./messages";

const loader = new GLTFLoader();

/** The simulated world: its root stands where the server says, its bodies follow the states. */
export class World {
  /** Carries the transform from the simulation's z-up world to WebXR's `local-floor`. */
  readonly root = uprightRoot();
  private content: Group | null = null;
  private nodes: (Object3D | undefined)[] = [];
  private heads: Material[] = [];
  private states: StateBuffer | null = null;
  private poses = new Float32Array();
  private marks: InstancedMesh | null = null;
  private newest: Scene | null = null;
  private seenFromInside = false;

  /** Replaces the scene; until the new one is here, the earlier one stays as it is. */
  async load(scene: Scene, token: string): Promise<void> {
    this.newest = scene;
    this.nodes = [];
    this.states = new StateBuffer(posesIn(scene));
    this.poses = new Float32Array(posesIn(scene) * POSE);
    placeRoot(this.root, scene.xr_from_world);
    const content = await loadContent(scene.url, token);
    if (scene === this.newest) this.replace(content, scene);
    else dispose(content);
  }

  /** False when the state is old or of another scene. */
  push(state: State, nowMs: number): boolean {
    return this.states?.push(state, nowMs / 1000) ?? false;
  }

  /** A restarted server counts its states from the beginning. */
  forgetStates(): void {
    if (this.newest) this.states = new StateBuffer(posesIn(this.newest));
  }

  update(nowMs: number): void {
    if (!this.states?.drawn(nowMs / 1000, this.poses)) return;
    for (let body = 0; body < this.nodes.length; body++) this.place(this.nodes[body], body * POSE);
    this.placeMarks();
  }

  /** From inside, the participant's own head is not drawn, but it still casts its shadow. */
  seeFromInside(inside: boolean): void {
    this.seenFromInside = inside;
    for (const material of this.heads) material.colorWrite = material.depthWrite = !inside;
  }

  private place(node: Object3D | undefined, at: number): void {
    const { poses } = this;
    node?.position.set(poses[at]!, poses[at + 1]!, poses[at + 2]!);
    node?.quaternion.set(poses[at + 4]!, poses[at + 5]!, poses[at + 6]!, poses[at + 3]!);
  }

  /** The poses of the marks follow those of the bodies. */
  private placeMarks(): void {
    const { marks, poses } = this;
    if (!marks) return;
    for (let mark = 0; mark < marks.count; mark++) {
      const at = (this.nodes.length + mark) * POSE;
      marks.setMatrixAt(mark, matrix.makeTranslation(poses[at]!, poses[at + 1]!, poses[at + 2]!));
    }
    marks.instanceMatrix.needsUpdate = true;
  }

  private replace(content: Group, scene: Scene): void {
    if (this.content) dispose(this.content);
    this.root.add(content);
    this.content = content;
    const byBody = nodesByBody(content);
    this.marks = spots(scene);
    if (this.marks) content.add(this.marks);
    this.nodes = scene.bodies.map((body) => byBody.get(body));
    this.heads = scene.head_bodies.flatMap((body) => ownMaterials(byBody.get(body)));
    this.seeFromInside(this.seenFromInside);
  }
}

const matrix = new Matrix4();

function posesIn(scene: Scene): number {
  return scene.bodies.length + scene.marks;
}

/** All spots that the task draws on the person, in one draw call. */
function spots(scene: Scene): InstancedMesh | null {
  if (!scene.marks) return null;
  const material = new MeshStandardMaterial({ roughness: 0.8 });
  material.color.setRGB(...scene.mark_rgb, SRGBColorSpace);
  const found = new InstancedMesh(new SphereGeometry(scene.mark_radius_m, 12, 8), material, scene.marks);
  found.frustumCulled = false;
  return found;
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

async function loadContent(url: string, token: string): Promise<Group> {
  const response = await fetch(url, { headers: { Authorization: `Bearer ${token}` } });
  if (!response.ok) throw new Error(`the server answered ${response.status}`);
  const { scene } = await loader.parseAsync(await response.arrayBuffer(), "");
  scene.traverse((node) => {
    node.castShadow = node.receiveShadow = true;
  });
  return scene;
}

/** GLTFLoader renames nodes, so that only `extras.body` tells which body a node is. */
function nodesByBody(content: Group): Map<string, Object3D> {
  const found = new Map<string, Object3D>();
  content.traverse((node) => {
    const body: unknown = node.userData["body"];
    if (typeof body === "string" && !found.has(body)) found.set(body, node);
  });
  return found;
}

function meshes(root: Object3D | undefined): Mesh[] {
  const found: Mesh[] = [];
  root?.traverse((node) => node instanceof Mesh && found.push(node));
  return found;
}

function materialsOf(mesh: Mesh): Material[] {
  return Array.isArray(mesh.material) ? mesh.material : [mesh.material];
}

/** Gives a body materials of its own: GLB files share them between bodies. */
function ownMaterials(node: Object3D | undefined): Material[] {
  return meshes(node).flatMap((mesh) => {
    const own = materialsOf(mesh).map((material) => material.clone());
    mesh.material = own.length === 1 ? own[0]! : own;
    return own;
  });
}

function dispose(content: Group): void {
  content.removeFromParent();
  for (const mesh of meshes(content)) {
    mesh.geometry.dispose();
    for (const material of materialsOf(mesh)) disposeMaterial(material);
  }
}

function disposeMaterial(material: Material): void {
  for (const value of Object.values(material)) {
    if ((value as Texture | null)?.isTexture) (value as Texture).dispose();
  }
  material.dispose();
}
