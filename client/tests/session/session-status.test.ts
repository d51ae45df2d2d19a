import { describe, expect, it } from "vitest";
import type { PhaseName, SessionStatus } from "../../src/generated/messages";
import { skipText, statusTexts, timingText } from "../../src/session/session-status";

const STATUS: SessionStatus = {
  type: "status",
  phase: "free_before",
  trial: 2,
  trials: 5,
  attempt: 3,
  environment: "avrgym/FeedingJaco-v1",
  paused: true,
  pause_reason: "",
  torso_height_m: 0.5449,
  step: 12,
  steps: 200,
  reward: 41.26,
  success: true,
  distance_m: 0.123,
  force_on_person_n: 1.5,
  force_region: "",
  force_share: 0,
  retracting: false,
  withdrawing: false,
  tracking_age_s: 0.011,
  visibility: "visible",
  left_modality: "hand",
  right_modality: "hand",
  needed_parts: ["head", "right"],
  untracked_parts: [],
  operated: false,
  idle: false,
  latency: [],
  streams: [],
  headset_s: 754,
  headset_limit_s: 1800,
  break_is_due: false,
};

describe("how a session stands", () => {
  it("is said in plain words and units", () => {
    expect(statusTexts(STATUS)).toEqual({
      "watch-trial": "2 of 5, attempt 3",
      "watch-environment": "FeedingJaco-v1",
      "watch-phase": "free movement before the robot starts; on hold",
      "watch-steps": "12 of 200",
      "watch-reward": "41.3, success",
      "watch-distance": "12.3 cm",
      "watch-force": "1.5 N",
      "watch-limit": "no force",
      "watch-tracking": "11 ms old, hand",
      "watch-latency": "–",
      "watch-streams": "–",
      "watch-headset": "12 of 30 min",
      "watch-height": "54.5 cm",
    });
  });

  it("tells how late pictures are, and where the time goes", () => {
    const latency = [
      { stage: "total_ms", p50: 81.6, p95: 97.2, p99: 120 },
      { stage: "up_ms", p50: 3.4, p95: 5, p99: 9 },
      { stage: "draw_ms", p50: 44.7, p95: 50, p99: 60 },
    ];
    expect(statusTexts({ ...STATUS, latency })["watch-latency"]).toBe("82 ms, 95 % within 97: up 3, drawing 45");
  });

  it("says when there is nothing to say", () => {
    const words = statusTexts({ ...STATUS, attempt: 0, tracking_age_s: null, paused: false, success: false });
    expect(words["watch-trial"]).toBe("2 of 5, attempt –");
    expect(words["watch-tracking"]).toBe("none yet");
    expect(words["watch-phase"]).toBe("free movement before the robot starts");
    expect(statusTexts({ ...STATUS, left_modality: "controller" })["watch-tracking"]).toBe(
      "11 ms old, left controller, right hand",
    );
    expect(words["watch-reward"]).toBe("41.3");
  });

  it("names the most loaded body region, and shows that the arm retracts", () => {
    const pressed = { ...STATUS, force_region: "upper_arms", force_share: 0.56 };
    expect(statusTexts(pressed)["watch-limit"]).toBe("56 % of 150 N, upper arms");
    expect(statusTexts({ ...pressed, retracting: true })["watch-limit"]).toBe("56 % of 150 N, upper arms: retracts");
  });

  it("says when the robot has withdrawn after success", () => {
    expect(statusTexts({ ...STATUS, withdrawing: true })["watch-reward"]).toBe("41.3, success, withdrawn");
  });

  it("says for which answer a stop rule paused the session, until it goes on", () => {
    const held = { ...STATUS, pause_reason: "'Nausea' was answered 'severe'" };
    expect(statusTexts(held)["watch-phase"]).toBe("free movement before the robot starts; on hold: 'Nausea' was answered 'severe'");
    expect(statusTexts({ ...held, paused: false })["watch-phase"]).toBe("free movement before the robot starts");
  });

  it("says in words what is wrong", () => {
    expect(statusTexts({ ...STATUS, visibility: "visible-blurred" })["watch-tracking"]).toBe(
      "the participant does not see the scene: a menu covers the scene",
    );
    expect(statusTexts({ ...STATUS, tracking_age_s: 1.26 })["watch-tracking"]).toBe(
      "lost for 1.3 s, person and robot do not move",
    );
    expect(statusTexts({ ...STATUS, untracked_parts: ["left", "right"] })["watch-tracking"]).toBe(
      "11 ms old, hand; left hand not tracked; right hand not tracked: the task needs it",
    );
    const timing = { type: "timing", tick_ms_median: 12, tick_ms_max: 31.25, missed_ticks: 4 } as const;
    expect(timingText(timing)).toBe("too slow: 12.0 ms, at most 31.3 ms; 4 missed");
    expect(timingText({ ...timing, tick_ms_median: 3 })).toMatch(/^3\.0 ms/);
  });
});

it("what the experimenter skips is what goes on", () => {
  expect(["headset", "headset_check", "headset_stop"].map((phase) => skipText(phase as PhaseName))).toEqual(Array(3).fill("Skip headset check"));
  expect(skipText("calibration")).toBe("Skip trial");
});
