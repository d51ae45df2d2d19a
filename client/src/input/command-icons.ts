import { Group, Quaternion, Vector3 } from "three";
import { CanvasPlane } from "../panel/canvas-plane";
import { paintCommand } from "../panel/paint-panel";
import { findFreePlace, upOfView } from "../panel/panel-placement";
import type { CommandLabel, PresentationPreferences, SelectionTarget } from "../generated/messages";
import { PRESENTATION } from "./input-profile";

/** Value of the first icon as a target. Buttons of the panel have smaller values. */
export const FIRST_ICON = 1000;
const PIXELS = 256;
const SIZE_M = 0.13;
const PITCH_M = 0.145;
const DISTANCE_M = 1;
/** Angle between the robot's tool and the icons. */
const ASIDE_RAD = (22 * Math.PI) / 180;
/** Greatest angle between the icons and the viewing direction in which they appear. */
const IN_VIEW_RAD = (28 * Math.PI) / 180;
/** Range of the elevation of the icons in the view of the participant at rest. */
const [LOWEST_RAD, HIGHEST_RAD] = [-15, 40].map((angle) => (angle * Math.PI) / 180) as [number, number];
/** Most icons in a column. */
const ROWS = 4;
/** Number of steps of a ring. */
const STEPS = 24;

/** Icons of robot commands in VR, next to the robot, for participants who select by dwell or switches. */
export class CommandIcons {
  readonly group = new Group();
  private icons: Icon[] = [];
  private key = "";
  private placed = false;
  private readonly eyes = new Vector3();
  private readonly gaze = new Vector3();
  private readonly turn = new Quaternion();

  constructor() {
    this.group.visible = false;
  }

  /** Shows an icon for each command; none hide them. */
  show(commands: readonly CommandLabel[], { contrast, text_deg }: PresentationPreferences): void {
    const key = JSON.stringify([commands, contrast, text_deg]);
    if (key === this.key) return;
    this.key = key;
    for (const { plane } of this.icons) plane.dispose();
    this.icons = commands.map((command) => new Icon(command, contrast));
    this.group.clear();
    const rows = Math.min(commands.length, ROWS);
    const columns = Math.ceil(commands.length / ROWS);
    this.icons.forEach(({ plane: { mesh } }, at) => {
      const [column, row] = [Math.floor(at / ROWS), at % ROWS];
      mesh.position.set((column - (columns - 1) / 2) * PITCH_M, ((rows - 1) / 2 - row) * PITCH_M, 0);
      this.group.add(mesh);
    });
    this.group.scale.setScalar(text_deg / PRESENTATION.text_deg);
    this.group.visible = this.placed = false;
  }

  /** The icons as targets. */
  get targets(): SelectionTarget[] {
    return this.icons.map(({ command }, at) => ({ value: FIRST_ICON + at, label: command.label }));
  }

  /** The command of a target, or null. */
  commandOf(value: number): CommandLabel["name"] | null {
    return this.icons[value - FIRST_ICON]?.command.name ?? null;
  }

  /**
   * Places new icons once, at the robot's side that is away from the stop sign, or on the preferred side.
   *
   * `reclineRad`: recline angle of the participant. The icons are in the view of a head that rests at this angle.
   */
  place(
    viewer: XRViewerPose | undefined,
    robot: Vector3 | null,
    surfacePoints: (eyes: Vector3) => Float32Array,
    { position }: PresentationPreferences,
    reclineRad = 0,
  ): void {
    if (this.placed || this.icons.length === 0 || !viewer) return;
    this.see(viewer);
    const ahead = robot ? robot.clone().sub(this.eyes).normalize() : this.gaze.clone();
    const up = upOfView(this.gaze, reclineRad);
    const elevation = Math.min(Math.max(Math.asin(ahead.dot(up)), LOWEST_RAD), HIGHEST_RAD);
    const { x, y } = this.group.scale.clone().multiplyScalar(PITCH_M / 2);
    const half = { x: x * Math.ceil(this.icons.length / ROWS), y: y * Math.min(this.icons.length, ROWS) };
    const turn = angleTo(this.gaze, ahead, up) + (position === "left" ? -ASIDE_RAD : ASIDE_RAD);
    const preferred = { distance: DISTANCE_M, turn: Math.min(Math.max(turn, -IN_VIEW_RAD), IN_VIEW_RAD) };
    const points = surfacePoints(this.eyes);
    this.group.position.copy(findFreePlace(this.eyes, this.gaze, points, half, reclineRad + elevation, preferred));
    this.group.up.copy(up);
    this.group.lookAt(this.eyes);
    this.group.updateMatrixWorld(true);
    this.group.visible = this.placed = true;
  }

  /** The icon at which the head points, or null. */
  look(viewer: XRViewerPose | undefined): number | null {
    if (!this.group.visible || !viewer) return null;
    this.see(viewer);
    const at = this.icons.findIndex(({ plane: { mesh } }) => {
      const away = mesh.getWorldPosition(new Vector3()).sub(this.eyes);
      return away.angleTo(this.gaze) < Math.atan((SIZE_M / 2) * this.group.scale.x / away.length());
    });
    return at < 0 ? null : FIRST_ICON + at;
  }

  /** Highlights an icon, with a ring that is full at `progress` 1. */
  highlight(value: number | null, progress: number): void {
    this.icons.forEach((icon, at) => icon.paint(value === FIRST_ICON + at, value === FIRST_ICON + at ? progress : 0));
  }

  /** The centre of an icon in `local-floor`; null while it is not placed. */
  centreOf(value: number): Vector3 | null {
    const icon = this.icons[value - FIRST_ICON];
    return icon && this.group.visible ? icon.plane.mesh.getWorldPosition(new Vector3()) : null;
  }

  private see({ transform: { position, orientation } }: XRViewerPose): void {
    this.eyes.set(position.x, position.y, position.z);
    this.turn.set(orientation.x, orientation.y, orientation.z, orientation.w);
    this.gaze.set(0, 0, -1).applyQuaternion(this.turn);
  }
}

/** The angle about an axis from one direction to another, positive to the right. */
function angleTo(from: Vector3, to: Vector3, up: Vector3): number {
  return -Math.atan2(up.dot(from.clone().cross(to)), from.dot(to) - from.dot(up) * to.dot(up));
}

/** One icon: a disc with symbol, label and ring. */
class Icon {
  readonly plane = new CanvasPlane(PIXELS, PIXELS, SIZE_M);
  private painted = "";

  constructor(
    readonly command: CommandLabel,
    private readonly contrast: PresentationPreferences["contrast"],
  ) {
    this.plane.mesh.visible = true;
    this.plane.mesh.material.depthTest = false;
    this.paint(false, 0);
  }

  paint(highlighted: boolean, progress: number): void {
    const share = Math.round(progress * STEPS) / STEPS;
    const wanted = `${highlighted} ${share}`;
    if (wanted === this.painted) return;
    this.painted = wanted;
    this.plane.paint((context) => paintCommand(context, this.command, this.contrast, highlighted, share, PIXELS));
  }
}
