import type { DemonstrationProgress } from "../generated/messages";

const STAGE_TEXTS: Readonly<Record<DemonstrationProgress["stage"], string>> = {
  preparing: "The next person is prepared.",
  ready: "Press A or Start to begin.",
  running: "Press A or Success when the task is done.",
  finished: "All episodes are recorded. Stop the program with Ctrl+C.",
};

/** The task and the next step. */
export function stageText({ stage, goal }: DemonstrationProgress): string {
  return stage === "ready" ? `${goal} ${STAGE_TEXTS.ready}` : STAGE_TEXTS[stage];
}

/** Counts of episodes and the success rate. */
export function countText({ episodes, completed, successes, discarded }: DemonstrationProgress): string {
  const planned = episodes === null ? "" : ` of ${episodes}`;
  const rate = completed ? ` (${Math.round((100 * successes) / completed)} %)` : "";
  return `${completed}${planned} recorded, ${successes} successes${rate}, ${discarded} discarded.`;
}
