import { HAND_PROFILE } from "./stop-gestures";

/** The kinds of select input, in order of preference for texts. */
export const INPUTS = ["trigger", "button", "touchpad", "pinch", "tap", "gaze"] as const;
/** The kinds of input profiles: head, one switch, two switches, and the experimenter. */
const PROFILE_INPUTS = ["dwell", "scan", "step", "remote"] as const;
export type InputKind = (typeof INPUTS)[number] | (typeof PROFILE_INPUTS)[number];

/** The kind of select input of a source, from its profiles. */
export function inputKind({ hand, profiles, gamepad, targetRayMode }: XRInputSource): InputKind {
  const has = (part: string) => profiles.some((profile) => profile.startsWith(`generic-${part}`));
  if (targetRayMode === "screen" || has("touchscreen")) return "tap";
  if (hand || targetRayMode === "transient-pointer" || profiles.includes(HAND_PROFILE)) return "pinch";
  if (targetRayMode === "gaze") return "gaze";
  if (has("trigger")) return "trigger";
  if (has("touchpad")) return "touchpad";
  return has("button") || !gamepad ? "button" : "trigger";
}

/** The preferred kind of select input of all sources; null without sources, as between two pinches. */
export function inputKindOf(sources: Iterable<XRInputSource>): InputKind | null {
  const found = Array.from(sources, inputKind);
  return INPUTS.find((input) => found.includes(input)) ?? null;
}

/**
 * The text for a kind of input; default: that for a trigger.
 *
 * InputProfileMessage profiles get the text of the page if the text depends on the input, but has no variant for them.
 */
export function textFor(input: InputKind, text: string, byInput: Readonly<Record<string, string>>, pageText = ""): string {
  const depends = Object.keys(byInput).length > 0;
  const others = depends && PROFILE_INPUTS.some((each) => each === input) ? pageText || text : text;
  return byInput[input] ?? others;
}
