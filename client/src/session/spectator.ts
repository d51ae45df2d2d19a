import type { Object3D } from "three";
import { OperatorControl } from "../input/operator-control";
import { ParticipantCamera } from "../scene/participant-camera";
import type {
  ExperimenterCommandName,
  WatcherMessage,
  Scene,
  SessionStatus,
  TickTiming,
  Welcome,
} from "../generated/messages";
import type { WorldState } from "./state-decoder";
import { skipText, statusTexts, timingText } from "./session-status";

function element<T extends HTMLElement>(id: string): T {
  return document.getElementById(id) as T;
}

/** The page for watchers: the participant's view, the status of the session, and the experimenter's commands. */
export class Spectator {
  firstPerson = false;
  private readonly participant = new ParticipantCamera();
  private driving: OperatorControl | null = null;

  constructor(
    private readonly send: (message: WatcherMessage) => void,
    private readonly viewChanged: (firstPerson: boolean) => void,
  ) {
    element("watch").hidden = false;
    element<HTMLInputElement>("from-inside").addEventListener("change", (event) => {
      this.firstPerson = (event.target as HTMLInputElement).checked;
      this.viewChanged(this.firstPerson);
    });
    for (const button of document.querySelectorAll<HTMLButtonElement>("[data-command]"))
      button.addEventListener("click", () =>
        this.send({ type: "command", name: button.dataset["command"] as ExperimenterCommandName }),
      );
    element<HTMLFormElement>("height-form").addEventListener("submit", (event) => this.correctHeight(event));
  }

  onWelcome({ role }: Welcome): void {
    element("commands").hidden = role !== "experimenter";
    const drives = role === "experimenter" && !document.body.classList.contains("embedded");
    if (drives) this.driving ??= new OperatorControl(element("drive"), this.send);
  }

  /** The camera of the participant's view. */
  get eyes() {
    return this.participant.camera;
  }

  onScene(scene: Scene): void {
    this.participant.onScene(scene);
  }

  onStatus(status: SessionStatus): void {
    this.driving?.onStatus(status);
    for (const [id, text] of Object.entries(statusTexts(status))) element(id).textContent = text;
    element("skip-word").textContent = skipText(status.phase);
    element<HTMLButtonElement>("pause").dataset["command"] = status.paused ? "continue" : "pause";
    element("pause").textContent = status.paused ? "Continue" : "Pause";
  }

  onTiming(timing: TickTiming): void {
    element("watch-ticks").textContent = timingText(timing);
  }

  /** Moves the camera to the participant's eyes in the newest state. */
  follow(state: WorldState | null, root: Object3D): void {
    if (state) this.participant.follow(state.poses, root);
  }

  private correctHeight(event: SubmitEvent): void {
    event.preventDefault();
    const centimetres = element<HTMLInputElement>("height").valueAsNumber;
    if (Number.isFinite(centimetres))
      this.send({ type: "correct_torso_height", torso_height_m: centimetres / 100 });
  }
}
