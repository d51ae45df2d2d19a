import { PerspectiveCamera, Quaternion, Vector3, type Object3D } from "three";
import type {
  CommandName,
  ExperimenterMessage,
  Scene,
  State,
  Status,
  Timing,
  Vector3 as Triple,
  Welcome,
} from "./messages";
import { POSE } from "./interpolation";
import { statusWords, timingWords } from "./status";

function element<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

/** The page of those who watch: the participant's own view on demand, how things stand, and the experimenter's commands. */
export class Watching {
  /** Looks ahead along -z, as cameras do; the head's own axes are x left, -y ahead, z up. */
  readonly eyes = new PerspectiveCamera(75, 1, 0.03, 30);
  fromInside = false;
  private headAt = -1;
  private eyesInHead = new Vector3();

  constructor(
    private readonly send: (message: ExperimenterMessage) => void,
    private readonly viewChanged: (fromInside: boolean) => void,
  ) {
    element("watch").hidden = false;
    element<HTMLInputElement>("from-inside").addEventListener("change", (event) => {
      this.fromInside = (event.target as HTMLInputElement).checked;
      this.viewChanged(this.fromInside);
    });
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-command]"))
      button.addEventListener("click", () =>
        this.send({ type: "command", name: button.dataset["command"] as CommandName }),
      );
    element<HTMLFormElement>("height-form").addEventListener("submit", (event) => this.correctHeight(event));
  }

  welcomed({ role }: Welcome): void {
    element("commands").hidden = role !== "experimenter";
  }

  sceneCame({ bodies, head_bodies, eyes }: Scene): void {
    this.headAt = bodies.indexOf(head_bodies[0]!) * POSE;
    this.eyesInHead.set(...(eyes as Triple));
  }

  statusCame(status: Status): void {
    for (const [id, text] of Object.entries(statusWords(status))) element(id).textContent = text;
    element<HTMLButtonElement>("pause").dataset["command"] = status.paused ? "continue" : "pause";
    element("pause").textContent = status.paused ? "Continue" : "Pause";
  }

  timingCame(timing: Timing): void {
    element("watch-ticks").textContent = timingWords(timing);
  }

  /** Puts the camera where the participant's eyes are in the newest state. */
  follow(state: State | null, root: Object3D): void {
    if (!state || this.headAt < 0) return;
    const numbers = new DataView(state.poses.buffer, state.poses.byteOffset + this.headAt * 4, POSE * 4);
    const at = (index: number) => numbers.getFloat32(index * 4, true);
    const head = new Quaternion(at(4), at(5), at(6), at(3));
    const { position, quaternion } = this.eyes;
    position.copy(this.eyesInHead).applyQuaternion(head).add(new Vector3(at(0), at(1), at(2)));
    root.localToWorld(position);
    quaternion.copy(root.quaternion).multiply(head).multiply(CAMERA_IN_HEAD);
  }

  private correctHeight(event: SubmitEvent): void {
    event.preventDefault();
    const centimetres = element<HTMLInputElement>("height").valueAsNumber;
    if (Number.isFinite(centimetres))
      this.send({ type: "correct_torso_height", torso_height_m: centimetres / 100 });
  }
}

/** From a camera's axes (x right, y up, -z ahead) to the head's (x left, -y ahead, z up). */
const CAMERA_IN_HEAD = new Quaternion(0, Math.SQRT1_2, Math.SQRT1_2, 0);
