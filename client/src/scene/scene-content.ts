import {
  Group,
  InstancedMesh,
  Material,
  Matrix4,
  Mesh,
  MeshStandardMaterial,
  type Object3D,
  PerspectiveCamera,
  Quaternion,
  SkinnedMesh,
  SphereGeometry,
  SRGBColorSpace,
  type Texture,
  Vector3,
} from "three";
import { POSE } from "./state-interpolation";
import type { Scene } from "../generated/messages";
import { fadeNearEyes } from "./near-fade";
import { SurfacePoints } from "./surface-points";

/** Poses in the order of the protocol: x, y, z, w, x, y, z of each body, then of each mark. */
type Poses = Float32Array;

interface Follower {
  node: Object3D;
  at: number;
}

/** A bone that follows a limb without its twist; `parentAt`: offset of the pose of the limb's parent. */
interface Swing extends Follower {
  parentAt: number;
}

/** A mesh that is instanced at several poses. */
interface Copies {
  mesh: InstancedMesh;
  at: number[];
}

/** A mesh whose vertices are at several poses. */
interface Cloth {
  mesh: Mesh;
  at: number[];
}

/** Not 0, because a singular matrix has no normals. */
const COLLAPSED_SCALE = 1e-3;
/** Emission of a highlighted body. */
const SHINING = 0x1f9a4a;
/** Prefix of the names of the bodies of robot and tool. */
const ROBOT = "robot/";

/** The displayed scene. `extras` of the GLB's nodes contain the bodies that move them; see the server's `scene_export`. */
export class SceneContent {
  private readonly followers: Follower[] = [];
  private readonly swings: Swing[] = [];
  private readonly copies: Copies[] = [];
  private readonly cloths: Cloth[] = [];
  private readonly heads: Material[] = [];
  private readonly faded = new Map<Material, Material>();
  readonly surfaces: SurfacePoints;
  /** The camera at the robot's wrist. */
  wristCamera: PerspectiveCamera | null = null;

  constructor(
    readonly group: Group,
    private readonly scene: Scene,
  ) {
    for (const node of [...group.children]) this.take(node);
    this.surfaces = new SurfacePoints(group);
    this.addMarks();
    group.traverse((node) => {
      prepare(node);
      if (node instanceof PerspectiveCamera) this.wristCamera = node;
    });
  }

  place(poses: Poses): void {
    for (const { node, at } of this.followers) {
      readPosition(node.position, poses, at);
      readQuaternion(node.quaternion, poses, at);
    }
    for (const swing of this.swings) {
      readPosition(swing.node.position, poses, swing.at);
      placeSwing(swing, poses);
    }
    for (const copies of this.copies) placeCopies(copies, poses);
    for (const cloth of this.cloths) placeCloth(cloth, poses);
  }

  /** In the first-person view, the participant's own head is hidden but still casts its shadow. */
  setFirstPerson(inside: boolean): void {
    for (const material of this.heads) material.colorWrite = material.depthWrite = !inside;
  }

  /** Collapses the skin of a body into its joint, or restores it. */
  collapse(body: string, folded: boolean): void {
    const at = this.poseOf(body);
    for (const follower of this.followers)
      if (follower.at === at) follower.node.scale.setScalar(folded ? COLLAPSED_SCALE : 1);
  }

  /** Makes the materials of a body shine, or ends this. */
  highlight(body: string, on: boolean): void {
    const at = this.poseOf(body);
    for (const follower of this.followers) if (follower.at === at) follower.node.traverse((part) => shine(part, on));
  }

  dispose(): void {
    this.group.removeFromParent();
    this.group.traverse((node) => {
      if (!(node instanceof Mesh)) return;
      node.geometry.dispose();
      if (node instanceof InstancedMesh) node.dispose();
      if (node instanceof SkinnedMesh) node.skeleton.dispose();
      materialsOf(node).forEach(disposeMaterial);
    });
  }

  /** Registers a node by its `extras`; GLTFLoader changes names. */
  private take(node: Object3D): void {
    const { body, swing, parent, bodies, vertices, skin_of: skinOf } = node.userData as Record<string, unknown>;
    if (String(body).startsWith(ROBOT) || Array.isArray(bodies ?? vertices)) fadeAll(node, this.faded);
    if (typeof body === "string") this.follow(node, body);
    if (typeof swing === "string") this.swing(node, swing, String(parent));
    if (Array.isArray(bodies) && node instanceof Mesh) this.copy(node, bodies.map(String));
    if (Array.isArray(vertices) && node instanceof Mesh) this.cloth(node, vertices.map(String));
    if (this.scene.head_bodies.includes(String(skinOf)) && node instanceof Mesh)
      this.heads.push(ownMaterial(node));
  }

  private follow(node: Object3D, body: string): void {
    const at = this.poseOf(body);
    if (at !== null) this.followers.push({ node, at });
  }

  private swing(node: Object3D, body: string, parent: string): void {
    const at = this.poseOf(body);
    const parentAt = this.poseOf(parent);
    if (at !== null && parentAt !== null) this.swings.push({ node, at, parentAt });
  }

  private copy(model: Mesh, bodies: string[]): void {
    const at = bodies.map((body) => this.poseOf(body)).filter((found) => found !== null);
    const mesh = new InstancedMesh(model.geometry, model.material, at.length);
    model.removeFromParent();
    this.group.add(mesh);
    this.copies.push({ mesh, at });
  }

  private cloth(mesh: Mesh, vertices: string[]): void {
    const at = vertices.map((body) => this.poseOf(body)).filter((found) => found !== null);
    if (at.length !== vertices.length) return;
    mesh.geometry.deleteAttribute("normal");
    mesh.geometry.computeVertexNormals();
    mesh.frustumCulled = false;
    this.cloths.push({ mesh, at });
  }

  /** Adds the marks of the task on the person. */
  private addMarks(): void {
    const { bodies, marks, mark_radius_m: radius, mark_rgb: rgb } = this.scene;
    if (!marks) return;
    const material = new MeshStandardMaterial({ roughness: 0.8 });
    material.color.setRGB(...rgb, SRGBColorSpace);
    const mesh = new InstancedMesh(new SphereGeometry(radius, 12, 8), material, marks);
    this.group.add(mesh);
    this.copies.push({ mesh, at: Array.from({ length: marks }, (_, mark) => (bodies.length + mark) * POSE) });
  }

  private poseOf(body: string): number | null {
    const index = this.scene.bodies.indexOf(body);
    return index < 0 ? null : index * POSE;
  }
}

const position = new Vector3();
const quaternion = new Quaternion();
const twist = new Quaternion();
const unscaled = new Vector3(1, 1, 1);
const matrix = new Matrix4();

/** Near a half turn the twist of a limb is undefined; then it stays unchanged. */
const LEAST_TWIST = 1e-3;

function placeSwing({ node, at, parentAt }: Swing, poses: Poses): void {
  readQuaternion(twist, poses, parentAt).conjugate().multiply(readQuaternion(quaternion, poses, at));
  const length = Math.hypot(twist.w, twist.z);
  if (length < LEAST_TWIST) return;
  twist.set(0, 0, -twist.z / length, twist.w / length);
  node.quaternion.copy(quaternion).multiply(twist);
}

function placeCopies({ mesh, at }: Copies, poses: Poses): void {
  at.forEach((start, index) => {
    readPosition(position, poses, start);
    readQuaternion(quaternion, poses, start);
    mesh.setMatrixAt(index, matrix.compose(position, quaternion, unscaled));
  });
  mesh.instanceMatrix.needsUpdate = true;
}

function placeCloth({ mesh: { geometry }, at }: Cloth, poses: Poses): void {
  const positions = geometry.getAttribute("position");
  at.forEach((start, vertex) => positions.setXYZ(vertex, poses[start]!, poses[start + 1]!, poses[start + 2]!));
  positions.needsUpdate = true;
  geometry.computeVertexNormals();
}

function readPosition(into: Vector3, poses: Poses, at: number): Vector3 {
  return into.set(poses[at]!, poses[at + 1]!, poses[at + 2]!);
}

function readQuaternion(into: Quaternion, poses: Poses, at: number): Quaternion {
  return into.set(poses[at + 4]!, poses[at + 5]!, poses[at + 6]!, poses[at + 3]!);
}

/** Enables shadows, and disables culling of meshes whose bounds move with the poses. */
function prepare(node: Object3D): void {
  node.castShadow = node.receiveShadow = true;
  if (node instanceof SkinnedMesh || node instanceof InstancedMesh) node.frustumCulled = false;
}

function materialsOf(mesh: Mesh): Material[] {
  return Array.isArray(mesh.material) ? mesh.material : [mesh.material];
}

/** Makes all meshes below a node fade near the eyes; `faded` maps original to fading materials. */
function fadeAll(node: Object3D, faded: Map<Material, Material>): void {
  node.traverse((part) => {
    if (!(part instanceof Mesh)) return;
    const [plain] = materialsOf(part);
    const known = faded.get(plain!);
    if (known) part.material = known;
    else {
      const own = ownMaterial(part);
      fadeNearEyes(own);
      faded.set(plain!, own);
    }
  });
}

/** Sets the emission of a mesh's materials. The first call gives the mesh its own material. */
function shine(part: Object3D, on: boolean): void {
  if (!(part instanceof Mesh)) return;
  part.userData["plain"] ??= part.material as Material;
  const plain = part.userData["plain"] as Material;
  part.userData["shining"] ??= shiningCopy(plain);
  part.material = (on ? part.userData["shining"] : plain) as Material;
}

function shiningCopy(plain: Material): Material {
  const copy = plain.clone();
  copy.onBeforeCompile = plain.onBeforeCompile;
  copy.customProgramCacheKey = plain.customProgramCacheKey;
  if (copy instanceof MeshStandardMaterial) copy.emissive.setHex(SHINING);
  return copy;
}

/** Gives a mesh its own copy of a material, which GLB files share. */
function ownMaterial(mesh: Mesh): Material {
  const own = materialsOf(mesh)[0]!.clone();
  mesh.material = own;
  return own;
}

function disposeMaterial(material: Material): void {
  for (const value of Object.values(material)) {
    if ((value as Texture | null)?.isTexture) (value as Texture).dispose();
  }
  material.dispose();
}
