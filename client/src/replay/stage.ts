import { ParticipantCamera } from "../scene/participant-camera";
import { POSE } from "../scene/state-interpolation";
import type { Replayed } from "./replay-data";
import { Frames } from "./recorded-frames";
import { createRoom } from "../scene/room";
import { View, type Detail } from "../scene/view";
import { World } from "../scene/world";

/** The view of one trial. */
export class Stage {
  readonly view: View;
  private readonly world = new World();
  private readonly eyes = new ParticipantCamera();
  private readonly frames: Frames;
  private readonly poses: Float32Array;

  constructor(
    holder: HTMLElement,
    card: HTMLElement,
    private readonly replayed: Replayed,
    detail: Detail,
  ) {
    const { timeline, poses } = replayed;
    const { scene } = timeline;
    holder.ariaLabel = `${timeline.title}, drawn in 3D`;
    this.frames = new Frames(timeline.frames_s, poses);
    this.poses = new Float32Array((scene.bodies.length + scene.marks) * POSE);
    this.eyes.onScene(scene);
    this.view = new View(holder, card, detail);
    this.world.root.add(createRoom(detail));
    if (detail.lighting) this.view.reflect(this.world.root);
    this.view.scene.add(this.world.root);
  }

  async load(): Promise<void> {
    await this.world.load(this.replayed.timeline.scene, this.replayed.glb);
    this.view.placeSpectator(this.world.root);
  }

  setFirstPerson(inside: boolean): void {
    this.world.setFirstPerson(inside);
    this.view.useCamera(inside ? this.eyes.camera : null);
  }

  /** Draws the trial at a time. */
  show(timeS: number): void {
    this.frames.sample(timeS, this.poses);
    this.world.show(this.poses);
    this.eyes.follow(this.poses, this.world.root);
    this.view.render();
  }
}
