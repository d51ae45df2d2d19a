import { Vector3 } from "three";
import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import type { PresentationPreferences } from "../../src/generated/messages";
import { PRESENTATION } from "../../src/input/input-profile";
import { CaptionPlane, Captions } from "../../src/panel/caption";
import { HEIGHT, WIDTH } from "../../src/panel/paint-panel";
import { Panel } from "../../src/panel/panel";
import type { PanelContent } from "../../src/session/display-state";
import { ENGLISH_TEXTS } from "../../src/page/texts";

const EYES = new Vector3(0.2, 1.2, 0.1);
const AHEAD = new Vector3(0, 0, -1);
const CONTENT: PanelContent = {
  ...{ texts: ENGLISH_TEXTS, label: "", text: "Ready?", secondsLeft: null, question: null, body: null, answered: null },
  ...{ notice: null, confirms: false, again: false, rests: false, prefers: false, goesOn: true, staged: false, segment: null },
};
const DEGREE = Math.PI / 180;

const paints = vi.fn();
beforeEach(() => {
  const context = new Proxy({} as Record<string, unknown>, {
    get: (values, name) => (name === "measureText" ? () => ({ width: 10 }) : (values[name as string] ?? paints)),
    set: () => true,
  });
  vi.stubGlobal("document", { createElement: () => ({ getContext: () => context }) });
});
afterEach(() => vi.unstubAllGlobals());

function placed(changes: Partial<PresentationPreferences>): Panel {
  const panel = new Panel(1);
  panel.present({ ...PRESENTATION, ...changes });
  panel.show(CONTENT);
  panel.place(EYES, AHEAD, () => new Float32Array());
  panel.mesh.updateMatrixWorld();
  return panel;
}

/** The direction from the eyes to a point of the panel: angle to the right of straight ahead. */
function angleOf(panel: Panel, x: number): number {
  const width = panel.mesh.geometry.parameters.width;
  const { x: aside, z } = panel.mesh.localToWorld(new Vector3((x * width) / 2, 0, 0)).sub(EYES);
  return Math.atan2(aside, -z) / DEGREE;
}

describe("the panel", () => {
  it.each([1, 1.5, 2, 3])("has a font size of %s° for items, at every distance", (text_deg) => {
    for (const panel_distance_m of [0.75, 1.25, 2]) {
      const panel = placed({ text_deg, panel_distance_m });
      const item = (72 / WIDTH) * panel.mesh.geometry.parameters.width * panel.mesh.scale.x;
      expect(item / EYES.distanceTo(panel.mesh.position) / DEGREE).toBeCloseTo(text_deg, 1);
      expect(EYES.distanceTo(panel.mesh.position)).toBeCloseTo(panel_distance_m);
    }
  });

  it.each([1, 1.5, 1.9, 3])("is on the preferred side and in view with a font size of %s°", (text_deg) => {
    const [left, right] = (["left", "right"] as const).map((position) => placed({ text_deg, position }));
    if (text_deg < 2) expect(Math.max(angleOf(left!, -1), angleOf(left!, 1))).toBeLessThan(0);
    if (text_deg < 2) expect(Math.min(angleOf(right!, -1), angleOf(right!, 1))).toBeGreaterThan(0);
    expect([angleOf(left!, 0) < -10, angleOf(right!, 0) > 10]).toEqual([true, true]);
    for (const panel of [left!, right!]) for (const x of [-1, 1]) expect(Math.abs(angleOf(panel, x))).toBeLessThan(43);
    expect(angleOf(placed({ text_deg }), 0)).toBeCloseTo(0);
  });

  it("does not flash faster than three times a second when a ray trembles at the edge of a button", () => {
    const panel = placed({});
    const shown = [...Array(1000).keys()].map((frame) => {
      panel.hover(Math.floor(frame / 4) % 2 ? panel.buttons[0]!.value : null, 0, (1000 * frame) / 90);
      return panel.hovered;
    });
    const changes = shown.filter((value, at) => at > 0 && value !== shown[at - 1]).length;
    expect(changes / 2 / (1000 / 90)).toBeLessThanOrEqual(3);
    expect(changes).toBeGreaterThan(30);
  });

  it("is hit where it is drawn, at every size", () => {
    const panel = placed({ text_deg: 2.4, position: "left" });
    const [button] = panel.buttons;
    const into = { distance: 0, value: null, x: 0, y: 0 };
    const centre = panel.centreOf(button!);
    expect(panel.hit(EYES, centre.clone().sub(EYES).normalize(), into)).toBe(true);
    expect(into.value).toBe(button!.value);
    expect(into.distance).toBeCloseTo(centre.distanceTo(EYES));
    expect(HEIGHT).toBeLessThan(WIDTH);
  });
});

describe("a caption", () => {
  it("remains for three seconds, and while the text is read", () => {
    let sounding = false;
    const captions = new Captions(() => sounding);
    expect(captions.at(0)).toBe("");
    captions.begin("♪", 0);
    expect([2900, 3000].map((ms) => captions.at(ms))).toEqual(["♪", ""]);
    captions.begin("Ready?", 4000);
    sounding = true;
    expect(captions.at(9000)).toBe("Ready?");
    sounding = false;
    expect(captions.at(9100)).toBe("");
  });

  it("follows the head, on the preferred side below the middle", () => {
    const caption = new CaptionPlane();
    caption.show("♪", [[0, 1.2, 0], [0, 0, 0, 1]], { ...PRESENTATION, position: "right" });
    const { x, y, z } = caption.mesh.position;
    expect([caption.mesh.visible, x > 0.1, y < 1.2, z < -0.8]).toEqual([true, true, true, true]);
    caption.show("", [[0, 1.2, 0], [0, 0, 0, 1]], PRESENTATION);
    expect(caption.mesh.visible).toBe(false);
  });
});
