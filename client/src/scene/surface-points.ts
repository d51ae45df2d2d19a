import { InstancedMesh, Mesh, SkinnedMesh, Vector3, type Object3D } from "three";
import { MeshSurfaceSampler } from "three/addons/math/MeshSurfaceSampler.js";
import { seededRandom } from "./random";

/** One point for each so many square metres of a surface of few triangles. */
const AREA_M2 = 0.0016;
const FEWEST = 12;
const MOST = 800;
/** With more vertices than this some of them stand for the surface. */
const FINE_VERTICES = 3000;
const SKIN_VERTICES = 1500;
/** What of the person is nearer to the eyes are arms and lap, which move out of the way. */
const REACH_M = 0.8;

/** Points on the surfaces of a scene, to tell where there is room. Drops, crumbs and marks are left out. */
export class SurfacePoints {
  private readonly rigid: { mesh: Mesh; points: Vector3[] }[] = [];
  private readonly skins: SkinnedMesh[] = [];

  constructor(scene: Object3D) {
    scene.updateMatrixWorld();
    scene.traverse((node) => {
      if (node instanceof SkinnedMesh) this.skins.push(node);
      else if (node instanceof Mesh && !(node instanceof InstancedMesh))
        this.rigid.push({ mesh: node, points: pointsOn(node) });
    });
  }

  /** The points as they lie now, x, y, z of each; those of the person only beyond the reach of the arms. */
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

/** How many points a surface needs; its sides say how large it is about. */
function pointsFor(mesh: Mesh): number {
  mesh.geometry.computeBoundingBox();
  const { x, y, z } = mesh.geometry.boundingBox!.getSize(new Vector3()).multiply(mesh.getWorldScale(new Vector3()));
  return Math.min(MOST, Math.max(FEWEST, Math.ceil((2 * (x * y + y * z + z * x)) / AREA_M2)));
}

function verticesOf(mesh: Mesh): number {
  return mesh.geometry.getAttribute("position").count;
}

/** At most so many of the numbers below `count`, evenly spread. */
function spread(count: number, most: number): number[] {
  const stride = Math.ceil(count / most);
  return Array.from({ length: Math.ceil(count / stride) }, (_, index) => index * stride);
}
