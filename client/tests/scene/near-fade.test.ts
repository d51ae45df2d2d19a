import { BoxGeometry, Group, InstancedMesh, Mesh, MeshStandardMaterial, Object3D, ShaderLib, type WebGLProgramParametersWithUniforms } from "three";
import { describe, expect, it } from "vitest";
import { SceneContent } from "../../src/scene/scene-content";
import type { Scene } from "../../src/generated/messages";
import { FADE_DISTANCE_M, fadeNearEyes } from "../../src/scene/near-fade";

/** The fragment shader that a material is compiled to. */
function fragmentShader(material: MeshStandardMaterial): string {
  const shader = { fragmentShader: ShaderLib.standard.fragmentShader } as WebGLProgramParametersWithUniforms;
  material.onBeforeCompile(shader, undefined as never);
  return shader.fragmentShader;
}

describe("what comes near the eyes", () => {
  it("fades within 8 cm, smoothly, by the distance from the eye", () => {
    expect(FADE_DISTANCE_M).toBe(0.08);
    const material = new MeshStandardMaterial();
    fadeNearEyes(material);
    const shader = fragmentShader(material);
    const fade = shader.indexOf("smoothstep(0.040, 0.080, length(vViewPosition))");
    expect(fade).toBeGreaterThan(shader.indexOf("varying vec3 vViewPosition"));
    expect(fade).toBeGreaterThan(shader.indexOf("#include <map_fragment>"));
    expect(fade).toBeLessThan(shader.indexOf("#include <opaque_fragment>"));
    expect(material.alphaHash).toBe(false);
    expect(material.transparent).toBe(true);
  });

  it("hides what is behind as opaque things do, but for what is transparent anyway", () => {
    const [solid, glass] = [new MeshStandardMaterial(), new MeshStandardMaterial({ transparent: true })];
    for (const material of [solid, glass]) fadeNearEyes(material);
    expect([solid.depthWrite, glass.depthWrite]).toEqual([true, false]);
  });

  it("is the robot with its tool and what that carries, and nothing that shares a material with them", () => {
    const shared = new MeshStandardMaterial();
    const [tool, chair, drops] = [{ body: "robot/tool" }, { body: "wheelchair" }, { bodies: ["water_0"] }].map(
      (extras) => {
        const mesh = new Mesh(new BoxGeometry(), shared);
        mesh.userData = extras;
        return mesh;
      },
    );
    const carrier = new Object3D();
    carrier.userData = { body: "robot/link_1" };
    const link = new Mesh(new BoxGeometry(), shared);
    carrier.add(link);
    const scene = { bodies: ["robot/tool", "robot/link_1", "wheelchair", "water_0"], head_bodies: [], marks: 0 };
    const group = new Group().add(tool!, chair!, drops!, carrier);
    new SceneContent(group, scene as unknown as Scene);
    const fading = (mesh: Mesh) => (mesh.material as MeshStandardMaterial).transparent;
    const copies = group.children.find((child) => child instanceof InstancedMesh) as InstancedMesh;
    expect([tool!, link, copies, chair!].map(fading)).toEqual([true, true, true, false]);
  });
});
