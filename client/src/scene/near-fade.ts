import type { Material } from "three";

/** Distance from the eyes at which objects begin to fade; at half of it they are invisible. */
export const FADE_DISTANCE_M = 0.08;

const FADE = `
  diffuseColor.a *= smoothstep(${(FADE_DISTANCE_M / 2).toFixed(3)}, ${FADE_DISTANCE_M.toFixed(3)}, length(vViewPosition));
  if (diffuseColor.a < 0.01) discard;`;
const AFTER = "#include <alphamap_fragment>";

/**
 * Makes a lit material fade near the eyes.
 *
 * It is blended with the background, and writes depth as opaque materials do, so its parts need no sorting.
 */
export function fadeNearEyes(material: Material): void {
  material.depthWrite = !material.transparent;
  material.transparent = true;
  material.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace(AFTER, AFTER + FADE);
  };
  material.customProgramCacheKey = () => FADE;
}
