import "./page.css";
import "./replay.css";
import { element } from "./element";
import { Eyes } from "./eyes";
import { POSE } from "./interpolation";
import { Clock } from "./replay-clock";
import { loadReplay, type Timeline } from "./replay-data";
import { Frames } from "./replay-frames";
import { ReplayPage } from "./replay-page";
import { createRoom } from "./room";
import { FULL_DETAIL, LIGHT_DETAIL, View } from "./view";
import { World } from "./world";

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const detail = new URLSearchParams(location.search).get("detail") === "light" ? LIGHT_DETAIL : FULL_DETAIL;

/** Plays a trial: the clock says when, the frames say where everything is then. */
async function play(timeline: Timeline, poses: Float32Array): Promise<void> {
  const clock = new Clock(timeline.seconds);
  const frames = new Frames(timeline.frames_s, poses);
  const now = new Float32Array((timeline.scene.bodies.length + timeline.scene.marks) * POSE);
  const eyes = new Eyes();
  const world = new World();
  const page = new ReplayPage(timeline, clock, (inside) => {
    world.seeFromInside(inside);
    view.seeWith(inside ? eyes.camera : null);
  });
  const view = new View(page.view, page.card, detail);
  furnish(view, world);
  eyes.sceneCame(timeline.scene);
  view.renderer.setAnimationLoop((timeMs) => {
    clock.tick(timeMs);
    frames.sample(clock.timeS, now);
    world.show(now);
    eyes.follow(new Uint8Array(now.buffer), world.root);
    page.show();
    view.render();
  });
  await world.load(timeline.scene, token);
  view.standBefore(world.root);
}

function furnish(view: View, world: World): void {
  world.root.add(createRoom(detail));
  if (detail.lighting) view.reflect(world.root);
  view.scene.add(world.root);
  view.standBefore(world.root);
}

function refuse(error: unknown): void {
  const problem = element("problem");
  problem.hidden = false;
  problem.textContent = `The replay cannot be shown: ${error instanceof Error ? error.message : String(error)}.`;
}

window.addEventListener("hashchange", () => location.reload());
loadReplay(token)
  .then(([timeline, poses]) => play(timeline, poses))
  .catch(refuse);
