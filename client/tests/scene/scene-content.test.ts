import {
  BoxGeometry,
  BufferGeometry,
  Float32BufferAttribute,
  Group,
  InstancedMesh,
  Matrix4,
  Mesh,
  MeshStandardMaterial,
  Object3D,
  Quaternion,
  Vector3,
} from "three";
import { describe, expect, it } from "vitest";
import { SceneContent } from "../../src/scene/scene-content";
import { POSE } from "../../src/scene/state-interpolation";
import type { Scene } from "../../src/generated/messages";

const BODIES = ["upper_arm", "forearm", "drop_0", "drop_1"];

const SCENE = {
  type: "scene",
  url: "/scenes/0.glb",
  bodies: BODIES,
  head_bodies: ["head"],
  marks: 2,
  mark_radius_m: 0.01,
  mark_rgb: [1, 0, 0],
  xr_from_world: [
    [0, 0, 0],
    [0, 0, 0, 1],
  ],
} as unknown as Scene;

function node(extras: Record<string, unknown>, made = new Object3D()): Object3D {
  made.userData = extras;
  return made;
}

function box(): Mesh {
  return new Mesh(new BoxGeometry(), new MeshStandardMaterial());
}

function poses(turns: Partial<Record<string, Quaternion>>): Float32Array {
  const all = new Float32Array((BODIES.length + SCENE.marks) * POSE);
  for (let index = 0; index < BODIES.length + SCENE.marks; index++) {
    const { x, y, z, w } = turns[BODIES[index] ?? ""] ?? new Quaternion();
    all.set([index, 2 * index, 3 * index, w, x, y, z], index * POSE);
  }
  return all;
}

function about(x: number, y: number, z: number, angle: number): Quaternion {
  return new Quaternion().setFromAxisAngle(new Vector3(x, y, z).normalize(), angle);
}

/** How far apart two rotations are, radians. */
function apart(a: Quaternion, b: Quaternion): number {
  return a.angleTo(b);
}

function placeOf(mesh: InstancedMesh, index: number): Vector3 {
  const matrix = new Matrix4();
  mesh.getMatrixAt(index, matrix);
  return new Vector3().setFromMatrixPosition(matrix);
}

function copiesIn(group: Group): InstancedMesh[] {
  return group.children.filter((child) => child instanceof InstancedMesh);
}

describe("what a scene shows", () => {
  it("puts each node where its body is", () => {
    const arm = node({ body: "forearm" });
    const turn = about(1, 2, 3, 0.7);
    new SceneContent(new Group().add(arm), SCENE).place(poses({ forearm: turn }));
    expect(arm.position.toArray()).toEqual([1, 2, 3]);
    expect(apart(arm.quaternion, turn)).toBeLessThan(1e-6);
  });

  it("leaves alone what names no body of the scene", () => {
    const stranger = node({ body: "tail" });
    new SceneContent(new Group().add(stranger), SCENE).place(poses({}));
    expect(stranger.position.toArray()).toEqual([0, 0, 0]);
  });

  it("takes a limb's twist out of its swing, and nothing else", () => {
    const parent = about(3, -1, 2, 1.1);
    const bend = about(1, 0.4, 0, -1.3);
    for (const twist of [-1.5, 0, 0.6, 1.5]) {
      const swing = node({ swing: "forearm", parent: "upper_arm" });
      const body = parent.clone().multiply(bend).multiply(about(0, 0, 1, twist));
      new SceneContent(new Group().add(swing), SCENE).place(poses({ upper_arm: parent, forearm: body }));
      expect(apart(swing.quaternion, parent.clone().multiply(bend))).toBeLessThan(1e-3);
      expect(swing.position.toArray()).toEqual([1, 2, 3]);
    }
  });

  it("stays finite where a limb is folded back on itself", () => {
    const swing = node({ swing: "forearm", parent: "upper_arm" });
    const content = new SceneContent(new Group().add(swing), SCENE);
    content.place(poses({ forearm: about(1, 0, 0, Math.PI) }));
    expect(swing.quaternion.length()).toBeCloseTo(1, 6);
  });

  it("draws bodies that look alike, and the marks, in one call each", () => {
    const group = new Group().add(node({ bodies: ["drop_0", "drop_1"] }, box()));
    new SceneContent(group, SCENE).place(poses({}));
    const [drops, marks] = copiesIn(group);
    expect(group.children).toEqual([drops, marks]);
    expect([drops!.count, marks!.count]).toEqual([2, 2]);
    expect(placeOf(drops!, 1).toArray()).toEqual([3, 6, 9]);
    expect(placeOf(marks!, 1).toArray()).toEqual([5, 10, 15]);
  });

  it("draws cloth with its vertices at their bodies, lit by its present shape", () => {
    const sheet = new Mesh(new BufferGeometry(), new MeshStandardMaterial());
    sheet.geometry.setAttribute("position", new Float32BufferAttribute([0, 0, 0, 1, 0, 0, 0, 1, 0], 3));
    sheet.geometry.setIndex([0, 1, 2]);
    const group = new Group().add(node({ vertices: ["forearm", "drop_0", "drop_1"] }, sheet));
    const content = new SceneContent(group, SCENE);
    const moved = poses({});
    moved[BODIES.indexOf("drop_0") * POSE]! += 1;
    content.place(moved);
    const corner = (name: string, at: number) =>
      new Vector3().fromBufferAttribute(sheet.geometry.getAttribute(name), at);
    expect([0, 1, 2].map((at) => corner("position", at).toArray())).toEqual([
      [1, 2, 3],
      [3, 4, 6],
      [3, 6, 9],
    ]);
    const normal = corner("normal", 0);
    expect(normal.length()).toBeCloseTo(1, 5);
    expect(normal.dot(new Vector3(2, 2, 3))).toBeCloseTo(0, 5);
  });

  it("hides the head from inside, and only the head", () => {
    const [head, hand] = [box(), box()];
    hand.material = head.material;
    const group = new Group().add(node({ skin_of: "head" }, head), node({ skin_of: "hand" }, hand));
    const content = new SceneContent(group, SCENE);
    content.setFirstPerson(true);
    expect((head.material as MeshStandardMaterial).colorWrite).toBe(false);
    expect((hand.material as MeshStandardMaterial).colorWrite).toBe(true);
    content.setFirstPerson(false);
    expect((head.material as MeshStandardMaterial).colorWrite).toBe(true);
  });
});
