// Written by `python scripts/write_typescript.py` from the server's own definitions. Do not edit.

export const PROTOCOL = 12;

export const STATES_PER_RECEIPT = 2;

export const STALE_S = 0.2;

export const TICK_S = 0.01;

export const JOINT_STEPS = [1e-05];

export const POSE_STEPS = [0.0001, 0.0001, 0.0001, 5e-05, 5e-05, 5e-05, 5e-05];

export const STAGE_WORDS = {"sample_ms": "pose", "up_ms": "up", "simulate_ms": "simulation", "send_ms": "sending", "down_ms": "down", "draw_ms": "drawing"};

export const FORCE_LIMITS_N: Readonly<Record<string, number>> = {"skull": 130.0, "face": 65.0, "neck": 150.0, "shoulders": 210.0, "chest": 140.0, "abdomen": 110.0, "pelvis": 180.0, "upper_arms": 150.0, "forearms": 160.0, "hands": 140.0, "thighs": 220.0, "lower_legs": 130.0};

export type Part = "head" | "left" | "right";

export type Sex = "man" | "woman";

export type Vector3 = [number, number, number];

export type Quaternion = [number, number, number, number];

export type Shares = [number, number, number];

export type Modality = "controller" | "hand" | "mouse" | "none";

export type StopWay = "button" | "gaze" | "key" | "page" | "palm" | "select" | "squeeze" | "triggers";

export type Visibility = "context-lost" | "hidden" | "visible" | "visible-blurred";

export type CommandName = "continue" | "end" | "pause" | "recalibrate" | "repeat" | "skip" | "stop";

export type PhaseName = "calibration" | "check" | "confirm" | "countdown" | "finished" | "free_after" | "free_before" | "headset" | "headset_check" | "headset_stop" | "loading" | "paused" | "questionnaire" | "reach" | "ready" | "retreat" | "trial" | "viewing" | "waiting";

export type Role = "experimenter" | "participant" | "spectator";

export const PHASES_WHERE: Record<"moves" | "can_be_stopped" | "awaits_ready" | "can_choose_body", readonly PhaseName[]> = {
  moves: ["headset_check", "headset_stop", "free_before", "countdown", "trial", "retreat", "free_after"],
  can_be_stopped: ["headset_stop", "free_before", "countdown", "trial", "retreat"],
  awaits_ready: ["headset", "calibration", "reach", "check", "ready", "confirm", "paused"],
  can_choose_body: ["waiting", "calibration", "check", "ready", "paused"],
};

/** A pose in WebXR's `local-floor` space: position in metres (y up), orientation x, y, z, w. */
export type XRPose = [position: Vector3, orientation: Quaternion];

/** A person's measures, metres: what joint angles and the poses of head and hands are computed from.
 *
 * `hips_pos_w` and `hips_q_w` (w, x, y, z) are where the hips rest in the world; the waist is given in their
 * frame, neck (the head's joints) and right shoulder in the torso's. The head's centre lies so far above the neck. */
export interface Skeleton {
  hips_pos_w: Vector3;
  hips_q_w: Quaternion;
  waist: Vector3;
  neck: Vector3;
  head_centre_m: number;
  right_shoulder: Vector3;
  upper_arm_m: number;
  forearm_m: number;
  hand_m: number;
}

/** How long a stage on the way from poses to pictures takes, percentiles in milliseconds. */
export interface StageLatency {
  stage: string;
  p50: number;
  p95: number;
  p99: number;
}

/** A stream of another device by the study's name for it, and whether it is there. */
export interface StreamStatus {
  name: string;
  present: boolean;
}

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
 * Of a hand that holds a controller the pose is the grip's, of a bare hand the wrist's; a pose that is not tracked is
 * `None`. Which of them each hand is says its modality. */
export interface Tracking {
  type: "tracking";
  sequence: number;
  client_time_ms: number;
  head: XRPose | null;
  left: XRPose | null;
  right: XRPose | null;
  left_modality: Modality;
  right_modality: Modality;
}

/** How many states this connection has brought so far; it is told after every `STATES_PER_RECEIPT` of them. */
export interface Receipt {
  type: "receipt";
  states: number;
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

/** The emergency stop: the robot must hold immediately. `way` is how the participant made it. */
export interface Stop {
  type: "stop";
  way: StopWay | null;
}

/** From now on the participant sees the scene, or does not; after each welcome they see it until this arrives. */
export interface VisibilityChanged {
  type: "visibility_changed";
  visibility: Visibility;
}

/** The participant saw that body or seat do not fit, and wants to be measured again. */
export interface Recalibrate {
  type: "recalibrate";
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

/** The participant wants to see the question before this one, and to answer it anew. */
export interface Back {
  type: "back";
}

/** The body that the participant shall have; one of another sex is measured anew. */
export interface ChooseBody {
  type: "choose_body";
  sex: Sex;
  skin_tone: string;
}

/** How long the frames of the last second took from pose to picture. */
export interface Latency {
  type: "latency";
  sequence: number[];
  sample_ms: number[];
  up_ms: number[];
  simulate_ms: number[];
  send_ms: number[];
  down_ms: number[];
  draw_ms: number[];
}

/** The frames of the last second while the headset is checked: milliseconds from each to the next, and on what.
 *
 * `device` is what the browser says that it is, `profiles` what it says of the controllers; `display_hz` is the
 * display's rate, where it tells. */
export interface HeadsetFrames {
  type: "headset_frames";
  device: string;
  emulated: boolean;
  profiles: string[];
  display_hz: number | null;
  intervals_ms: number[];
}

export type ClientMessage = Hello | Tracking | Receipt | Entered | Left | Ready | SceneLoaded | Stop | VisibilityChanged | Recalibrate | OriginReset | Answer | Back | ChooseBody | Latency | HeadsetFrames;

/** What the experimenter wants of the session.
 *
 * `stop`: the robot holds at once, and the participant may repeat the trial. `pause`: the same, and no
 * trial begins before `continue`. `repeat`: a new attempt at the trial. `skip`: on to the next one.
 * `end`: the session is over. `recalibrate`: the participant is measured again. */
export interface Command {
  type: "command";
  name: CommandName;
}

/** The torso height that the experimenter measured; the body is made anew with it. */
export interface CorrectTorsoHeight {
  type: "correct_torso_height";
  torso_height_m: number;
}

/** The same, chosen by the experimenter. */
export interface ChooseTheirBody {
  type: "choose_body";
  sex: Sex;
  skin_tone: string;
}

/** How the operator moves the robot's hand, where they drive: many times a second while `engaged`.
 *
 * Shares of the hand's greatest speeds, in the participant's directions: `linear` ahead, to the left and up,
 * `angular` about these axes. Once the operator is no longer engaged, or silent, the robot holds still. */
export interface Drive {
  type: "drive";
  engaged: boolean;
  linear: Shares;
  angular: Shares;
}

/** A page that watches shows the scene of this address: an environment on show waits for that, no session does. */
export interface SceneWatched {
  type: "scene_watched";
  url: string;
}

export type ExperimenterMessage = Hello | Receipt | Command | CorrectTorsoHeight | ChooseTheirBody | Drive | SceneWatched;

/** The connection is accepted, as whose; whether a touch is felt and a success heard is the plan's choice. */
export interface Welcome {
  type: "welcome";
  protocol: number;
  session: string;
  role: Role;
  haptics: boolean;
  sounds: boolean;
}

/** The participant's language: its tag, how it is written, and the words of their page by key.
 *
 * `direction` is `ltr` or `rtl`, as HTML has it. */
export interface Language {
  type: "language";
  language: string;
  direction: string;
  words: Record<string, string>;
}

/** The participant's body, and which tones of skin there are: by name, and red, green, blue in 0..1 of each. */
export interface Body {
  type: "body";
  sex: Sex;
  skin_tone: string;
  skin_tones: string[];
  skin_tones_rgb: Vector3[];
}

/** A scene to draw: a GLB whose nodes carry `extras.body`, and where the simulated world stands.
 *
 * `xr_from_world` places the simulation's z-up world in the participant's `local-floor` space: apply it
 * to the root node as it is. `bodies` is the order of the poses in every following state; those of
 * `marks` spots on the person follow, of one radius and one colour (red, green, blue in 0..1).
 * `head_bodies` are hidden from the participant's own eyes, which lie at `eyes` in the frame of the first
 * of them (x left, -y ahead, z up). `skeleton` is that of the participant's body, whose bodies' names begin with
 * `person/`. */
export interface Scene {
  type: "scene";
  url: string;
  bodies: string[];
  head_bodies: string[];
  marks: number;
  mark_radius_m: number;
  mark_rgb: Vector3;
  eyes: Vector3;
  skeleton: Skeleton;
  xr_from_world: XRPose;
}

/** The world goes from where it stands to another place in `local-floor`, evenly, within so many seconds.
 *
 * So it follows a participant who has slid on their seat. */
export interface Placed {
  type: "placed";
  xr_from_world: XRPose;
  seconds: number;
}

/** The address of a scene that comes next: a client that fetches it now shows it sooner then. */
export interface Upcoming {
  type: "upcoming";
  url: string;
}

/** When a tracking frame passed the server, in seconds of its clock; the state that follows it comes next.
 *
 * When it was received, when that state was handed out, and when it is sent. */
export interface Passed {
  type: "passed";
  tracking_sequence: number;
  received_s: number;
  simulated_s: number;
  sent_s: number;
}

/** The world at one instant: how it differs from the state that this connection was sent before.
 *
 * After a scene it differs from nothing. `tracking_sequence` is the newest tracking frame that this state already
 * follows, -1 before the first; `joint_targets` are the angles that the person's joints are driven to for it.
 * `held` are the parts of the body that are not, and will not come, where they are tracked: something is in their
 * way, or they are not tracked. Their owner sees them where they are simulated.
 *
 * `joint_targets` come in steps of 1e-5 rad, one row a joint; `poses` in steps of 0.1 mm and 5e-5, one row of x,
 * y, z, w, x, y, z a body or mark. Rows that are as before are left out, but for the first state: each row begins
 * with how many were, then come its differences in zigzag; all are varints as in Protocol Buffers. */
export interface StateChange {
  type: "state";
  sequence: number;
  simulation_time_s: number;
  tracking_sequence: number;
  held: Part[];
  joint_targets: Uint8Array;
  poses: Uint8Array;
}

/** Where the session stands, with the words to show to the participant.
 *
 * `text` is for somebody in VR who selects by a trigger, `texts_by_input` for other kinds of input, and
 * `page_text` for somebody who takes part on the page, without a headset, where these differ. */
export interface Phase {
  type: "phase";
  name: PhaseName;
  text: string;
  trial: number;
  trials: number;
  practice: boolean;
  seconds: number | null;
  page_text: string;
  texts_by_input: Record<string, string>;
}

/** One item to show and to answer by pointing and pressing the trigger.
 *
 * `labels` are the words on its buttons; where there are none, they are numbered from 1 to `points`. `given` is
 * the participant's earlier answer, where they went back to a question. */
export interface Question {
  type: "question";
  item: string;
  text: string;
  points: number;
  low: string;
  high: string;
  labels: string[];
  number: number;
  count: number;
  given: number | null;
}

/** What was wrong with a message or a measurement, and what is allowed. The session goes on.
 *
 * `page_message` says it to somebody who takes part without a headset, `messages_by_input` to somebody in VR who
 * selects by another input than a trigger, where these differ. `role`: the person that it concerns. The participant
 * never reads what was wrong with what the experimenter asked for; the experimenter, who helps them, reads both. */
export interface Problem {
  type: "problem";
  message: string;
  role: Role;
  page_message: string;
  messages_by_input: Record<string, string>;
}

/** What the participant feels and hears of one control step.
 *
 * Whether robot or tool touch the left and the right arm, hands included; `events`: how many bites or drops
 * reached the mouth, markers were wiped or scratches made. */
export interface Feedback {
  type: "feedback";
  left_touched: boolean;
  right_touched: boolean;
  events: number;
}

/** How the session stands, several times a second, for those who watch it; never sent to the participant.
 *
 * `step` counts the attempt's control steps, `reward` sums them up, `success` is so far; distance and force are
 * those of the latest one. `force_region` is the region of the body that bears most now, by its limit, and
 * `force_share` how much of that; empty and 0 where none bears anything. `retracting`: the force guard moves the
 * robot. `withdrawing`: after success the robot withdraws its tool, or waits withdrawn. `tracking_age_s` is the
 * time since the newest usable frame. `untracked_parts` have stale poses; those of them that are in
 * `needed_parts`, which the task needs, hold the robot, and end an attempt after a second. `visibility`: whether
 * the participant sees the scene. `operated`: in this trial the experimenter drives; `idle`: the robot holds
 * still for want of an action. `pause_reason`: the answer for which a stop rule paused the session, empty where
 * none did. `latency`: how late pictures were in the last seconds of which the client told, from pose to picture
 * as `total_ms` and by stage. `streams`: those of other devices. */
export interface Status {
  type: "status";
  phase: PhaseName;
  trial: number;
  trials: number;
  attempt: number;
  environment: string;
  paused: boolean;
  pause_reason: string;
  torso_height_m: number;
  step: number;
  steps: number;
  reward: number;
  success: boolean;
  distance_m: number;
  force_on_person_n: number;
  force_region: string;
  force_share: number;
  retracting: boolean;
  withdrawing: boolean;
  tracking_age_s: number | null;
  visibility: Visibility;
  left_modality: Modality;
  right_modality: Modality;
  needed_parts: Part[];
  untracked_parts: Part[];
  operated: boolean;
  idle: boolean;
  latency: StageLatency[];
  streams: StreamStatus[];
}

/** What the last second's ticks of 10 ms took, for those who watch; ticks given up since the beginning. */
export interface Timing {
  type: "timing";
  tick_ms_median: number;
  tick_ms_max: number;
  missed_ticks: number;
}

export type ServerMessage = Welcome | Language | Body | Scene | Placed | Upcoming | Passed | StateChange | Phase | Question | Problem | Feedback | Status | Timing;
