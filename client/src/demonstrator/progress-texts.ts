import type { DemonstrationProgress } from "../generated/messages";

const STAGE_TEXTS: Readonly<Record<DemonstrationProgress["stage"], string>> = {
  preparing: "The next person is prepared.",
  ready: "Press A or Start to begin.",
  running: "Press A or Success when the task is done.",
  finished: "All episodes are recorded. Stop the program with Ctrl+C.",
};

/** The task, who drives, and the next step. */
export function stageText({ stage, goal, policy }: DemonstrationProgress): string {
  if (stage === "ready") return `${goal} ${STAGE_TEXTS.ready}`;
  const takeover = policy && stage === "running" ? `The policy ${policy} drives. Hold a grip button or Space to take over. ` : "";
  return takeover + STAGE_TEXTS[stage];
}

/** Counts of episodes and the success rate. */
export function countText({ episodes, completed, successes, discarded }: DemonstrationProgress): string {
  const planned = episodes === null ? "" : ` of ${episodes}`;
  const rate = completed ? ` (${Math.round((100 * successes) / completed)} %)` : "";
  return `${completed}${planned} recorded, ${successes} successes${rate}, ${discarded} discarded.`;
}
