"""A participant's session in simulated time, without network: phases, tracking, calibration, recordings."""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import msgspec
import mujoco
import numpy as np
import pytest

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import transforms
from avrgym.models import human, robot
from avrgym.models.human import Person, Sex
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.recording.reader import Recording
from avrgym.recording.writer import RecordingWriter
from avrgym.safety.approach_speed import compute_effective_mass_kg
from avrgym.safety.brakes import BRAKE_TORQUE_FACTOR
from avrgym.safety.force_guard import INTERVENTION_EVENT, INTERVENTION_FORCE_LIMIT_FRACTION
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N, compute_max_impact_speed_m_s
from avrgym.safety.retreat import MAX_RETREAT_DURATION_S
from avrgym.simulation.worlds import MAX_SERVO_LEAD_RAD
from avrgym.tasks.episodes import Episodes
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    TICK_S,
    Answer,
    Hello,
    OriginReset,
    ParticipantDisconnected,
    ParticipantReady,
    PhaseDescription,
    PhaseName,
    PreviousQuestionRequest,
    Problem,
    Question,
    RecalibrationRequest,
    Stop,
    TrackingFrameMessage,
    VrEntered,
    VrLeft,
    WorldState,
    XRPose,
)
from avrgym.vr.protocol.webxr import compute_hand_pose, compute_head_pose
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.simulation.initial_states import reset_episodes
from helpers.vr.visit import ENVIRONMENT, Visit, events, plan

PhysicsState = Sequence[float] | FloatArray

PHASES: tuple[PhaseName, ...] = (
    "waiting", "calibration", "loading", "check", "free_before", "countdown", "trial", "retreat", "free_after",
    "questionnaire", "paused", "finished",
)  # fmt: skip
RUNNING = ("free_before", "countdown", "trial", "retreat", "free_after", "questionnaire")
"""The phases in which a trial is recorded."""
HELPED = ("retreat", "free_after", "questionnaire")
"""Those in which the robot has helped."""


class Replica:
    """The world of a recording, rebuilt to inspect its states and to step them."""

    def __init__(self, recording: Recording) -> None:
        episodes = Episodes(
            recording.configuration.environment,
            1,
            person=Person(**msgspec.structs.asdict(recording.configuration.person)),
            moving=True,
            num_threads=1,
        )
        episodes.reset(np.array([0]), [np.random.default_rng(recording.configuration.seed)])
        self.model = episodes.simulation.batch.get_model(0)
        self.data = mujoco.MjData(self.model)
        arm = [robot.ROBOT_NAME_PREFIX + joint for joint in episodes.scene.arm.joints]
        self._arm = Arm(
            qpos=[self.model.joint(name).qposadr[0] for name in arm],
            act=[self.model.actuator(name).actadr[0] for name in arm],
            ctrl=[self.model.actuator(name).id for name in arm],
            dof=[self.model.joint(name).dofadr[0] for name in arm],
            brake_n_m=BRAKE_TORQUE_FACTOR * episodes.scene.arm.effort_limit,
        )
        self._person = [self.model.actuator(human.PERSON_NAME_PREFIX + name).id for name in human.JOINTS]
        assert episodes.scene.tool.particles is not None
        self._food = [f"{body}_{axis}" for body in episodes.scene.tool.particles.bodies for axis in "xyz"]

    def put(self, state: PhysicsState) -> mujoco.MjData:
        mujoco.mj_setState(self.model, self.data, np.array(state, float), mujoco.mjtState.mjSTATE_INTEGRATION)
        return self.data

    def step(self, state: PhysicsState, after: PhysicsState, *, helping: bool) -> FloatArray:
        """The state one physics step later, with the controls of ``after``.

        A new command to the arm bounds how far its targets lead; the command to halt puts them on the joints and the
        brakes on. While the robot is helping an arm that is to stand still is none that was halted.
        """
        ctrl, (data, arm) = self.ctrl(after), (self.put(state), self._arm)
        driving = helping or ctrl[arm.ctrl].any()
        self.model.dof_frictionloss[arm.dof] = 0.0 if driving else arm.brake_n_m
        self.model.opt.disableactuator = 0 if driving else 1 << robot.MOTOR_ACTUATOR_GROUP
        if not np.array_equal(data.ctrl[arm.ctrl], ctrl[arm.ctrl]):
            lead = MAX_SERVO_LEAD_RAD if driving else 0.0
            angles = data.qpos[arm.qpos]
            data.act[arm.act] = np.clip(data.act[arm.act], angles - lead, angles + lead)
        data.ctrl[:] = ctrl
        mujoco.mj_step(self.model, data)
        again = np.empty(len(state))
        mujoco.mj_getState(self.model, data, again, mujoco.mjtState.mjSTATE_INTEGRATION)
        return again

    def ctrl(self, state: PhysicsState) -> FloatArray:
        return self.put(state).ctrl.copy()

    def arm_ctrl(self, state: PhysicsState) -> FloatArray:
        return self.ctrl(state)[self._arm.ctrl]

    def person_ctrl(self, state: PhysicsState) -> FloatArray:
        return self.ctrl(state)[self._person]

    def tool_pos_w(self, state: PhysicsState) -> FloatArray:
        mujoco.mj_kinematics(self.model, self.put(state))
        return self.data.body(SCENE_TOOL_BODY).xpos.copy()

    def food_entries(self, size: int) -> IntArray:
        """Which numbers of a state are positions, speeds and loads of the food."""
        place = self.put(range(size))
        joints = [self.model.joint(name) for name in self._food]
        qpos = [place.qpos[joint.qposadr[0]] for joint in joints]
        qvel = [place.qvel[joint.dofadr[0]] for joint in joints]
        load = [place.qfrc_applied[joint.dofadr[0]] for joint in joints]
        return np.array(qpos + qvel + load, np.intp)


@dataclass(frozen=True)
class Arm:
    """Where the arm's joints and servos are in a model's arrays."""

    qpos: list[int]
    act: list[int]
    ctrl: list[int]
    dof: list[int]
    brake_n_m: FloatArray


def records(recording: Recording, topic: str) -> list:
    return [record for _, record in recording.messages_by_topic[topic]]


def states(recording: Recording) -> list[list[float]]:
    return [record.state for record in records(recording, "/physics")]


# A whole session ---------------------------------------------------------------------------------------------

FREE_S = 0.5
GIVEN = (7, 1, 4, 2)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Visit:
    """A practice trial and a trial of full length with the packaged policy, answered and finished."""
    trials = [TrialPlan(ENVIRONMENT, "revised", seed, practice) for seed, practice in ((1, True), (2, False))]
    session = SessionPlan(trials, "woman", FREE_S, is_simulated=True, withdraw_tool_after_success=False)
    visit = Visit(tmp_path_factory.mktemp("whole"), session, load_policies(session))
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.tick(30)
    visit.answer(*GIVEN)
    return visit


@pytest.mark.slow
def test_every_tick_hands_out_its_state(whole: Visit) -> None:
    told = [state.sequence for state in whole.received(WorldState)]
    assert told == list(range(1, len(told) + 1))


@pytest.mark.slow
def test_a_session_goes_through_its_phases_in_order(whole: Visit) -> None:
    around = ["free_before", "countdown", "trial", "retreat", "free_after"]
    assert whole.phases == [
        "waiting", "calibration", "loading", "check", *around, "loading", "ready", *around, "questionnaire", "confirm",
        "finished",
    ]  # fmt: skip
    numbered = [(phase.trial, phase.practice) for phase in whole.received(PhaseDescription)[4:]]
    assert numbered == [(1, True)] * 5 + [(2, False)] * 10
    assert not whole.problems


def test_phases_take_their_time(whole: Visit) -> None:
    for recording, count in zip(whole.recordings(), (4, 5), strict=True):
        entered_s = {
            event.detail: ns / 1e9
            for ns, event in recording.messages_by_topic["/events"]
            if event.name == "phase"
        }
        entered_s.pop("confirm", None)
        retreat_s = entered_s["free_after"] - entered_s.pop("retreat")
        assert 0.0 < retreat_s < MAX_RETREAT_DURATION_S + 0.5
        began_s = np.cumsum([0.0, FREE_S, whole.session.plan.countdown_s, 20.0 + retreat_s, FREE_S])
        assert list(entered_s.values()) == pytest.approx(began_s[:count], abs=3.5 * TICK_S)


def test_a_trial_has_200_control_steps_whose_rewards_add_up(whole: Visit) -> None:
    for recording in whole.recordings():
        control = records(recording, "/control")
        assert recording.is_complete
        assert recording.outcome is not None
        assert recording.outcome.result == "completed"
        assert [record.step for record in control] == list(range(1, 201))
        assert recording.outcome.reward == pytest.approx(sum(record.reward for record in control))
        assert recording.outcome.success == control[-1].success
        weights = recording.configuration.reward_weights
        for record in control:
            terms = sum(weights[name] * term for name, term in record.reward_terms.items())
            assert record.reward == pytest.approx(terms)


def test_the_questionnaire_comes_after_a_trial_and_not_after_practice(whole: Visit) -> None:
    practice, trial = whole.recordings()
    assert [question.item for question in whole.received(Question)] == [item.id for item in LIKERT_ITEMS]
    assert not records(practice, "/answers")
    answers = {record.item: record.value for record in records(trial, "/answers")}
    assert answers == dict(zip((item.id for item in LIKERT_ITEMS), GIVEN, strict=True))


def test_every_tracking_frame_is_recorded_once_in_order(whole: Visit) -> None:
    for recording in whole.recordings():
        frames = records(recording, "/tracking")
        first = frames[0].sequence
        assert [frame.sequence for frame in frames] == list(range(first, first + len(frames)))
        assert all(frame.moved_person and not frame.rejected for frame in frames)


def test_every_recorded_state_follows_bit_for_bit_from_the_one_before(whole: Visit) -> None:
    """But for food that was eaten: the step that ends a control step takes it out of play."""
    for recording in whole.recordings():
        replica, recorded = Replica(recording), np.array(states(recording))
        eating = [r.step - 1 for r in records(recording, "/control") if r.reward_terms["food_in_mouth"]]
        finished = [record.step for record in records(recording, "/physics")]
        food = replica.food_entries(len(recorded[0]))
        for k, (state, after) in enumerate(pairwise(recorded), start=1):
            again = replica.step(state, after, helping=0 < finished[k] < 200)
            if finished[k] in eating and finished[k + 1] > finished[k]:
                again[food] = after[food]
            assert np.array_equal(again, after), f"state {k} differs"


def test_whoever_comes_too_fast_is_an_event_with_region_and_speed(whole: Visit) -> None:
    simulation = reset_episodes(ENVIRONMENT, 1).simulation
    fastest = compute_max_impact_speed_m_s(
        INTERVENTION_FORCE_LIMIT_FRACTION * QUASI_STATIC_LIMIT_N, compute_effective_mass_kg(simulation)
    )
    limits_m_s = {region.name: float(speed) for region, speed in zip(BODY_REGIONS, fastest, strict=True)}
    events = [
        event for recording in whole.recordings() for _, event in recording.messages_by_topic["/events"]
    ]
    details = [
        event.detail for event in events if event.name == INTERVENTION_EVENT and event.detail.endswith("m/s")
    ]
    for detail in details:
        region, *_, speed, _, _, limit, _ = detail.split()
        assert float(limit) == round(limits_m_s[region], 2) <= float(speed)
    assert {detail.split(" at ")[0].partition(" ")[2] for detail in details} == {"and tool approach"}


def test_the_torso_height_is_measured(whole: Visit) -> None:
    measured_m = whole.session.person.torso_height_m
    assert measured_m == pytest.approx(whole.participant.traits.torso_height_m, abs=0.005)
    assert whole.recordings()[1].configuration.person.torso_height_m == measured_m


def test_the_same_seed_gives_the_same_bits(visit: Callable[..., Visit]) -> None:
    def attend(seed: int) -> list:
        attended = visit(practice=True, seeds=(1, seed))
        attended.calibrate()
        attended.run_until("questionnaire")
        attended.answer(4, 4, 4, 4)
        return [
            r.messages_by_topic[topic] for r in attended.recordings() for topic in ("/physics", "/control")
        ]

    one, same, other = attend(2), attend(2), attend(5)
    assert one == same
    assert one[:2] == other[:2]
    assert one[2:] != other[2:]


# Stopping ----------------------------------------------------------------------------------------------------


def test_a_stop_halts_the_robot_and_the_trial_is_repeated(visit: Callable[..., Visit]) -> None:
    stopped = visit()
    stopped.go_to("trial")
    stopped.tick(12)
    stopped.send(Stop())
    assert stopped.phase == "paused"

    first = stopped.recordings()[0]
    assert first.is_complete
    assert first.outcome is not None
    assert (first.outcome.result, first.outcome.steps) == ("stopped", 1)
    assert events(first)[-1] == "robot_holds"
    replica = Replica(first)
    assert np.abs(replica.arm_ctrl(states(first)[-2])).min() > 0.0
    assert not replica.arm_ctrl(states(first)[-1]).any()

    before = digest(stopped.session.recordings[0])
    stopped.send(ParticipantReady())
    stopped.run_until("questionnaire")
    stopped.answer(4, 4, 4, 4)
    assert stopped.phase == "finished"
    again = stopped.recordings()[1]
    assert (first.configuration.attempt_number, again.configuration.attempt_number) == (1, 2)
    assert first.configuration.seed == again.configuration.seed
    assert replica.tool_pos_w(states(first)[0]) == pytest.approx(replica.tool_pos_w(states(again)[0]))
    assert digest(stopped.session.recordings[0]) == before


def test_a_robot_at_full_speed_stands_still_100_ms_after_a_stop(visit: Callable[..., Visit]) -> None:
    stopped = visit()
    stopped.go_to("trial")
    stopped.tick(20)
    before = newest_pos_w(stopped, SCENE_TOOL_BODY)
    stopped.tick(2)
    stopped.send(Stop())
    spot = newest_pos_w(stopped, SCENE_TOOL_BODY)
    places = []
    for _ in range(50):
        stopped.tick(2)
        places.append(newest_pos_w(stopped, SCENE_TOOL_BODY))
    away_m = np.linalg.norm(np.array(places) - spot, axis=1)
    speed_m_s = np.linalg.norm(np.diff(places, axis=0), axis=1) / (2 * TICK_S)
    assert away_m.max() < 0.015
    assert np.linalg.norm(spot - before) / (2 * TICK_S) > 0.05
    assert speed_m_s[5:].max() < 0.05
    assert away_m.max() - away_m[-1] < 0.005


def newest_pos_w(visit: Visit, body: str) -> FloatArray:
    return newest_pose_w(visit, body)[:3]


def newest_pose_w(visit: Visit, body: str) -> FloatArray:
    """A body's pose (7,) as the client was last told."""
    poses = np.frombuffer(visit.received(WorldState)[-1].poses, "<f4").reshape(-1, 7)
    return poses[visit.session.bodies.index(body)].astype(float)


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_stop_after_the_robot_has_finished_keeps_the_trial(visit: Callable[..., Visit]) -> None:
    finished = visit()
    for phase in ("free_after", "questionnaire"):
        finished.go_to(phase) if phase == "free_after" else finished.run_until(phase)
        finished.send(Stop())
        assert finished.phase == phase
    assert len(finished.problems) == 2
    finished.answer(4, 4, 4, 4)
    assert finished.recordings()[0].is_complete


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize(
    "event", [VrLeft(), ParticipantDisconnected(), OriginReset()], ids=lambda event: type(event).__name__
)
@pytest.mark.parametrize("phase", PHASES)
def test_who_goes_away_is_waited_for_and_a_running_trial_is_interrupted(
    visit: Callable[..., Visit], phase: str, event: VrLeft | ParticipantDisconnected | OriginReset
) -> None:
    gone = visit()
    gone.go_to(phase)
    assert gone.phase == phase
    gone.send(event)

    moved = isinstance(event, OriginReset)
    stays = phase == "finished" or (phase == "waiting" and moved)
    after = "questionnaire" if phase in HELPED else "calibration" if moved else "waiting"
    assert gone.phase == (phase if stays else after)
    results = [recording.outcome and recording.outcome.result for recording in gone.recordings()]
    expected = {"paused": ["stopped"], "finished": ["completed"]} | {p: ["interrupted"] for p in RUNNING}
    expected |= {p: [None if moved else "completed"] for p in HELPED}
    assert results == expected.get(phase, [])
    if phase == "trial":
        (recording,) = gone.recordings()
        driving, halted = (Replica(recording).arm_ctrl(state) for state in states(recording)[-2:])
        assert driving.any()
        assert not halted.any()
    gone.tick(2)


def test_who_comes_back_repeats_the_trial(visit: Callable[..., Visit]) -> None:
    back = visit(seeds=(3, 4))
    back.go_to("questionnaire")
    back.answer(4, 4, 4, 4)
    back.run_until("trial")
    back.send(ParticipantDisconnected())
    back.session.send_initial_state(back.inbox.append, "participant", back.now_s)
    kinds = [type(message).__name__ for message in back.inbox[-6:]]
    assert kinds == [
        "Welcome",
        "Language",
        "ParticipantBody",
        "InputProfileMessage",
        "Scene",
        "PhaseDescription",
    ]
    back.participant = SimulatedParticipant(back.participant.traits, 8)
    back.calibrate()
    back.run_until("questionnaire")
    back.answer(4, 4, 4, 4)
    assert back.phase == "finished"
    names = [path.name for path in back.session.recordings]
    assert names == [f"trial-{name}.mcap" for name in ("01_attempt-1", "02_attempt-1", "02_attempt-2")]
    frames = records(back.recordings()[2], "/tracking")
    assert [frame.sequence for frame in frames] == list(range(frames[0].sequence, frames[-1].sequence + 1))
    assert all(frame.moved_person for frame in frames)


def test_messages_that_have_no_place_are_named_and_change_nothing(visit: Callable[..., Visit]) -> None:
    visitor = visit()
    hello = Hello(protocol=1, token="", device="", emulated=True)
    answer = Answer(item="L1", value=4, response_time_s=1.0)
    for phase in PHASES:
        if phase in ("paused", "finished"):
            continue
        visitor.run_until(phase) if phase in RUNNING else None
        if phase == "calibration":
            visitor.send(VrEntered())
            visitor.tick(20)
        if phase == "loading":
            visitor.loads_scenes = visitor.confirms = False
            visitor.send(ParticipantReady())
        if phase == "check":
            visitor.loads_scenes = True
            visitor.run_until(phase)
        wrong: list[tuple[messages.ParticipantMessage, str]] = [(hello, "Hello")]
        if phase != "questionnaire":
            wrong.append((answer, "only while it is shown"))
        if phase not in ("calibration", "check"):
            wrong.append((ParticipantReady(), "You cannot go on now"))
        if phase not in ("questionnaire", "confirm"):
            wrong.append((PreviousQuestionRequest(), "no earlier question"))
        if phase != "check":
            wrong.append((RecalibrationRequest(), "only between two trials"))
        if phase not in ("free_before", "countdown", "trial", "retreat"):
            wrong.append((Stop(), "The robot already holds still"))
        for message, words in wrong:
            said = len(visitor.problems)
            visitor.send(message)
            assert visitor.phase == phase
            assert len(visitor.problems) == said + 1
            assert words in visitor.problems[-1]
        visitor.confirms = phase != "loading"
    visitor.answer(4, 4, 4, 4)
    assert visitor.recordings()[0].is_complete


def test_a_refused_answer_is_asked_again(visit: Callable[..., Visit]) -> None:
    asked = visit()
    asked.go_to("questionnaire")
    for item, value in (("L1", 8), ("L1", 100), ("L2", 4), ("", 4), ("L1 ", 4)):
        questions = len(asked.received(Question))
        asked.send(Answer(item=item, value=value, response_time_s=1.0))
        assert "allowed: " in asked.problems[-1]
        assert [q.item for q in asked.received(Question)[questions:]] == ["L1"]
    asked.answer(1, 7, 1, 7)
    assert [record.value for record in records(asked.recordings()[0], "/answers")] == [1, 7, 1, 7]


# Calibration -------------------------------------------------------------------------------------------------


def test_a_participant_is_measured_only_when_tracked_still_and_seated(visit: Callable[..., Visit]) -> None:
    seated = visit()
    seated.tracking = False
    seated.send(VrEntered())

    def measure(*heights_m: float) -> str:
        """Frames at these heights of the headset, then the trigger; the problem that it gives."""
        for height_m in heights_m:
            seated.send(lifted(seated.frame(), height_m))
            seated.tick(2)
        seated.send(ParticipantReady())
        assert seated.phase == "calibration"
        assert not seated.session.recordings
        return seated.problems[-1]

    assert "not tracked" in measure()
    assert "not tracked" in measure(1.2, 1.2)
    assert "within 3 cm" in measure(1.2, 1.2, 1.24, 1.24, 1.24)
    seated.tick(60)
    assert "1.04 to 1.39 m" in measure(*[3.0] * 10)
    seated.tick(60)
    assert "1.04 to 1.39 m" in measure(*[0.0] * 10)
    seated.tick(60)
    seated.tracking = True
    seated.tick(20)
    seated.send(ParticipantReady())
    assert seated.phase == "loading"


def lifted(frame: TrackingFrameMessage, height_m: float) -> TrackingFrameMessage:
    assert frame.head is not None
    x, _, z = frame.head.position
    head = XRPose((x, height_m, z), frame.head.orientation)
    return messages.TrackingFrameMessage(
        frame.sequence, frame.client_time_ms, head, None, None, "none", "none"
    )


def random_person(sex: Sex, seed: int) -> SimulatedParticipant:
    return SimulatedParticipant(sample_participant_traits(sex, seed), seed)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("sex", human.SEXES)
def test_torso_heights_are_measured_within_5_mm(visit: Callable[..., Visit], sex: Sex) -> None:
    for seed in range(4):
        measured = visit(random_person(sex, seed), sex=sex)
        measured.calibrate()
        assert measured.phase == "loading"
        wanted = measured.participant.traits.torso_height_m
        assert measured.session.person.torso_height_m == pytest.approx(wanted, abs=0.005)


# Tracking ----------------------------------------------------------------------------------------------------

COMFORTABLE_DEG = {
    "waist_x": (-5, 15), "waist_y": (-10, 10), "waist_z": (-10, 10),
    "head_x": (-15, 20), "head_y": (-15, 15), "head_z": (-40, 40),
    **{f"{side}_{part}": limits for side in ("right", "left") for part, limits in {
        "shoulder_x": (-50, 5), "shoulder_z": (-20, 20), "elbow_x": (-110, -50), "forearm_z": (-40, 40),
        "wrist_x": (-20, 20), "wrist_y": (-15, 15)}.items()},
    "right_shoulder_y": (0, 35), "left_shoulder_y": (-35, 0),
}  # fmt: skip


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("sex", human.SEXES)
def test_the_simulated_body_goes_where_the_participant_is(visit: Callable[..., Visit], sex: Sex) -> None:
    random = np.random.default_rng(11)
    visitor = visit(random_person(sex, 3), sex=sex, free_movement_s=100.0)
    visitor.go_to("free_before")
    begins_rad = visitor.participant._angles_rad
    for _ in range(5):
        degrees = {name: random.uniform(*limits) for name, limits in COMFORTABLE_DEG.items()}
        ends_rad = human.make_seated_joint_angles(**degrees)
        for share in np.linspace(0.05, 1.0, 20):
            visitor.pose_rad = begins_rad + share * (ends_rad - begins_rad)
            visitor.tick(4)
        begins_rad = ends_rad
        visitor.tick(60)
        head_m, *hands_m = tracking_errors(visitor)
        assert head_m < 0.02
        assert max(hands_m) < 0.03


def tracking_errors(visit: Visit) -> list[float]:
    """How far simulated head and hands are from where headset and controllers are, metres."""
    frame, registration, person = visit.frame(), visit.session.registration, visit.session.person
    assert frame.head is not None
    assert frame.left is not None
    assert frame.right is not None
    assert registration is not None
    sites = human.compute_body_layout(
        np.array([person.sex == "woman"]), np.array([person.torso_height_m])
    ).site_pos
    wanted = {
        "head_centre": compute_head_pose(registration, frame.head).pos_w,
        "left_hand_centre": compute_hand_pose(registration, frame.left).pos_w,
        "right_hand_centre": compute_hand_pose(registration, frame.right).pos_w,
    }
    found = {}
    for site in wanted:
        pose = newest_pose_w(visit, human.PERSON_NAME_PREFIX + human.SITE_BODIES[site])
        found[site] = pose[:3] + transforms.rotate(pose[3:], sites[site][0])
    return [float(np.linalg.norm(found[site] - wanted[site])) for site in wanted]


def test_a_silent_headset_holds_the_pose(visit: Callable[..., Visit]) -> None:
    silent = visit(free_movement_s=1.0)
    silent.go_to("free_before")
    silent.tick(20)
    silent.tracking = False
    silent.tick(50)
    silent.tracking = True
    silent.run_until("countdown")
    silent.leave()

    recording = silent.recordings()[0]
    lost, found = (
        next(ns for ns, event in recording.messages_by_topic["/events"] if event.name == name) / 1e9
        for name in ("tracking_lost", "tracking_found")
    )
    last_s = max(r.received_time_s for r in records(recording, "/tracking") if r.received_time_s < lost)
    assert lost - last_s == pytest.approx(0.2, abs=1.5 * TICK_S)
    assert 0.5 < found - last_s < 0.6
    replica = Replica(recording)
    held = [
        replica.person_ctrl(record.state)
        for ns, record in recording.messages_by_topic["/physics"]
        if lost <= ns / 1e9 < found - TICK_S
    ]
    assert len(held) > 25
    assert all(np.array_equal(ctrl, held[0]) for ctrl in held)


def broken_poses() -> list[XRPose]:
    """Poses that no headset has: not finite, out of the room, or not turned by a unit quaternion."""
    unit = (0.0, 0.0, 0.0, 1.0)
    numbers = (float("nan"), float("inf"), -float("inf"), 1e30, -1e308, 11.0)
    positions = [XRPose((0.0, number, 0.0), unit) for number in numbers]
    turns = [(0.0,) * 4, (0.0, 0.0, 0.0, 1.1), (1.0,) * 4, *((0.0, 0.0, n, 1.0) for n in numbers)]
    return positions + [XRPose((0.0, 1.2, 0.0), turn) for turn in turns]


def broken_frames(sequence: int) -> list[TrackingFrameMessage]:
    sound = XRPose((0.0, 1.2, 0.0), (0.0, 0.0, 0.0, 1.0))
    placed: list[tuple[XRPose | None, XRPose | None, XRPose | None]] = [(None, sound, sound)]
    for pose in broken_poses():
        placed += [(pose, None, None), (sound, pose, None), (sound, None, pose)]
    return [
        TrackingFrameMessage(sequence, 0.0, head, left, right, "controller", "controller")
        for head, left, right in placed
    ]


def test_frames_that_cannot_be_are_recorded_and_change_nothing(visit: Callable[..., Visit]) -> None:
    """Physics has the same bits with and without them; so do frames that are sent again."""
    plain, fuzzed = visit(), visit()
    sent: list[TrackingFrameMessage] = []
    for visitor in (plain, fuzzed):
        visitor.calibrate()
        visitor.run_until("free_before")
        while visitor.phase != "questionnaire":
            if visitor is fuzzed:
                sequence = 1_000_000 + len(sent)
                sent += (more := [*broken_frames(sequence)[len(sent) % 7 :: 7], replayed(visitor)])
                visitor.send(*more)
            visitor.tick()
        visitor.answer(4, 4, 4, 4)
    one, other = plain.recordings()[0], fuzzed.recordings()[0]
    assert one.messages_by_topic["/physics"] == other.messages_by_topic["/physics"]
    assert np.isfinite(states(other)).all()
    held = [record for record in records(other, "/tracking") if record.rejected]
    assert len(held) == len(sent)
    assert [record.sequence for record in held] == [frame.sequence for frame in sent]
    assert not any(record.moved_person for record in held)


def replayed(visit: Visit) -> TrackingFrameMessage:
    """A sound frame with a number that has been used, of another pose."""
    frame = visit.participant.make_tracking_frame_from_angles(
        human.make_seated_joint_angles(waist_x=20.0), 0.0
    )
    return TrackingFrameMessage(
        0, frame.client_time_ms, frame.head, frame.left, frame.right, "controller", "controller"
    )


def test_of_frames_between_two_ticks_the_newest_counts_and_all_are_recorded(
    visit: Callable[..., Visit],
) -> None:
    burst = visit(free_movement_s=1.0)
    burst.go_to("free_before")
    burst.tracking = False
    burst.tick(2)
    frames = [burst.frame() for _ in range(4)]
    invalid = lifted(burst.frame(), float("nan"))
    burst.send(*frames, invalid)
    burst.tick()
    last = burst.frame()
    burst.send(last, Stop())
    kept = [(r.sequence, r.moved_person, r.rejected) for r in records(burst.recordings()[0], "/tracking")][
        -6:
    ]
    first = frames[0].sequence
    applied = [False, False, False, True, False, False]
    held = [False, False, False, False, True, False]
    assert kept == list(zip(range(first, first + 6), applied, held, strict=True))
    assert burst.received(WorldState)[-1].tracking_sequence_number in (first - 1, first + 3)


# Disks that fail ---------------------------------------------------------------------------------------------


def test_a_full_disk_pauses_the_trial_in_words_and_it_can_be_repeated(
    visit: Callable[..., Visit], small_files: Callable[[int], None]
) -> None:
    full = visit(free_movement_s=1000.0)
    full.go_to("free_before")
    small_files(50_000)
    discard_attempt = time.monotonic() + 30.0
    while full.phase == "free_before" and time.monotonic() < discard_attempt:
        full.tick(10)
    small_files(0)
    assert full.phase == "paused"
    assert "cannot be recorded" in full.problems[-1]
    assert not full.recordings()[0].is_complete
    before = digest(full.session.recordings[0])

    full.send(ParticipantReady())
    full.tick(5)
    assert full.phase == "free_before"
    full.leave()
    assert full.recordings()[1].is_complete
    assert digest(full.session.recordings[0]) == before


def test_a_folder_that_takes_no_file_pauses_in_words(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    visitor = Visit(blocked, plan())
    visitor.calibrate()
    visitor.run_until("paused")
    assert "cannot be recorded" in visitor.problems[-1]
    blocked.unlink()
    visitor.send(ParticipantReady())
    assert visitor.phase == "free_before"
    visitor.leave()


def test_a_trial_whose_recording_cannot_be_ended_is_repeated(
    visit: Callable[..., Visit], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError("the disk is gone")

    visitor = visit()
    visitor.go_to("questionnaire")
    with monkeypatch.context() as broken:
        broken.setattr("avrgym.recording.writer.os.fsync", fail)
        visitor.answer(4, 4, 4, 4)
    assert visitor.phase == "paused"
    assert "the disk is gone" in visitor.problems[-1]
    visitor.send(ParticipantReady())
    visitor.run_until("questionnaire")
    visitor.answer(4, 4, 4, 4)
    assert visitor.phase == "finished"
    assert [recording.is_complete for recording in visitor.recordings()] == [False, True]


@pytest.mark.slow
def test_a_recording_may_fail_at_any_tick_of_a_control_step(
    visit: Callable[..., Visit], monkeypatch: pytest.MonkeyPatch
) -> None:
    visitor = visit()
    visitor.calibrate()
    for ticks in range(1, 12):
        visitor.run_until("trial")
        visitor.tick(ticks - 1)
        with monkeypatch.context() as broken:
            broken.setattr(RecordingWriter, "disk_error", property(lambda _: OSError("full")))
            visitor.tick()
        assert visitor.phase == "paused"
        visitor.send(ParticipantReady())


def test_a_slow_disk_is_named_once_and_the_trial_goes_on(
    visit: Callable[..., Visit], monkeypatch: pytest.MonkeyPatch
) -> None:
    visitor = visit()
    visitor.go_to("trial")
    with monkeypatch.context() as slow:
        slow.setattr(RecordingWriter, "disk_error", property(lambda _: TimeoutError("0.8 s")))
        visitor.tick(5)
    assert sum("slow" in problem.message for problem in visitor.received(Problem)) == 1
    assert visitor.phase == "trial"
    visitor.run_until("questionnaire")
    assert events_so_far(visitor).count("recording_stalled") == 1


def events_so_far(visit: Visit) -> list[str]:
    visit.leave()
    return events(visit.recordings()[-1])
