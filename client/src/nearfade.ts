import type { Material } from "three";

/** From here on towards the eyes things fade, and at half of it they are gone: eyes cannot fuse what is so near. */
export const FADES_M = 0.08;

const FADE = `
  diffuseColor.a *= smoothstep(${(FADES_M / 2).toFixed(3)}, ${FADES_M.toFixed(3)}, length(vViewPosition));`;
const AFTER = "#include <alphamap_fragment>";

/**
 * Lets what is drawn with a lit material fade near the eyes.
 *
 * By dots that stick to the surface, the same for both eyes, so that nothing has to be sorted by depth.
 */
export function fadeNearEyes(material: Material): void {
  material.alphaHash = true;
  material.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace(AFTER, AFTER + FADE);
  };
  material.customProgramCacheKey = () => FADE;
}
