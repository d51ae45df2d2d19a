"""Wherever an episode begins, nothing stands in anything else: neither robot, tool, person nor furniture."""

from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.models import collision_bits
from avrgym.models.human import SEATED_POSE_RAD, TORSO_HEIGHT_RANGE_M, Person, make_seated_joint_angles
from avrgym.people.arm_clearance import compute_arm_clearance_m, compute_person_capsules, make_furniture_boxes
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.tasks.episodes import MAX_START_SAMPLES, Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.live_world.world import LiveWorld
from helpers.simulation.initial_states import (
    HAND_AT_ROBOT_RAD,
    deepest_overlap_m,
    first_step_forces,
    reset_episodes,
)

SCRATCHING, FEEDING = "avrgym/ScratchItchJaco-v1", "avrgym/FeedingJaco-v1"
KINDS = [("original", "limits"), ("revised", "limits"), ("participants", "tremor"), ("zoo/unseen", "tremor")]


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize(("people", "impairment"), KINDS)
def test_nothing_overlaps_and_nothing_presses_at_any_start(environment, people, impairment):
    episodes = reset_episodes(environment, 24, people, impairment)
    assert deepest_overlap_m(episodes) == 0.0
    assert first_step_forces(episodes).max() == 0.0


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_whatever_may_touch_the_person_is_measured(environment):
    episodes = Episodes(environment, 1)
    model, clearance = episodes.simulation.model, episodes._clearance
    assert clearance is not None
    measured = set(zip(clearance._first.tolist(), clearance._second.tolist(), strict=True))
    person = np.nonzero(model.geom_contype == collision_bits.PERSON.contype)[0]
    touching = np.nonzero(model.geom_conaffinity & collision_bits.PERSON.contype)[0]
    assert {(first, second) for first in touching.tolist() for second in person.tolist()} <= measured


def test_starts_with_overlaps_are_drawn_again():
    """Of 128 people with shrunken ranges some have a hand in the robot's arm at the first draw."""
    false = reset_episodes(SCRATCHING, 128, "revised", "limits", checked=False)
    assert deepest_overlap_m(false) > 0.02
    again = reset_episodes(SCRATCHING, 128, "revised", "limits")
    assert 0.05 < (again.num_initial_state_samples > 1).mean() < 0.2
    assert deepest_overlap_m(again) == 0.0
    assert first_step_forces(again).max() == 0.0


@pytest.mark.parametrize("environment", [SCRATCHING, "avrgym/FeedingPR2-v1"])
def test_a_start_without_overlap_is_that_of_the_first_draw(environment):
    old, new = (
        reset_episodes(environment, 24, "revised", "limits", checked=checked) for checked in (False, True)
    )
    first = new.num_initial_state_samples == 1
    assert first.sum() > 15
    for of in (
        Episodes.observe,
        Episodes.compute_marker_positions_w,
        lambda e: e.simulation.get_joint_positions(),
    ):
        assert_array_equal(of(old)[first], of(new)[first])


def test_a_world_drawn_again_has_the_same_bits_alone_and_among_others():
    together = reset_episodes(SCRATCHING, 64, "revised", "limits", num_threads=2)
    again = np.nonzero(together.num_initial_state_samples > 1)[0]
    assert len(again) > 2
    for world in again[:3]:
        alone = Episodes(SCRATCHING, 1, people="revised", impairment="limits", num_threads=1)
        alone.reset(np.array([0]), [np.random.default_rng(int(world))])
        assert alone.num_initial_state_samples[0] == together.num_initial_state_samples[world]
        assert_array_equal(
            alone.simulation.get_integration_state(0), together.simulation.get_integration_state(world)
        )
        assert_array_equal(alone.observe()[0], together.observe()[world])


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize("moving", [False, True])
def test_everybody_who_sits_upright_finds_room(environment, moving):
    for sex, height in product(("man", "woman"), TORSO_HEIGHT_RANGE_M):
        episodes = Episodes(environment, 1, person=Person(sex, height), moving=moving, num_threads=1)
        episodes.reset(np.array([0]), [np.random.default_rng(0)])
        assert deepest_overlap_m(episodes) == 0.0


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (HAND_AT_ROBOT_RAD, "person's right (hand|forearm|upper arm)"),
        (
            make_seated_joint_angles(left_shoulder_y=-20.0, left_elbow_x=0.0),
            "left .* inside the wheelchair left armrest",
        ),
    ],
)
def test_a_person_who_never_has_room_is_refused_in_words(pose, words):
    episodes = Episodes(FEEDING, 2, person=Person("woman", 0.54, pose), num_threads=1)
    with pytest.raises(
        ValueError, match=f"none of {MAX_START_SAMPLES} initial states has enough clearance.*{words}"
    ):
        episodes.reset(np.arange(2), [np.random.default_rng(i) for i in range(2)])


@pytest.mark.slow
def test_no_live_world_begins_inside_the_participant():
    with pytest.raises(NoClearanceError, match="the person's right"):
        LiveWorld(FEEDING, Person("woman", 0.54, HAND_AT_ROBOT_RAD))
    world = LiveWorld(FEEDING, Person("woman", 0.54, SEATED_POSE_RAD))
    world.joint_targets_rad = HAND_AT_ROBOT_RAD
    with pytest.raises(NoClearanceError):
        world.reset(1)


def test_arms_of_shrunken_ranges_leave_body_and_furniture_alone():
    episodes = reset_episodes(SCRATCHING, 256, "revised", "limits")
    boxes = make_furniture_boxes(episodes.scene.furniture)
    assert (
        compute_arm_clearance_m(
            *compute_person_capsules(episodes.people, episodes.scene.posture), boxes
        ).min()
        > -1e-6
    )


@pytest.mark.slow
def test_fitted_people_find_room_too(tmp_path):
    file = tmp_path / "people.toml"
    file.write_text(
        "cooperating = true\n[torso_height_m]\nman = [0.5, 0.7]\nwoman = [0.44, 0.64]\n"
        "[poses.Feeding]\nright_shoulder_x = [-35.0, 10.0]\nright_elbow_x = [-90.0, 0.0]\n"
        "right_shoulder_y = [5.0, 40.0]\n"
    )
    episodes = reset_episodes(FEEDING, 48, str(file), "tremor")
    assert (episodes.num_initial_state_samples > 1).any()
    assert deepest_overlap_m(episodes) == 0.0
    assert first_step_forces(episodes).max() == 0.0


def test_the_check_sees_what_the_simulator_sees():
    """A robot whose contact with the person the simulator reports stands in them, and so says the check."""
    false = reset_episodes(SCRATCHING, 128, "revised", "limits", checked=False)
    touched = np.nonzero(first_step_forces(false) > 0.0)[0]
    judge = Episodes(SCRATCHING, 128, people="revised", impairment="limits", num_threads=1)
    assert judge._clearance is not None
    conflicts = judge._clearance.find_conflicts(false.simulation.get_geoms(np.arange(128)))
    assert all(conflicts[world] is not None for world in touched)
    assert all("person's right hand" in str(conflicts[world]) for world in touched)
