import { Vector3 } from "three";
import { CanvasPlane } from "./canvas-plane";
import type { PanelContent } from "../session/display-state";
import { findFreePlace, isFree } from "./panel-placement";
import type { ChooseBody } from "../generated/messages";
import { HEIGHT, WIDTH, bodiesOf, buttonsOf, paint } from "./paint-panel";
import { hitButton, type Button } from "./questionnaire";

const PANEL_WIDTH_M = 0.7;
const PANEL_HEIGHT_M = (PANEL_WIDTH_M * HEIGHT) / WIDTH;
const PIXELS_PER_M = WIDTH / PANEL_WIDTH_M;
export const PANEL_HALF_M = { x: PANEL_WIDTH_M / 2, y: PANEL_HEIGHT_M / 2 };

/** The intersection of a ray with the panel: distance in metres, and the button there. */
export interface PanelHit {
  distance: number;
  value: number | null;
}

/** The text panel in VR. It is placed in front of the participant when it appears, and then stays. */
export class Panel {
  readonly mesh: CanvasPlane["mesh"];
  buttons: Button[] = [];
  hovered: number | null = null;
  private readonly plane: CanvasPlane;
  private content: PanelContent | null = null;
  private placed = false;
  private reviewed = false;
  private readonly origin = new Vector3();
  private readonly direction = new Vector3();

  constructor(anisotropy: number) {
    this.plane = new CanvasPlane(WIDTH, HEIGHT, PANEL_WIDTH_M);
    this.plane.texture.anisotropy = anisotropy;
    this.mesh = this.plane.mesh;
  }

  get visible(): boolean {
    return this.content !== null;
  }

  show(content: PanelContent | null): void {
    if (JSON.stringify(content) === JSON.stringify(this.content)) return;
    this.content = content;
    this.buttons = buttonsOf(content);
    this.hovered = null;
    if (!content) this.placed = false;
    this.mesh.visible = content !== null && this.placed;
    this.repaint();
  }

  /** The body of the button with this value, or null. */
  choice(value: number | null): ChooseBody | null {
    return bodiesOf(this.content).find((button) => button.value === value)?.message ?? null;
  }

  hover(value: number | null): void {
    if (value === this.hovered) return;
    this.hovered = value;
    this.repaint();
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
  place(head: Vector3, forward: Vector3, surfacePoints: (eyes: Vector3) => Float32Array): void {
    if (!this.content || (this.placed && this.reviewed)) return;
    const points = surfacePoints(head);
    const stays = this.placed && isFree(head, this.mesh.position, points, PANEL_HALF_M);
    this.placed = this.reviewed = true;
    this.mesh.visible = true;
    if (stays) return;
    this.mesh.position.copy(findFreePlace(head, forward, points, PANEL_HALF_M));
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
    into.distance = distance;
    into.value = hitButton(this.buttons, x * PIXELS_PER_M + WIDTH / 2, HEIGHT / 2 - y * PIXELS_PER_M);
    return true;
  }

  /** The centre of a button in `local-floor`. */
  centreOf(button: Button): Vector3 {
    const x = (button.x + button.width / 2 - WIDTH / 2) / PIXELS_PER_M;
    const y = (HEIGHT / 2 - button.y - button.height / 2) / PIXELS_PER_M;
    return this.mesh.localToWorld(new Vector3(x, y, 0));
  }

  private repaint(): void {
    const { content } = this;
    if (content) this.plane.paint((context) => paint(context, content, this.buttons, this.hovered));
  }
}
