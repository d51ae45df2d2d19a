import "../page/page.css";
import "./replay.css";
import { element } from "../page/dom";
import { Clock } from "./replay-clock";
import { loadReplays, type Replayed } from "./replay-data";
import { ReplayPage } from "./replay-page";
import { Stage } from "./stage";
import { FULL_DETAIL, LIGHT_DETAIL } from "../scene/view";

const token = new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
const detail = new URLSearchParams(location.search).get("detail") === "light" ? LIGHT_DETAIL : FULL_DETAIL;

/** Plays one trial, or two side by side. */
async function play(trials: Replayed[]): Promise<void> {
  const timelines = trials.map(({ timeline }) => timeline);
  const clock = new Clock({ from: 0, to: Math.max(...timelines.map(({ seconds }) => seconds)) });
  const page = new ReplayPage(timelines, clock, (inside) => {
    for (const stage of stages) stage.setFirstPerson(inside);
  });
  const stages = trials.map((trial, at) => new Stage(page.holders[at]!, page.card, trial, detail));
  const [first, ...others] = stages.map(({ view }) => view);
  for (const other of others) other.linkCamera(first!);
  first!.renderer.setAnimationLoop((timeMs) => {
    clock.tick(timeMs);
    page.show();
    for (const stage of stages) stage.show(clock.timeS);
  });
  await Promise.all(stages.map((stage) => stage.load()));
}

function refuse(error: unknown): void {
  const problem = element("problem");
  problem.hidden = false;
  problem.textContent = `The replay cannot be shown: ${error instanceof Error ? error.message : String(error)}.`;
}

window.addEventListener("hashchange", () => location.reload());
loadReplays(token).then(play).catch(refuse);
