// Written by `python scripts/write_typescript.py` from the server's own definitions. Do not edit.

export const PROTOCOL = 17;

export const STATES_PER_RECEIPT = 2;

export const STALE_S = 0.2;

export const TICK_S = 0.01;

export const JOINT_STEPS = [1e-05];

export const POSE_STEPS = [0.0001, 0.0001, 0.0001, 5e-05, 5e-05, 5e-05, 5e-05];

export const STAGE_LABELS = {"sample_ms": "pose", "up_ms": "up", "simulate_ms": "simulation", "send_ms": "sending", "down_ms": "down", "draw_ms": "drawing"};

export const FORCE_LIMITS_N: Readonly<Record<string, number>> = {"skull": 130.0, "face": 65.0, "neck": 150.0, "shoulders": 210.0, "chest": 140.0, "abdomen": 110.0, "pelvis": 180.0, "upper_arms": 150.0, "forearms": 160.0, "hands": 140.0, "thighs": 220.0, "lower_legs": 130.0};

export type InputMethod = "controllers" | "experimenter" | "hands" | "head" | "left-hand" | "one-switch" | "right-hand" | "two-switches";

export type StopInput = "buttons" | "experimenter" | "gaze" | "palm" | "switch";

export type ClientCommandSource = "button" | "dwell" | "key" | "switch";

export type OtherPersonCommandSource = "caregiver" | "experimenter";

export type RobotCommandName = "again" | "closer" | "farther" | "faster" | "other_side" | "ready" | "slower" | "stop" | "wait";

export type Side = "left" | "right";

export type TrackedBodyPart = "head" | "left" | "right";

export type FurniturePoint = "front" | "headrest" | "rear" | "top";

export type Sex = "man" | "woman";

export type Contrast = "high" | "normal";

export type PanelPosition = "centre" | "left" | "right";

export type Vector3 = [number, number, number];

export type Quaternion = [number, number, number, number];

export type NormalizedVector = [number, number, number];

export type Modality = "controller" | "hand" | "mouse" | "none";

export type StopMethod = "button" | "gaze" | "key" | "page" | "palm" | "select" | "squeeze" | "switch" | "triggers";

export type Visibility = "context-lost" | "hidden" | "visible" | "visible-blurred";

export type ExperimenterCommandName = "break" | "continue" | "end" | "pause" | "recalibrate" | "repeat" | "skip" | "stop";

export type OperatorRole = "demonstrator" | "operator";

export type DemonstrationButton = "discard" | "start" | "success";

export type PhaseName = "break" | "calibration" | "check" | "confirm" | "countdown" | "finished" | "free_after" | "free_before" | "headset" | "headset_check" | "headset_stop" | "loading" | "paused" | "questionnaire" | "reach" | "ready" | "retreat" | "trial" | "viewing" | "waiting";

export type DemonstrationStage = "finished" | "preparing" | "ready" | "running";

export type Role = "caregiver" | "demonstrator" | "experimenter" | "participant" | "spectator";

export const PHASES_WHERE: Record<"has_motion" | "can_be_stopped" | "awaits_confirmation" | "can_choose_body", readonly PhaseName[]> = {
  has_motion: ["headset_check", "headset_stop", "free_before", "countdown", "trial", "retreat", "free_after"],
  can_be_stopped: ["headset_stop", "free_before", "countdown", "trial", "retreat"],
  awaits_confirmation: ["headset", "calibration", "reach", "check", "ready", "confirm", "break", "paused"],
  can_choose_body: ["waiting", "calibration", "check", "ready", "break", "paused"],
};

/** A pose in WebXR's `local-floor` space: position in metres (y up), orientation x, y, z, w. */
export type XRPose = [position: Vector3, orientation: Quaternion];

/** Dimensions of a person's body in metres, for inverse and forward kinematics.
 *
 * `hips_pos_w` and `hips_q_w` (w, x, y, z): the pose of the hips in the world frame. `waist` is in the frame of
 * the hips; `neck` and `right_shoulder` are in the frame of the torso. `head_centre_m`: height above the neck. */
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

/** Latency of a stage between tracking and display: percentiles in milliseconds. */
export interface StageLatency {
  stage: string;
  p50: number;
  p95: number;
  p99: number;
}

/** Whether the stream of another device is available. `name`: name of the stream in the study. */
export interface StreamStatus {
  name: string;
  present: boolean;
}

/** A robot command that the participant can give, and its label in the participant's language. */
export interface CommandLabel {
  name: RobotCommandName;
  label: string;
}

/** A button or another object that the participant can select: its value and its label. */
export interface SelectionTarget {
  value: number;
  label: string;
}

/** Presentation of texts and sounds to a participant.
 *
 * `text_deg` determines the size of the whole panel in VR: at 1.5° the panel is 31° wide. On the page without a
 * headset, it determines the font size in proportion.
 *
 * Raises:
 *     ValueError: for a value out of range. */
export interface PresentationPreferences {
  text_deg: number;
  panel_distance_m: number;
  contrast: Contrast;
  position: PanelPosition;
  reduced_motion: boolean;
  read_aloud: boolean;
  captions: boolean;
}

/** The first message of a connection. `token` is in the fragment of the page's address. */
export interface Hello {
  type: "hello";
  protocol: number;
  token: string;
  device: string;
  emulated: boolean;
}

/** The poses of one XR frame. `sequence` increases by one; `client_time_ms` is the XR frame's time stamp.
 *
 * `left` and `right` are grip poses of controllers, or wrist poses of bare hands, depending on the modality.
 * `None`: not tracked. */
export interface TrackingFrameMessage {
  type: "tracking";
  sequence: number;
  client_time_ms: number;
  head: XRPose | null;
  left: XRPose | null;
  right: XRPose | null;
  left_modality: Modality;
  right_modality: Modality;
}

/** Acknowledges states; sent after every `STATES_PER_RECEIPT` states. `num_states`: number of all received
 * states. */
export interface StateReceipt {
  type: "receipt";
  states: number;
}

/** The participant entered VR. */
export interface VrEntered {
  type: "entered";
}

/** The participant left VR. The connection may remain open. */
export interface VrLeft {
  type: "left";
}

/** The participant pressed the trigger to confirm, in a phase that waits for this. */
export interface ParticipantReady {
  type: "ready";
}

/** The client displays the scene with this address. */
export interface SceneLoaded {
  type: "scene_loaded";
  url: string;
}

/** The emergency stop: the robot must hold still immediately. `method`: the participant's action. */
export interface Stop {
  type: "stop";
  method: StopMethod | null;
}

/** A command of the participant to the robot, see `avrgym.commands.vocabulary`.
 *
 * `source`: the source of the command, such as a key. `client_time_ms`: time of the input, on the page's clock. */
export interface RobotCommand {
  type: "robot_command";
  name: RobotCommandName;
  source: ClientCommandSource;
  client_time_ms: number;
}

/** The visibility of the scene has changed. After each `welcome`, the server assumes `visible`. */
export interface VisibilityChanged {
  type: "visibility_changed";
  visibility: Visibility;
}

/** The participant requests a new calibration, because the virtual body or seat does not fit. */
export interface RecalibrationRequest {
  type: "recalibrate";
}

/** The participant requests a break before the next trial. */
export interface BreakRequest {
  type: "request_break";
}

/** The participant requests the questions about preferences for the robot, before the next trial. */
export interface PreferenceChangeRequest {
  type: "change_preferences";
}

/** The origin of the reference space has changed, so the registration is invalid. */
export interface OriginReset {
  type: "origin_reset";
}

/** The answer to a questionnaire item, with the response time since its display. */
export interface Answer {
  type: "answer";
  item: string;
  value: number;
  response_time_s: number;
}

/** The participant requests the previous question, to change the answer. */
export interface PreviousQuestionRequest {
  type: "back";
}

/** The participant's choice of a body model. A change of the sex requires a new calibration. */
export interface BodyChoice {
  type: "choose_body";
  sex: Sex;
  skin_tone: string;
}

/** The targets that the participant can select now. The experimenter may select a target for the participant.
 *
 * `offer_number` increases with each offer. An offer without targets ends the previous offer. */
export interface OfferedTargets {
  type: "offered";
  number: number;
  targets: SelectionTarget[];
}

/** Latencies of the frames of the last second, from tracking to display. */
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

/** Frame intervals of the last second during the headset check, with a description of the device.
 *
 * `device`: the browser's user agent. `profiles`: input profiles of the controllers. `display_hz`: refresh rate
 * of the display, if known. */
export interface FrameIntervals {
  type: "headset_frames";
  device: string;
  emulated: boolean;
  profiles: string[];
  display_hz: number | null;
  intervals_ms: number[];
}

export type ParticipantMessage = Hello | TrackingFrameMessage | StateReceipt | VrEntered | VrLeft | ParticipantReady | SceneLoaded | Stop | RobotCommand | VisibilityChanged | RecalibrationRequest | BreakRequest | PreferenceChangeRequest | OriginReset | Answer | PreviousQuestionRequest | BodyChoice | OfferedTargets | Latency | FrameIntervals;

/** A command of the experimenter.
 *
 * `stop`: stop the robot immediately; the participant may repeat the trial. `pause`: stop the robot, and
 * start no trial before `continue`. `repeat`: a new attempt at the trial. `skip`: go to the next
 * trial. `end`: end the session. `recalibrate`: calibrate the participant again. `break`: a break before
 * the next trial. */
export interface ExperimenterCommand {
  type: "command";
  name: ExperimenterCommandName;
}

/** The participant's torso height as the experimenter measured it. The body is rebuilt with this height. */
export interface TorsoHeightCorrection {
  type: "correct_torso_height";
  torso_height_m: number;
}

/** The experimenter's choice of the participant's body model, as `BodyChoice`. */
export interface ParticipantBodyChoice {
  type: "choose_body";
  sex: Sex;
  skin_tone: string;
}

/** The experimenter selects a target for the participant. */
export interface TargetSelectionRequest {
  type: "press";
  number: number;
  value: number;
}

/** The tracked controller touches a point of the real seat or mattress. The points are front, rear and top. */
export interface FurniturePointMark {
  type: "mark_point";
  point: FurniturePoint;
}

/** Velocity command of the operator for the robot's hand, sent many times a second while `engaged`.
 *
 * The components are shares of the maximum speeds. `linear`: forward, left and up in the participant's frame;
 * `angular`: about these axes. The robot holds still when the operator disengages or sends no commands. `source`
 * is the sender. */
export interface VelocityCommand {
  type: "drive";
  engaged: boolean;
  linear: NormalizedVector;
  angular: NormalizedVector;
  source: OperatorRole;
}

/** The demonstrator's controller in one XR frame. While `clutch` is true, the tool repeats its relative motion.
 *
 * `grip`: pose of the grip in the demonstrator's `local-floor` space; `None`: not tracked. `xr_from_world`:
 * pose of the world in this space. `scale`: translation of the tool divided by the translation of the controller. */
export interface ControllerPoseCommand {
  type: "steer";
  clutch: boolean;
  grip: XRPose | null;
  xr_from_world: XRPose;
  scale: number;
}

/** A pressed button in a demonstration session: it starts an episode, ends it as a success, or discards it. */
export interface DemonstrationCommand {
  type: "demonstrate";
  button: DemonstrationButton;
}

/** A command of the caregiver or the experimenter to the robot, as `RobotCommand`. */
export interface OtherPersonRobotCommand {
  type: "robot_command";
  name: RobotCommandName;
  source: OtherPersonCommandSource;
  client_time_ms: number;
}

/** A watcher's page displays the scene with this address. The environment viewer waits for this; sessions do not. */
export interface WatcherSceneLoaded {
  type: "scene_watched";
  url: string;
}

export type WatcherMessage = Hello | StateReceipt | ExperimenterCommand | TorsoHeightCorrection | ParticipantBodyChoice | TargetSelectionRequest | FurniturePointMark | VelocityCommand | ControllerPoseCommand | DemonstrationCommand | OtherPersonRobotCommand | WatcherSceneLoaded;

/** The server accepts the connection in a role. `haptics`, `sounds`: whether the session plan enables this
 * feedback. */
export interface Welcome {
  type: "welcome";
  protocol: number;
  session: string;
  role: Role;
  haptics: boolean;
  sounds: boolean;
}

/** The participant's language: its tag, its direction (`ltr` or `rtl`) and the texts of the page by key. */
export interface Language {
  type: "language";
  language: string;
  direction: string;
  texts: Record<string, string>;
}

/** The participant's body model, and the available skin tones: names and RGB values in [0, 1]. */
export interface ParticipantBody {
  type: "body";
  sex: Sex;
  skin_tone: string;
  skin_tones: string[];
  skin_tones_rgb: Vector3[];
}

/** The participant's input profile, with the stop methods. */
export interface InputProfileMessage {
  type: "input";
  method: InputMethod;
  dwell_s: number;
  scan_s: number;
  select_key: string;
  resting_arms: Side[];
  absent_arms: Side[];
  stops: StopInput[] | null;
  presentation: PresentationPreferences;
}

/** The targets that the participant can select now, for experimenters. */
export interface ParticipantTargets {
  type: "targets";
  number: number;
  targets: SelectionTarget[];
}

/** The experimenter selected a target. The participant's client ignores this message if the offer is no longer
 * valid. */
export interface TargetSelected {
  type: "pressed";
  number: number;
  value: number;
}

/** A scene to display: the address of a GLB file, and the pose of the world. Nodes of the file have `extras.body`.
 *
 * `xr_from_world`: pose of the z-up world frame in `local-floor`, for the root node. `bodies`: the order of the
 * poses in later state messages. `marks`: number of spheres on the person that show the targets of the task. In
 * state messages, their positions come after the bodies. All marks have the same radius and colour (RGB in [0, 1]).
 * The first-person view hides `head_bodies`. Its viewpoint is `eyes`, in the frame of the first head body (x left,
 * −y forward, z up). `skeleton`: the participant's body dimensions. Names of the participant's bodies begin with
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

/** Commands the client to move the world linearly to another pose in `local-floor`, in a given time.
 *
 * The server sends this message when a participant has slid on the seat. */
export interface WorldMotion {
  type: "placed";
  xr_from_world: XRPose;
  seconds: number;
}

/** The address of the next scene, which the client may fetch in advance. */
export interface NextScene {
  type: "upcoming";
  url: string;
}

/** Times of a tracking frame in the server, in seconds of the server's clock.
 *
 * `received_s`: the frame was received. `simulated_s`: the first state that includes it was computed. `sent_s`:
 * this state was sent. This state is the next message. */
export interface TrackingFrameTimes {
  type: "passed";
  tracking_sequence: number;
  received_s: number;
  simulated_s: number;
  sent_s: number;
}

/** The state of the world at one time, as the difference to the previous state of this connection.
 *
 * The first state after a `scene` message contains all rows. `tracking_sequence`: the newest tracking frame that
 * this state includes, -1 before the first. `joint_targets`: target angles of the person's joints.
 * `deviating_parts`: parts of the body that cannot follow tracking, because of an obstacle or lost tracking. The
 * client draws the simulated poses of these parts.
 *
 * `joint_targets` has steps of 1e-5 rad and one row per joint. `poses` has one row x, y, z, w, x, y, z per body or
 * mark. Positions have steps of 0.1 mm, quaternions of 5e-5. Unchanged rows are omitted. Each row begins with the
 * number of omitted rows before it. Its differences follow in zigzag encoding. All numbers are varints of Protocol
 * Buffers. */
export interface WorldStateChange {
  type: "state";
  sequence: number;
  simulation_time_s: number;
  tracking_sequence: number;
  deviating_parts: TrackedBodyPart[];
  joint_targets: Uint8Array;
  poses: Uint8Array;
}

/** The phase of the session, with the text for the participant.
 *
 * `trial`: number of the running or next trial, from 1. `trials`: number of trials. `seconds`: time limit.
 * `text` is for VR with a trigger. `texts_by_input`: texts for other input methods. `page_text`: text for the
 * page without a headset. `key`: the key of the text. `preferences`: whether the participant may change their
 * preferences for the robot now. */
export interface PhaseDescription {
  type: "phase";
  name: PhaseName;
  text: string;
  trial: number;
  trials: number;
  practice: boolean;
  seconds: number | null;
  page_text: string;
  texts_by_input: Record<string, string>;
  key: string;
  preferences: boolean;
}

/** A questionnaire item.
 *
 * `item`: its identifier. `points`: number of points of the scale. `low`, `high`: texts at the ends of the
 * scale. `labels`: texts of the buttons; default: numbers from 1 to `points`. `number`: position in the
 * questionnaire, from 1. `count`: number of items. `previous_answer`: the earlier answer, if the participant went
 * back to this item. */
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
  previous_answer: number | null;
}

/** An error in a message or a measurement, with the allowed values. The session continues.
 *
 * `message` is for VR with a trigger. `page_message`: text for the page without a headset. `messages_by_input`:
 * texts for other input methods. `role`: the role that receives the problem. The experimenter receives all problems. */
export interface Problem {
  type: "problem";
  message: string;
  role: Role;
  page_message: string;
  messages_by_input: Record<string, string>;
}

/** The robot commands that are possible now; an empty list if no command is possible. Sent when a field changes its
 * value.
 *
 * `sources`: the allowed sources. `mode`: the mode of the pacing layer, see `avrgym.safety.pacing`; empty
 * without the layer. `speed_factor`: factor of the policy's speed. `distance_m`: distance at which the robot
 * waits. */
export interface AvailableRobotCommands {
  type: "robot_commands";
  commands: CommandLabel[];
  sources: ("gaze" | "nod" | "shake" | ClientCommandSource | OtherPersonCommandSource)[];
  mode: string;
  speed_factor: number;
  distance_m: number;
}

/** Haptic and acoustic feedback for one control step.
 *
 * `left_touched`, `right_touched`: whether robot or tool touch this arm or hand. `events`: the number of task
 * successes in this step: bites or drops in the mouth, wiped targets, or scratches. */
export interface HapticAndAudioFeedback {
  type: "feedback";
  left_touched: boolean;
  right_touched: boolean;
  events: number;
}

/** The status of the session, several times a second, for watchers only.
 *
 * `step`: number of control steps of the attempt. `steps`: number of control steps of a complete trial.
 * `reward`: the sum of rewards. `success`: whether the attempt has succeeded until now. `distance_m` and
 * `force_on_person_n` are values of the latest step. `force_region`: the body region with the highest ratio of
 * force to allowed force; empty without contact. `force_share`: this ratio; 0 without contact.
 *
 * `retracting`: the force guard moves the robot. `withdrawing`: the robot withdraws its tool after success, or has
 * withdrawn it. `operated`: the experimenter drives the robot in this trial. `idle`: the robot holds still without
 * an action. `paused`: no trial may start. `pause_reason`: the answer that met a stop rule; empty without such an
 * answer.
 *
 * `tracking_age_s`: time since the newest valid frame. `untracked_parts`: parts of the body with stale poses. If
 * one of them is in `needed_parts`, the robot holds still, and the attempt ends after a second. `latency`: recent
 * latencies from tracking to display, in total (`total_ms`) and by stage. `streams`: streams of other devices.
 * `headset_s`: the participant's time in VR. `headset_limit_s`: the maximum time in VR. `break_is_due`: a break
 * follows before the next trial. */
export interface SessionStatus {
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
  needed_parts: TrackedBodyPart[];
  untracked_parts: TrackedBodyPart[];
  operated: boolean;
  idle: boolean;
  latency: StageLatency[];
  streams: StreamStatus[];
  headset_s: number;
  headset_limit_s: number | null;
  break_is_due: boolean;
}

/** Durations of the ticks of the last second, for watchers, and the number of skipped ticks since the start. */
export interface TickTiming {
  type: "timing";
  tick_ms_median: number;
  tick_ms_max: number;
  missed_ticks: number;
}

/** The contact force of the tool on the person, in newtons, for demonstrators. Sent when it changes. */
export interface ToolForce {
  type: "tool_force";
  force_n: number;
}

/** Progress of a demonstration session, for watchers. Sent when it changes.
 *
 * `stage`: `preparing` (the next world is built), `ready` (waits for the start), `running` or `finished`.
 * `goal`: the task. `episodes`: planned number; `None`: unlimited. `completed`, `successes` and
 * `discarded`: numbers of episodes. `seconds`: maximum duration of an episode. `policy`: name of the policy that
 * drives until an operator takes over; empty without a policy. */
export interface DemonstrationProgress {
  type: "demonstration_progress";
  stage: DemonstrationStage;
  goal: string;
  episodes: number | null;
  completed: number;
  successes: number;
  discarded: number;
  seconds: number;
  policy: string;
}

export type ServerMessage = Welcome | Language | ParticipantBody | InputProfileMessage | ParticipantTargets | TargetSelected | Scene | WorldMotion | NextScene | TrackingFrameTimes | WorldStateChange | PhaseDescription | Question | Problem | AvailableRobotCommands | HapticAndAudioFeedback | SessionStatus | TickTiming | ToolForce | DemonstrationProgress;
