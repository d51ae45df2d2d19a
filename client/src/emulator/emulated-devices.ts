import { metaQuest2, metaQuest3, type GamepadConfig, type XRControllerConfig, type XRDeviceConfig } from "iwer";

/** The pointing and select input: controllers, bare hands, a pinch at the gaze target, or a viewer's button. */
export interface EmulatedDevice {
  config: XRDeviceConfig;
  input: "controllers" | "hands" | "pinch" | "gaze";
}

const TOUCH = metaQuest3.controllerConfig!;
const FACE_BUTTONS = { left: ["x-button", "y-button"], right: ["a-button", "b-button"] } as const;

/** The emulated headsets, by the name in `&headset=`. */
export const DEVICES: Readonly<Record<string, EmulatedDevice>> = {
  "quest-3": { config: metaQuest3, input: "controllers" },
  "quest-2": { config: metaQuest2, input: "controllers" },
  "pico-4": controllers("pico-4", ["generic-trigger-squeeze-thumbstick"], ["squeeze", null, "thumbstick"], FACE_BUTTONS),
  vive: controllers("htc-vive", ["generic-trigger-squeeze-touchpad"], ["squeeze", "touchpad"]),
  "mixed-reality": controllers(
    "microsoft-mixed-reality",
    ["generic-trigger-squeeze-touchpad-thumbstick"],
    ["squeeze", "touchpad", "thumbstick"],
  ),
  "generic-trigger": controllers("generic-trigger", [], []),
  "one-button": oneButton("generic-button"),
  hands: { config: metaQuest3, input: "hands" },
  "vision-pro": { config: { ...metaQuest3, name: "visionOS", controllerConfig: undefined }, input: "pinch" },
  viewer: { config: { ...metaQuest3, name: "viewer", controllerConfig: undefined }, input: "gaze" },
};

/** Two controllers with a trigger and other buttons, with the grip of a Quest. */
function controllers(
  profileId: string,
  fallbackProfileIds: string[],
  others: readonly (string | null)[],
  face?: typeof FACE_BUTTONS,
): EmulatedDevice {
  const layout = (hand: "left" | "right") => ({
    gamepad: gamepad("xr-standard", [...others, ...(face?.[hand] ?? [])]),
    gripOffsetMatrix: TOUCH.layout[hand]!.gripOffsetMatrix!,
    numHapticActuators: 1,
  });
  const config = { profileId, fallbackProfileIds, layout: { left: layout("left"), right: layout("right") } };
  return { config: { ...metaQuest3, name: profileId, controllerConfig: config }, input: "controllers" };
}

/** One button without handedness, which points and has no grip pose. */
function oneButton(profileId: string): EmulatedDevice {
  const none = { gamepad: gamepad("", []), numHapticActuators: 0 };
  const config: XRControllerConfig = { profileId, fallbackProfileIds: [], layout: { none } };
  return { config: { ...metaQuest3, name: profileId, controllerConfig: config }, input: "controllers" };
}

function gamepad(mapping: "" | "xr-standard", others: readonly (string | null)[]): GamepadConfig {
  const buttons = others.map((id) =>
    id === null ? null : { id, type: "binary" as const, ...(id === "squeeze" && { eventTrigger: "squeeze" as const }) },
  );
  const trigger = { id: "trigger", type: "analog" as const, eventTrigger: "select" as const };
  return { mapping: mapping as GamepadConfig["mapping"], buttons: [trigger, ...buttons], axes: [] };
}
