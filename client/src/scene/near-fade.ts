import type { Material } from "three";

/** From here on towards the eyes things fade, and at half of it they are gone: eyes cannot fuse what is so near. */
export const FADE_DISTANCE_M = 0.08;

const FADE = `
  diffuseColor.a *= smoothstep(${(FADE_DISTANCE_M / 2).toFixed(3)}, ${FADE_DISTANCE_M.toFixed(3)}, length(vViewPosition));
  if (diffuseColor.a < 0.01) discard;`;
const AFTER = "#include <alphamap_fragment>";

/**
 * Lets what is drawn with a lit material fade near the eyes.
 *
 * It is blended with what is behind. It writes its depth as opaque things do, so that its own parts need no sorting.
 */
export function fadeNearEyes(material: Material): void {
  material.depthWrite = !material.transparent;
  material.transparent = true;
  material.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace(AFTER, AFTER + FADE);
  };
  material.customProgramCacheKey = () => FADE;
}
