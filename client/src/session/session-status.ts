import {
  FORCE_LIMITS_N,
  STAGE_LABELS,
  STALE_S,
  TICK_S,
  type TrackedBodyPart,
  type PhaseName,
  type SessionStatus,
  type TickTiming,
  type Visibility,
} from "../generated/messages";

/** Descriptions of phases for watchers. */
export const PHASE_TEXTS: Readonly<Record<PhaseName, string>> = {
  waiting: "the participant is not in VR",
  headset: "the headset is about to be checked",
  headset_check: "the headset is checked",
  headset_stop: "the participant tests the stop",
  calibration: "the participant is measured",
  reach: "the participant's reach is measured",
  loading: "the scene is prepared",
  check: "the participant checks body and seat",
  ready: "the participant confirms when ready",
  free_before: "free movement before the robot starts",
  countdown: "the robot is about to start",
  trial: "the robot helps",
  retreat: "the robot retreats",
  free_after: "free movement, the robot holds still",
  questionnaire: "the participant answers questions",
  confirm: "the participant confirms their answers",
  break: "the participant takes a break",
  paused: "paused, the robot holds still",
  finished: "the session is over",
  viewing: "an environment is shown",
};

/** Reasons why the participant does not see the scene. */
export const VISIBILITY_TEXTS: Readonly<Record<Exclude<Visibility, "visible">, string>> = {
  "visible-blurred": "a menu covers the scene",
  hidden: "headset taken off or page in the background",
  "context-lost": "the graphics failed",
};

/** The label of the experimenter's *skip* button. */
export function skipText(phase: PhaseName): string {
  return phase.startsWith("headset") ? "Skip headset check" : "Skip trial";
}

/** Texts of the status by element id. */
export function statusTexts(status: SessionStatus): Record<string, string> {
  return {
    "watch-trial": `${status.trial} of ${status.trials}, attempt ${status.attempt || "–"}`,
    "watch-environment": status.environment.replace("avrgym/", ""),
    "watch-phase": PHASE_TEXTS[status.phase] + pauseText(status),
    "watch-steps": `${status.step} of ${status.steps}`,
    "watch-reward": `${status.reward.toFixed(1)}${successText(status)}`,
    "watch-distance": `${(100 * status.distance_m).toFixed(1)} cm`,
    "watch-force": `${status.force_on_person_n.toFixed(1)} N`,
    "watch-limit": limitText(status),
    "watch-tracking": trackingText(status),
    "watch-latency": latencyText(status),
    "watch-streams": streamText(status),
    "watch-headset": headsetText(status),
    "watch-height": `${(100 * status.torso_height_m).toFixed(1)} cm`,
  };
}

/** Time in VR with its limit, in minutes. */
function headsetText({ headset_s, headset_limit_s, break_is_due }: SessionStatus): string {
  const limit = headset_limit_s ? ` of ${Math.round(headset_limit_s / 60)}` : "";
  return `${Math.floor((headset_s ?? 0) / 60)}${limit} min${break_is_due ? "; a break follows" : ""}`;
}

function successText({ success, withdrawing }: SessionStatus): string {
  return success ? `, success${withdrawing ? ", withdrawn" : ""}` : "";
}

function limitText({ force_region, force_share, retracting }: SessionStatus): string {
  const limit = FORCE_LIMITS_N[force_region];
  const bears = limit === undefined ? "no force" : `${(100 * force_share).toFixed(0)} % of ${limit} N, ${force_region.replaceAll("_", " ")}`;
  return `${bears}${retracting ? ": retracts" : ""}`;
}

function pauseText({ paused, pause_reason }: SessionStatus): string {
  return paused ? (pause_reason ? `; on hold: ${pause_reason}` : "; on hold") : "";
}

function trackingText(status: SessionStatus): string {
  const { tracking_age_s, visibility, left_modality, right_modality } = status;
  if (visibility !== "visible") return `the participant does not see the scene: ${VISIBILITY_TEXTS[visibility]}`;
  if (tracking_age_s === null) return "none yet";
  if (tracking_age_s > STALE_S) return `lost for ${tracking_age_s.toFixed(1)} s, person and robot do not move`;
  const hands = left_modality === right_modality ? left_modality : `left ${left_modality}, right ${right_modality}`;
  return `${(1000 * tracking_age_s).toFixed(0)} ms old, ${hands}${untrackedText(status)}`;
}

const PART_TEXTS: Readonly<Record<TrackedBodyPart, string>> = { head: "head", left: "left hand", right: "right hand" };

function untrackedText({ untracked_parts, needed_parts }: SessionStatus): string {
  const words = (part: TrackedBodyPart) =>
    `; ${PART_TEXTS[part]} not tracked${needed_parts.includes(part) ? ": the task needs it" : ""}`;
  return untracked_parts.map(words).join("");
}

/** Median and 95th percentile of the total latency, then the medians of its stages. */
function latencyText({ latency }: SessionStatus): string {
  const total = latency.find(({ stage }) => stage === "total_ms");
  if (!total) return "–";
  const words: Readonly<Record<string, string>> = STAGE_LABELS;
  const parts = latency.filter(({ stage }) => stage in words);
  const stages = parts.map(({ stage, p50 }) => `${words[stage]} ${p50.toFixed(0)}`).join(", ");
  return `${total.p50.toFixed(0)} ms, 95 % within ${total.p95.toFixed(0)}: ${stages}`;
}

function streamText({ streams }: SessionStatus): string {
  return streams.map(({ name, present }) => (present ? name : `${name} is missing`)).join(", ") || "–";
}

export function timingText({ tick_ms_median, tick_ms_max, missed_ticks }: TickTiming): string {
  const late = tick_ms_median > 1000 * TICK_S ? "too slow: " : "";
  return `${late}${tick_ms_median.toFixed(1)} ms, at most ${tick_ms_max.toFixed(1)} ms; ${missed_ticks} missed`;
}
