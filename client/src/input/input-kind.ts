import { HAND_PROFILE } from "./stop-gestures";

/** How a participant selects, in the order in which words for it are chosen. */
export const INPUTS = ["trigger", "button", "touchpad", "pinch", "tap", "gaze"] as const;
export type InputKind = (typeof INPUTS)[number];

/** How an input source selects: with the part that its profile names. */
export function inputKind({ hand, profiles, gamepad, targetRayMode }: XRInputSource): InputKind {
  const has = (part: string) => profiles.some((profile) => profile.startsWith(`generic-${part}`));
  if (targetRayMode === "screen" || has("touchscreen")) return "tap";
  if (hand || targetRayMode === "transient-pointer" || profiles.includes(HAND_PROFILE)) return "pinch";
  if (targetRayMode === "gaze") return "gaze";
  if (has("trigger")) return "trigger";
  if (has("touchpad")) return "touchpad";
  return has("button") || !gamepad ? "button" : "trigger";
}

/** How somebody with these input sources selects; null where there is none, as between two pinches. */
export function inputKindOf(sources: Iterable<XRInputSource>): InputKind | null {
  const found = Array.from(sources, inputKind);
  return INPUTS.find((input) => found.includes(input)) ?? null;
}

/** The words for a kind of input, or those for a trigger. */
export function textFor(input: InputKind, text: string, byInput: Readonly<Record<string, string>>): string {
  return byInput[input] ?? text;
}
