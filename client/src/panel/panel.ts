import { BufferGeometry, Mesh, MeshBasicMaterial, RingGeometry, Vector3 } from "three";
import { CanvasPlane, OVERLAY_ORDER } from "./canvas-plane";
import type { PanelContent } from "../session/display-state";
import { findFreePlace, isFree, upOfView, type HalfSize, type PreferredPlace } from "./panel-placement";
import type { BodyChoice, PresentationPreferences, SelectionTarget } from "../generated/messages";
import { PRESENTATION } from "../input/input-profile";
import { HEIGHT, WIDTH, bodiesOf, buttonLabel, buttonsOf, paint } from "./paint-panel";
import { hitButton, type Button } from "./questionnaire";

const PANEL_WIDTH_M = 0.7;
const PANEL_HEIGHT_M = (PANEL_WIDTH_M * HEIGHT) / WIDTH;
const PIXELS_PER_M = WIDTH / PANEL_WIDTH_M;
export const PANEL_HALF_M = { x: PANEL_WIDTH_M / 2, y: PANEL_HEIGHT_M / 2 };

/** The intersection of a ray with the panel: distance in metres, the button there, and the place from the middle. */
export interface PanelHit {
  distance: number;
  value: number | null;
  x: number;
  y: number;
}

const RING_M = { outer: 0.032, inner: 0.022 };
const RING_STEPS = 40;
/** Minimum time between changes of the highlight: three flashes a second (WCAG 2.2, criterion 2.3.1). */
const HIGHLIGHT_MS = 1000 / 6;
/** A panel on the left or right: angle between straight ahead and its inner edge, and most angle to its outer edge. */
const [INNER_RAD, OUTER_RAD] = [4, 42].map((angle) => (angle * Math.PI) / 180) as [number, number];
const SIDES = { left: -1, centre: 0, right: 1 };

/** The text panel in VR. It is placed in front of the participant when it appears, and then stays. */
export class Panel {
  readonly mesh: CanvasPlane["mesh"];
  buttons: Button[] = [];
  hovered: number | null = null;
  /** The number of the offered targets. */
  offer = 0;
  private readonly ring = new Mesh(new BufferGeometry(), new MeshBasicMaterial({ color: 0xb8860b, transparent: true, depthTest: false, depthWrite: false, toneMapped: false }));
  private ringStep = 0;
  private readonly plane: CanvasPlane;
  private content: PanelContent | null = null;
  private placed = false;
  private reviewed = false;
  private presentation = PRESENTATION;
  private highlightedMs = -Infinity;
  private readonly origin = new Vector3();
  private readonly direction = new Vector3();

  constructor(anisotropy: number) {
    this.plane = new CanvasPlane(WIDTH, HEIGHT, PANEL_WIDTH_M);
    this.plane.texture.anisotropy = anisotropy;
    this.mesh = this.plane.mesh;
    this.ring.renderOrder = OVERLAY_ORDER + 2;
    this.ring.visible = false;
    this.mesh.add(this.ring);
  }

  get visible(): boolean {
    return this.content !== null;
  }

  show(content: PanelContent | null): void {
    if (JSON.stringify(content) === JSON.stringify(this.content)) return;
    this.content = content;
    this.buttons = buttonsOf(content);
    if (!this.buttons.some(({ value }) => value === this.hovered)) this.hovered = null;
    if (!content) this.placed = false;
    this.mesh.visible = content !== null && this.placed;
    this.repaint();
  }

  /** The buttons as targets, in the order of a scan. */
  get targets(): SelectionTarget[] {
    const { content } = this;
    return content ? this.buttons.map(({ value }) => ({ value, label: buttonLabel(content, value) })) : [];
  }

  /** The body of the button with this value, or null. */
  choice(value: number | null): BodyChoice | null {
    return bodiesOf(this.content).find((button) => button.value === value)?.message ?? null;
  }

  /** Changes size, distance, position and contrast. */
  present(presentation: PresentationPreferences): void {
    if (JSON.stringify(presentation) === JSON.stringify(this.presentation)) return;
    this.presentation = presentation;
    this.mesh.scale.setScalar(this.scale);
    this.unplace();
    this.repaint();
  }

  private get scale(): number {
    const { text_deg, panel_distance_m } = this.presentation;
    return (text_deg * panel_distance_m) / (PRESENTATION.text_deg * PRESENTATION.panel_distance_m);
  }

  private get half(): HalfSize {
    return { x: PANEL_HALF_M.x * this.scale, y: PANEL_HALF_M.y * this.scale };
  }

  private get preferred(): PreferredPlace {
    const { panel_distance_m: distance, position } = this.presentation;
    const half = Math.atan(this.half.x / distance);
    return { distance, turn: SIDES[position] * Math.min(half + INNER_RAD, OUTER_RAD - half) };
  }

  /** Highlights a button, with a ring that is full at `progress` 1. A trembling ray does not make the panel flash. */
  hover(value: number | null, progress: number, nowMs: number): void {
    this.fillRing(value, Math.round(progress * RING_STEPS));
    if (value === this.hovered || nowMs - this.highlightedMs < HIGHLIGHT_MS) return;
    this.hovered = value;
    this.highlightedMs = nowMs;
    this.repaint();
  }

  private fillRing(value: number | null, step: number): void {
    const button = this.buttons.find((each) => each.value === value);
    this.ring.visible = !!button && step > 0;
    if (!button || step === 0) return;
    const aside = button.width > 1.6 * button.height ? button.height : button.width;
    this.ring.position.copy(this.localPoint(button.x + aside / 2, button.y + button.height / 2)).setZ(0.002);
    if (step === this.ringStep) return;
    this.ringStep = step;
    this.ring.geometry.dispose();
    const length = (2 * Math.PI * step) / RING_STEPS;
    this.ring.geometry = new RingGeometry(RING_M.inner, RING_M.outer, RING_STEPS, 1, Math.PI / 2 - length, length);
  }

  private localPoint(x: number, y: number): Vector3 {
    return new Vector3((x - WIDTH / 2) / PIXELS_PER_M, (HEIGHT / 2 - y) / PIXELS_PER_M, 0);
  }

  /** The next `place` chooses a new place. */
  unplace(): void {
    this.placed = false;
  }

  /** The next `place` chooses a new place if the present one is no longer free. */
  review(): void {
    this.reviewed = false;
  }

  /** Places a new panel in a free place close to the viewing direction. */
  place(head: Vector3, forward: Vector3, surfacePoints: (eyes: Vector3) => Float32Array, reclineRad = 0): void {
    if (!this.content || (this.placed && this.reviewed)) return;
    const points = surfacePoints(head);
    const stays = this.placed && isFree(head, this.mesh.position, points, this.half, this.mesh.up);
    this.placed = this.reviewed = true;
    this.mesh.visible = true;
    if (stays) return;
    this.mesh.position.copy(findFreePlace(head, forward, points, this.half, reclineRad, this.preferred));
    this.mesh.up.copy(upOfView(forward, reclineRad));
    this.mesh.lookAt(head);
    this.mesh.updateMatrixWorld();
  }

  /** Computes the intersection with a ray in `local-floor`; false without intersection. */
  hit(origin: Vector3, direction: Vector3, into: PanelHit): boolean {
    if (!this.mesh.visible) return false;
    const from = this.mesh.worldToLocal(this.origin.copy(origin));
    const to = this.mesh.worldToLocal(this.direction.copy(origin).add(direction)).sub(from);
    const distance = -from.z / to.z;
    const x = from.x + to.x * distance;
    const y = from.y + to.y * distance;
    if (!(distance > 0) || Math.abs(x) > PANEL_WIDTH_M / 2 || Math.abs(y) > PANEL_HEIGHT_M / 2) return false;
    Object.assign(into, { distance, x, y });
    into.value = hitButton(this.buttons, x * PIXELS_PER_M + WIDTH / 2, HEIGHT / 2 - y * PIXELS_PER_M);
    return true;
  }

  /** The centre of a button in `local-floor`. */
  centreOf(button: Button): Vector3 {
    return this.mesh.localToWorld(this.localPoint(button.x + button.width / 2, button.y + button.height / 2));
  }

  private repaint(): void {
    const { content } = this;
    if (content) this.plane.paint((context) => paint(context, content, this.buttons, this.hovered, this.presentation.contrast));
  }
}
