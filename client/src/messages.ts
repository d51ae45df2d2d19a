// Written by `python -m avrgym.vr.typescript` from messages.py. Do not edit.

export const PROTOCOL = 2;

export type Vector3 = [number, number, number];

export type Quaternion = [number, number, number, number];

export type PhaseName = "calibration" | "countdown" | "finished" | "free_after" | "free_before" | "loading" | "paused" | "questionnaire" | "trial" | "viewing" | "waiting";

/** A pose in WebXR's `local-floor` space: position in metres (y up), orientation x, y, z, w. */
export type XRPose = [position: Vector3, orientation: Quaternion];

/** The first message of a connection. The token is the one in the fragment of the page's address. */
export interface Hello {
  type: "hello";
  protocol: number;
  token: string;
  device: string;
  emulated: boolean;
}

/** One XR frame. `sequence` counts up by one; `client_time_ms` is the XR frame's time stamp.
 *
 * Controller poses are grip poses; a pose that is not tracked is `None`. */
export interface Tracking {
  type: "tracking";
  sequence: number;
  client_time_ms: number;
  head: XRPose | null;
  left: XRPose | null;
  right: XRPose | null;
  modality: "controllers" | "hands" | "none";
}

/** The participant entered VR. */
export interface Entered {
  type: "entered";
}

/** The participant left VR (the connection may stay). */
export interface Left {
  type: "left";
}

/** The participant pressed a trigger where the phase asks for it. */
export interface Ready {
  type: "ready";
}

/** The client shows the scene of this address. */
export interface SceneLoaded {
  type: "scene_loaded";
  url: string;
}

/** The participant pressed a menu button or the stop key: the robot must hold at once. */
export interface Stop {
  type: "stop";
}

/** The reference space's origin jumped: earlier registration is void. */
export interface OriginReset {
  type: "origin_reset";
}

/** The answer to one item of the questionnaire, with the time from its appearance to the press. */
export interface Answer {
  type: "answer";
  item: string;
  value: number;
  response_time_s: number;
}

export type ClientMessage = Hello | Tracking | Entered | Left | Ready | SceneLoaded | Stop | OriginReset | Answer;

/** The connection is accepted. */
export interface Welcome {
  type: "welcome";
  protocol: number;
  session: string;
}

/** A scene to draw: a GLB whose nodes carry `extras.body`, and where the simulated world stands.
 *
 * `xr_from_world` places the simulation's z-up world in the participant's `local-floor` space: apply it
 * to the root node as it is. `bodies` is the order of the poses in every following `State`; those of
 * `marks` spots on the person follow, of one radius and one colour (red, green, blue in 0..1).
 * `head_bodies` are hidden from the participant's own eyes. */
export interface Scene {
  type: "scene";
  url: string;
  bodies: string[];
  head_bodies: string[];
  marks: number;
  mark_radius_m: number;
  mark_rgb: Vector3;
  xr_from_world: XRPose;
}

/** The world at one instant.
 *
 * `poses`: little-endian float32 (bodies + marks, 7): x, y, z, then w, x, y, z; world frame.
 * `tracking_sequence` is the newest tracking frame that this state already follows, -1 before the first. */
export interface State {
  type: "state";
  sequence: number;
  simulation_time_s: number;
  tracking_sequence: number;
  poses: Uint8Array;
}

/** Where the session stands, with the words to show to the participant. */
export interface Phase {
  type: "phase";
  name: PhaseName;
  text: string;
  trial: number;
  trials: number;
  practice: boolean;
  seconds: number | null;
}

/** One item to show and to answer by pointing and pressing the trigger. */
export interface Question {
  type: "question";
  item: string;
  text: string;
  points: number;
  low: string;
  high: string;
  number: number;
  count: number;
}

/** What was wrong with a message or a measurement, and what is allowed. The session goes on. */
export interface Problem {
  type: "problem";
  message: string;
}

export type ServerMessage = Welcome | Scene | State | Phase | Question | Problem;
