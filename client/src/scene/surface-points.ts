import { InstancedMesh, Mesh, SkinnedMesh, Vector3, type Object3D } from "three";
import { MeshSurfaceSampler } from "three/addons/math/MeshSurfaceSampler.js";
import { seededRandom } from "./random";

/** Surface area per sample point, m². */
const AREA_M2 = 0.0016;
const FEWEST = 12;
const MOST = 800;
/** Of meshes with more vertices, some vertices are the sample points. */
const FINE_VERTICES = 3000;
const SKIN_VERTICES = 1500;
/** Parts of the person within this distance of the eyes (arms and lap) are ignored. */
const REACH_M = 0.8;

/** Sample points on the surfaces of a scene, for finding free space. Instanced meshes and cloth are ignored. */
export class SurfacePoints {
  private readonly rigid: { mesh: Mesh; points: Vector3[] }[] = [];
  private readonly skins: SkinnedMesh[] = [];

  constructor(scene: Object3D) {
    scene.updateMatrixWorld();
    scene.traverse((node) => {
      if (node instanceof SkinnedMesh) this.skins.push(node);
      else if (node instanceof Mesh && !(node instanceof InstancedMesh) && !node.userData.vertices)
        this.rigid.push({ mesh: node, points: pointsOn(node) });
    });
  }

  /** The present points x, y, z; those of the person only beyond `REACH_M`. */
  around(eyes: Vector3): Float32Array {
    const numbers: number[] = [];
    const point = new Vector3();
    for (const { mesh, points } of this.rigid)
      for (const local of points) numbers.push(...mesh.localToWorld(point.copy(local)).toArray());
    for (const skin of this.skins) {
      for (const at of spread(verticesOf(skin), SKIN_VERTICES)) {
        skin.localToWorld(skin.getVertexPosition(at, point));
        if (point.distanceTo(eyes) > REACH_M) numbers.push(...point.toArray());
      }
    }
    return new Float32Array(numbers);
  }
}

function pointsOn(mesh: Mesh): Vector3[] {
  const position = mesh.geometry.getAttribute("position");
  if (position.count > FINE_VERTICES)
    return spread(position.count, MOST).map((at) => new Vector3().fromBufferAttribute(position, at));
  const sampler = Object.assign(new MeshSurfaceSampler(mesh), { randomFunction: seededRandom(1) }).build();
  return Array.from({ length: pointsFor(mesh) }, () => {
    const point = new Vector3();
    sampler.sample(point);
    return point;
  });
}

/** The number of sample points of a mesh, from the size of its bounding box. */
function pointsFor(mesh: Mesh): number {
  mesh.geometry.computeBoundingBox();
  const { x, y, z } = mesh.geometry.boundingBox!.getSize(new Vector3()).multiply(mesh.getWorldScale(new Vector3()));
  return Math.min(MOST, Math.max(FEWEST, Math.ceil((2 * (x * y + y * z + z * x)) / AREA_M2)));
}

function verticesOf(mesh: Mesh): number {
  return mesh.geometry.getAttribute("position").count;
}

/** At most `most` evenly spaced integers below `count`. */
function spread(count: number, most: number): number[] {
  const stride = Math.ceil(count / most);
  return Array.from({ length: Math.ceil(count / stride) }, (_, index) => index * stride);
}
