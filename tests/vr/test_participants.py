"""Simulated participants: valid frames of a person in a room, and answers that depend on the trial."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from avrgym.array_types import FloatArray
from avrgym.models import human
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import JOINT_INDEX, RECLINED_POSTURE, SEATED_POSTURE, SEXES, Person, Sex
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.networks.policy import Policy
from avrgym.people.distributions import find_distribution
from avrgym.people.population_names import IMPAIRMENTS, ImpairmentName
from avrgym.people.zoo.partner_behaviour import MAX_JOINT_SPEED_RAD_S
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.recording.reader import read_recording
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, find_environment
from avrgym.vr.emulation.in_process_client import STATE_INTERVAL_TICKS, InProcessClient
from avrgym.vr.emulation.simulated_participant import (
    RATING_RULES,
    SimulatedParticipant,
    sample_participant_traits,
)
from avrgym.vr.live_world.scene_message import encode_world_poses as world_poses
from avrgym.vr.live_world.scene_message import make_scene_message
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import (
    SentMessage,
    TrackingFrameMessage,
    WorldState,
    XRPose,
    decode_participant_message,
    encode_message,
)
from avrgym.vr.protocol.webxr import Registration, is_valid_pose
from avrgym.vr.session.attempt import AttemptResults
from avrgym.vr.session.session import Session
from avrgym.vr.tracking.calibration import measure_torso_height
from helpers.learning.random_networks import random_network
from helpers.vr.visit import constant_policies, plan

FEEDING, BATHING = "avrgym/FeedingJaco-v1", "avrgym/BedBathingJaco-v1"


def participant(seed: int, sex: Sex = "woman") -> SimulatedParticipant:
    return SimulatedParticipant(sample_participant_traits(sex, seed), seed)


def poses(frame: TrackingFrameMessage) -> list[XRPose]:
    return [pose for pose in (frame.head, frame.left, frame.right) if pose is not None]


def numbers(frame: TrackingFrameMessage) -> list[float]:
    return [number for pose in poses(frame) for number in (*pose.position, *pose.orientation)]


@pytest.mark.parametrize("sex", SEXES)
def test_frames_are_sound_at_any_time(sex: Sex) -> None:
    for seed in range(5):
        someone = participant(seed, sex)
        for time_s in (0.0, 0.01, 1.0, 59.9, 3600.0):
            for moving in (False, True):
                frame = someone.make_tracking_frame(time_s, moving=moving)
                assert len(poses(frame)) == 3
                assert np.isfinite(numbers(frame)).all()
                assert all(is_valid_pose(pose) for pose in poses(frame))
                norms = [np.linalg.norm(pose.orientation) for pose in poses(frame)]
                assert norms == pytest.approx([1.0] * 3, abs=1e-9)
                assert frame.client_time_ms == 1000.0 * time_s
                assert decode_participant_message(encode_message(frame)) == frame


def test_frames_are_counted() -> None:
    someone = participant(1)
    frames = [someone.make_tracking_frame(0.1 * i, moving=bool(i % 2)) for i in range(10)]
    frames.append(someone.make_tracking_frame_from_angles(human.SEATED_POSE_RAD, 1.0))
    assert [frame.sequence for frame in frames] == list(range(11))


@pytest.mark.parametrize("sex", SEXES)
def test_torso_heights_are_those_of_the_papers_participants(sex: Sex) -> None:
    heights_m = [sample_participant_traits(sex, seed).torso_height_m for seed in range(200)]
    assert 0.51 <= min(heights_m) < 0.515
    assert 0.575 < max(heights_m) <= 0.58


@pytest.mark.parametrize("sex", SEXES)
def test_lying_and_sitting_participants_have_the_same_height(sex: Sex) -> None:
    someone = participant(4, sex)
    measured = []
    for environment, posture in ((FEEDING, SEATED_POSTURE), (BATHING, RECLINED_POSTURE)):
        someone.adopt_posture(environment)
        head = someone.make_tracking_frame(7.0, moving=False).head
        assert head is not None
        measured.append(measure_torso_height(sex, posture, head, RealFurniture()))
    assert measured == pytest.approx([someone.traits.torso_height_m] * 2)
    with pytest.raises(ValueError, match="unknown environment 'avrgym/Flying-v1'"):
        someone.adopt_posture("avrgym/Flying-v1")


def arm_after_watching(cooperation: float, environment: str) -> FloatArray:
    """The right hand of somebody who watched the tool near their elbow for two seconds, in their own room."""
    traits = replace(
        sample_participant_traits("woman", 2), cooperation_fraction=cooperation, sway_amplitude_deg=0.0
    )
    someone = SimulatedParticipant(traits, 2)
    someone.adopt_posture(environment)
    world = LiveWorld(
        environment,
        Person("woman", traits.torso_height_m, TASKS["BedBathing"].pose_distribution.rest_angles_rad),
    )
    someone.receive(world.make_scene_message(0, Registration(np.zeros(3), 0.0)))
    poses = np.frombuffer(world.encode_poses(), "<f4").reshape(-1, 7).copy()
    poses[world.bodies.index(SCENE_TOOL_BODY)] = poses[world.bodies.index("person/right_forearm")]
    for i in range(20):
        someone.receive(WorldState(i, 0.1 * i, -1, b"", [], poses.tobytes()))
    someone.make_tracking_frame(2.0, moving=True)
    hand = someone.make_tracking_frame(3.0, moving=True).right
    assert hand is not None
    return np.array(hand.position)


def test_a_cooperative_participant_moves_the_arm_to_the_tool() -> None:
    still, half, full = (arm_after_watching(share, BATHING) for share in (0.0, 0.5, 1.0))
    assert 0.01 < np.linalg.norm(half - still) < np.linalg.norm(full - still)


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("people", ["original", "zoo/unseen"])
@pytest.mark.parametrize("impairment", IMPAIRMENTS)
def test_people_of_other_kinds_move_smoothly_and_have_their_own_heights(
    people: str, impairment: ImpairmentName
):
    distribution = find_distribution(people, TASKS)
    for seed in range(6):
        traits = sample_participant_traits("man", seed, distribution, impairment)
        assert (
            distribution.torso_height_man_m[0] <= traits.torso_height_m <= distribution.torso_height_man_m[1]
        )
        assert (traits.behaviour_parameters is not None) == (people == "zoo/unseen")
        someone = SimulatedParticipant(traits, seed)
        frames = [someone.make_tracking_frame(0.02 * i, moving=True).head for i in range(50)]
        places = np.array([frame.position for frame in frames if frame is not None])
        assert np.isfinite(places).all()
        assert np.abs(np.diff(places, axis=0)).max() < 0.04, "as far as heads tremble by 20° at 5 Hz"


@pytest.mark.parametrize("sex", SEXES)
def test_a_participant_at_rest_looks_horizontally(sex: Sex) -> None:
    someone = participant(4, sex)
    head = someone.make_tracking_frame(7.0, moving=False).head
    assert head is not None
    height_m = human.BODY_DIMENSIONS[sex].seated_hips_height_m + someone.traits.torso_height_m
    assert head.position[1] == pytest.approx(height_m, abs=1e-9)
    assert (head.orientation[0], head.orientation[2]) == pytest.approx((0.0, 0.0), abs=1e-9)
    still = [numbers(someone.make_tracking_frame(time_s, moving=False)) for time_s in (0.0, 3.0)]
    assert still[0] == pytest.approx(still[1], abs=1e-8)


def test_movements_are_smooth_and_limited() -> None:
    """Steadily, a little, and no faster than people sway."""
    for seed in range(3):
        someone = participant(seed)
        times_s = np.arange(0.0, 20.0, 0.05)
        heads = np.array(
            [poses(someone.make_tracking_frame(time_s, moving=True))[0].position for time_s in times_s]
        )
        travelled_m = np.ptp(heads, axis=0).max()
        assert 0.002 < travelled_m < 0.15
        assert np.abs(np.diff(heads, axis=0)).max() / 0.05 < 0.2


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_watching_participant_turns_to_the_arm_and_back(environment: str) -> None:
    someone = participant(2)
    someone.adopt_posture(environment)
    turned = [
        degrees_off_the_right_hand(
            someone.make_tracking_frame(0.1 * step, moving=False, watching=10 <= step < 30)
        )
        for step in range(60)
    ]
    offers_arm = TASKS[find_environment(environment)[0]].offered_body_part == "arm"
    assert (turned[20] < 35.0) == offers_arm
    assert_allclose(turned[50:], turned[0], atol=0.01)
    assert np.abs(np.diff(turned)).max() < 10.0


def degrees_off_the_right_hand(frame: TrackingFrameMessage) -> float:
    """Between where the headset points and where the right controller is."""
    assert frame.head is not None
    assert frame.right is not None
    ahead = Rotation.from_quat(frame.head.orientation).apply([0.0, 0.0, -1.0])
    there = np.subtract(frame.right.position, frame.head.position)
    return float(np.degrees(np.arccos(ahead @ there / np.linalg.norm(there))))


def test_the_same_seed_gives_the_same_participant() -> None:
    def attend(seed: int) -> tuple[list[TrackingFrameMessage], list[int]]:
        someone = participant(seed)
        frames = [someone.make_tracking_frame(0.1 * i, moving=True) for i in range(20)]
        return frames, [someone.rate_item("L1", 7, AttemptResults(success=bool(i % 2))) for i in range(20)]

    assert attend(3) == attend(3)
    assert attend(3)[0] != attend(4)[0]
    assert attend(3)[1] != attend(4)[1]


RESULTS = (
    AttemptResults(),
    AttemptResults(success=True, force_mean_n=3.0, force_max_n=30.0, tool_speed_mean_m_s=0.1),
    AttemptResults(success=True, force_mean_n=1e6, force_max_n=1e9, tool_speed_mean_m_s=1e6),
)


@pytest.mark.parametrize("points", [2, 3, 7, 100])
def test_answers_lie_on_the_scale(points: int) -> None:
    someone = participant(5)
    for item, results in product([*RATING_RULES, "own"], RESULTS):
        answers = [someone.rate_item(item, points, results) for _ in range(100)]
        assert all(type(answer) is int for answer in answers)
        assert 1 <= min(answers) <= max(answers) <= points


def mean_answer(item: str, results: AttemptResults, seed: int = 6) -> float:
    """Of one participant on a scale of a hundred points."""
    someone = participant(seed)
    return float(np.mean([someone.rate_item(item, 100, results) for _ in range(300)]))


@pytest.mark.parametrize(
    ("rated", "better", "worse"),
    [
        (["L1"], AttemptResults(success=True), AttemptResults(success=False)),
        (["L2"], AttemptResults(force_mean_n=1.0), AttemptResults(force_mean_n=10.0)),
        (["L3"], AttemptResults(force_max_n=5.0), AttemptResults(force_max_n=40.0)),
        (["L2", "L4"], AttemptResults(tool_speed_mean_m_s=0.1), AttemptResults(tool_speed_mean_m_s=0.5)),
    ],
)
def test_ratings_depend_on_the_trial(rated: list[str], better: AttemptResults, worse: AttemptResults) -> None:
    for item in (*RATING_RULES, "own"):
        difference = mean_answer(item, better) - mean_answer(item, worse)
        assert difference > 20.0 if item in rated else difference == 0.0


def test_a_robot_that_hardly_moves_has_no_appropriate_speed() -> None:
    slow, unhurried = (mean_answer("L4", AttemptResults(tool_speed_mean_m_s=speed)) for speed in (0.0, 0.1))
    assert unhurried > slow + 20.0


def test_participants_rate_the_same_more_and_less_leniently_and_never_quite_alike() -> None:
    means = [mean_answer("own", AttemptResults(), seed) for seed in range(8)]
    assert np.std(means) > 3.0
    someone = participant(6)
    assert len({someone.rate_item("own", 7, AttemptResults()) for _ in range(50)}) > 1


@pytest.mark.slow
def test_a_participant_sits_through_a_session(tmp_path: Path) -> None:
    phases, seen = list[str](), list[int]()
    client = InProcessClient(participant(1), phases.append)
    trials = plan(practice=True, seeds=(1, 2), trial_steps=5)

    def send(message: SentMessage) -> None:
        if isinstance(message, WorldState):
            seen.append(message.sequence_number)
        client.receive(message)

    session = Session(
        trials, constant_policies(trials), tmp_path, send, "whole", state_interval_ticks=STATE_INTERVAL_TICKS
    )
    client.run(session)
    assert phases[-1] == "finished (trial 2 of 2)"
    assert set(np.diff(seen)) == {2, 3}, (
        "a state that is due when a control step ends is that of the next tick"
    )
    practice, trial = (read_recording(path) for path in session.recordings)
    assert practice.is_complete
    assert trial.is_complete
    assert [answer.item for _, answer in trial.messages_by_topic["/answers"]] == [
        item.id for item in LIKERT_ITEMS
    ]
    assert all(
        answer.response_time_s == pytest.approx(1.5, abs=0.05)
        for _, answer in trial.messages_by_topic["/answers"]
    )


@pytest.mark.slow
def test_a_participant_sits_and_then_lies_through_a_session(tmp_path: Path) -> None:
    client = InProcessClient(participant(1), lambda text: None)
    trials = plan(environments=(FEEDING, BATHING), seeds=(1, 2))
    session = Session(trials, constant_policies(trials), tmp_path, client.receive, "lying")
    client.run(session)
    assert session.person.torso_height_m == pytest.approx(participant(1).traits.torso_height_m, abs=0.002)
    assert all(read_recording(path).is_complete for path in session.recordings)


@pytest.mark.slow
def test_a_participant_gives_up_after_failed_starts(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    client = InProcessClient(participant(1), lambda text: None)
    session = Session(plan(), constant_policies(plan()), blocked, client.receive, "blocked")
    with pytest.raises(RuntimeError, match=r"trial 1 does not start: .*cannot be recorded"):
        client.run(session)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.fast_cases(3)
def test_a_trained_human_acts_in_vr_as_in_training(environment, monkeypatch):
    """But for the itch, whose mark is drawn above the skin, and for forces, of which a headset tells nothing."""
    told: list[np.ndarray] = []
    trained = random_network(environment, deviation=0.0)
    act = Policy.act
    monkeypatch.setattr(Policy, "act", lambda self, seen, *how: (told.append(seen), act(self, seen, *how))[1])
    task = TASKS[find_environment(environment)[0]]
    traits = sample_participant_traits("man", 3, trained=trained)
    person = Person("man", traits.torso_height_m, task.pose_distribution.rest_angles_rad)
    worlds = Episodes(environment, 1, person=person, human_actions=True, num_threads=1)
    worlds.reset(np.array([0]), [np.random.default_rng(0)])
    someone = SimulatedParticipant(traits, 3)
    someone.adopt_posture(environment)
    someone.receive(make_scene_message(0, worlds, Registration(np.zeros(3), 0.0)))
    for step in range(4):
        someone.receive(WorldState(step, 0.1 * step, -1, b"", [], world_poses(worlds)))
    (seen,) = worlds.observe_humans()
    goal = ~np.isnan(worlds.human_observer.scale)
    assert_allclose(told[0][0, ~goal], seen[~goal], atol=1e-5)
    assert_allclose(told[0][0, goal], seen[goal], atol=0.03)
    acted = np.clip(trained.compute_mean_actions(told[0])[0], -1.0, 1.0)
    offered = [JOINT_INDEX[name] for name in worlds.offered_joints]
    way = someone._wanted_rad[0] - person.joint_angles_rad
    rest_rad = person.joint_angles_rad[offered]
    targets_rad = rest_rad + 4 * 0.1 * MAX_JOINT_SPEED_RAD_S[offered] * acted
    targets_rad = np.clip(targets_rad, human.LOWER_LIMITS_RAD[offered], human.UPPER_LIMITS_RAD[offered])
    assert_allclose(way[offered], targets_rad - rest_rad, atol=1e-6)
    assert_allclose(np.delete(way, offered), 0.0)
    rest, gone = (
        numbers(someone.make_tracking_frame(1.0 + moving, moving=moving)) for moving in (False, True)
    )
    assert np.abs(np.subtract(rest, gone)).max() > 1e-3
