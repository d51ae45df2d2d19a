import {
  BoxGeometry,
  CapsuleGeometry,
  CylinderGeometry,
  DoubleSide,
  Group,
  Mesh,
  MeshBasicMaterial,
  Raycaster,
  SphereGeometry,
  Vector3,
  type BufferGeometry,
} from "three";
import { describe, expect, it } from "vitest";
import { findFreePlace, isFree, upOfView } from "../../src/panel/panel-placement";
import { PANEL_HALF_M } from "../../src/panel/panel";
import { SurfacePoints } from "../../src/scene/surface-points";
import scenes from "../data/scenes.json";

const AHEAD = new Vector3(0, 0, -1);
const MATERIAL = new MeshBasicMaterial({ side: DoubleSide });
const EVERY = [-1, -0.75, -0.5, -0.25, 0, 0.25, 0.5, 0.75, 1];

/** MuJoCo's shapes: sizes are halves, capsules and cylinders lie along z. */
function shape(kind: string, [x, y, z]: number[]): BufferGeometry {
  if (kind === "sphere") return new SphereGeometry(x, 12, 8);
  if (kind === "box") return new BoxGeometry(2 * x!, 2 * y!, 2 * z!);
  const along = kind === "capsule" ? new CapsuleGeometry(x, 2 * y!, 4, 12) : new CylinderGeometry(x, x, 2 * y!, 16);
  return along.rotateX(Math.PI / 2);
}

type Geom = [string, number[], number[], number[]];

/** A scene in `local-floor`, where up is y and people look along -z. */
function built(geoms: Geom[]): Group {
  const root = new Group();
  root.rotation.x = -Math.PI / 2;
  for (const [kind, size, position, [w, x, y, z]] of geoms) {
    const mesh = new Mesh(shape(kind, size), MATERIAL);
    mesh.position.fromArray(position);
    mesh.quaternion.set(x!, y!, z!, w!);
    root.add(mesh);
  }
  root.rotation.z = Math.PI;
  root.updateMatrixWorld();
  return root;
}

/** How far something is before or in the panel, looking at many of its points; infinite where nothing is. */
function nearest(scene: Group, eyes: Vector3, middle: Vector3): number {
  const ahead = middle.clone().sub(eyes).normalize();
  const right = new Vector3().crossVectors(ahead, new Vector3(0, 1, 0)).normalize();
  const up = new Vector3().crossVectors(right, ahead);
  const hits = EVERY.flatMap((x) =>
    EVERY.flatMap((y) => {
      const point = middle.clone();
      point.addScaledVector(right, x * PANEL_HALF_M.x).addScaledVector(up, y * PANEL_HALF_M.y);
      const along = point.sub(eyes);
      const ray = new Raycaster(eyes, along.clone().normalize(), 0, along.length());
      return ray.intersectObject(scene).map((hit) => hit.distance);
    }),
  );
  return Math.min(Infinity, ...hits);
}

describe("the place of the panel", () => {
  it.each(scenes.map((scene) => [scene.name, scene] as const))("is free in %s", (_, { eyes, geoms }) => {
    const scene = built(geoms as unknown as Geom[]);
    const from = scene.localToWorld(new Vector3().fromArray(eyes));
    const middle = findFreePlace(from, AHEAD, new SurfacePoints(scene).around(from), PANEL_HALF_M);
    expect(nearest(scene, from, middle)).toBe(Infinity);
    expect(middle.distanceTo(from)).toBeGreaterThanOrEqual(1);
    expect(middle.distanceTo(from)).toBeLessThanOrEqual(1.5);
    expect(middle.clone().sub(from).angleTo(AHEAD)).toBeLessThan(1.1);
  });

  it("is straight ahead where nothing stands", () => {
    const eyes = new Vector3(0, 1.2, 0);
    const middle = findFreePlace(eyes, AHEAD, new Float32Array(), PANEL_HALF_M);
    expect(middle.x).toBeCloseTo(0);
    expect(middle.z).toBeLessThan(-1.2);
    expect(middle.y).toBeLessThan(1.2);
  });

  it("is beside or above what stands ahead", () => {
    const eyes = new Vector3(0, 1.2, 0);
    const pole = new Mesh(new BoxGeometry(0.1, 3, 0.1), MATERIAL);
    pole.position.set(0, 1, -0.7);
    const scene = new Group().add(pole);
    const middle = findFreePlace(eyes, AHEAD, new SurfacePoints(scene).around(eyes), PANEL_HALF_M);
    expect(nearest(scene, eyes, middle)).toBe(Infinity);
    const behind = new Vector3(0, 1.1, -1.25);
    expect(nearest(scene, eyes, behind)).toBeLessThan(1);
    const points = new SurfacePoints(scene).around(eyes);
    expect([middle, behind].map((place) => isFree(eyes, place, points, PANEL_HALF_M))).toEqual([true, false]);
  });
});

describe("for a participant who leans back", () => {
  it.each([0, -0.4, 0.4])("the panel has the place in the view as for one who sits upright, %f rad to the right", (turn) => {
    const eyes = new Vector3(0, 1, 0);
    const [across, preferred] = [new Vector3(1, 0, 0), { distance: 1.25, turn }];
    const placeOf = (reclineRad: number) =>
      findFreePlace(eyes, AHEAD, new Float32Array(), PANEL_HALF_M, reclineRad, preferred).sub(eyes);
    for (const reclineRad of [Math.PI / 6, Math.PI / 4]) {
      const inView = placeOf(reclineRad).applyAxisAngle(across, -reclineRad);
      expect(inView.distanceTo(placeOf(0))).toBeLessThan(1e-9);
      expect(upOfView(AHEAD, reclineRad).applyAxisAngle(across, -reclineRad).y).toBeCloseTo(1);
    }
  });
});
