import type { ClientCommandSource, InputProfileMessage, InputMethod, PresentationPreferences, Side, StopInput } from "../generated/messages";
import type { InputKind } from "./input-kind";

/** The default presentation of texts; see `recording/presentation.py`. */
export const PRESENTATION: PresentationPreferences = {
  ...{ text_deg: 1.5, panel_distance_m: 1.25, contrast: "normal", position: "centre" },
  ...{ reduced_motion: false, read_aloud: false, captions: false },
};

/** Two controllers, until the server sends the participant's profile. */
export const CONTROLLERS: InputProfileMessage = {
  ...{ type: "input", method: "controllers", dwell_s: 1, scan_s: 1.5, select_key: "Enter" },
  ...{ resting_arms: [], absent_arms: [], stops: ["buttons"], presentation: PRESENTATION },
};

const ARMS: Readonly<Partial<Record<InputMethod, readonly Side[]>>> = {
  controllers: ["left", "right"],
  hands: ["left", "right"],
  "left-hand": ["left"],
  "right-hand": ["right"],
};

/** The kinds of select input that a profile determines. All other profiles point, with the input of their device. */
const KINDS: Readonly<Partial<Record<InputMethod, InputKind>>> = {
  head: "dwell",
  "one-switch": "scan",
  "two-switches": "step",
  experimenter: "remote",
};

/** The kind of select input that the profile determines; null: that of the device. */
export function kindOfProfile({ method }: InputProfileMessage): InputKind | null {
  return KINDS[method] ?? null;
}

/** Whether the participant points at targets with a ray, and selects with a press. */
export function points(profile: InputProfileMessage): boolean {
  return kindOfProfile(profile) === null;
}

/** Whether the participant points with this source. A controller of a resting arm does not count. */
export function pointsWith(profile: InputProfileMessage, { handedness }: Pick<XRInputSource, "handedness">): boolean {
  const { method, resting_arms, absent_arms } = profile;
  if (handedness === "none") return points(profile);
  return !!ARMS[method]?.includes(handedness) && ![...resting_arms, ...absent_arms].includes(handedness);
}

/** Whether the participant stops the robot in this way. */
export function stopsBy({ stops }: InputProfileMessage, way: StopInput): boolean {
  return stops?.includes(way) ?? false;
}

/** The source of robot commands that the participant selects with dwell or switches; null if commands have buttons only. */
export function commandSource(profile: InputProfileMessage): Extract<ClientCommandSource, "dwell" | "switch"> | null {
  const kind = kindOfProfile(profile);
  if (kind === "dwell") return "dwell";
  return (kind === "scan" || kind === "step") && !stopsBy(profile, "switch") ? "switch" : null;
}

export type Switch = "step" | "select";

/** Keys that are no switches: for the browser, and Escape, which always stops. */
const NO_SWITCH = /^(Escape|Tab|Shift|Control|Alt|AltGraph|Meta|CapsLock|NumLock|Fn|OS|F\d+|Unidentified|Dead|Process)$/;

/** The switch of a key; null if the key is none. With one switch, every key selects. */
export function switchOfKey({ method, select_key }: InputProfileMessage, { key, code }: Pick<KeyboardEvent, "key" | "code">): Switch | null {
  if ((method !== "one-switch" && method !== "two-switches") || NO_SWITCH.test(key)) return null;
  return method === "one-switch" || key === select_key || code === select_key ? "select" : "step";
}

/** The switch of a gamepad's button, by its index: the first one steps, every other one selects. */
export function switchOfButton({ method }: InputProfileMessage, index: number): Switch {
  return method === "two-switches" && index === 0 ? "step" : "select";
}

/** The switch of a controller in VR: the left one steps, the other one selects. */
export function switchOfHand({ method }: InputProfileMessage, handedness: XRHandedness): Switch {
  return method === "two-switches" && handedness === "left" ? "step" : "select";
}
