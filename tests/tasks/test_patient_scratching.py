import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.steadied import steadied
from avrgym.tasks.known import EPISODE_STEPS
from avrgym.tasks.scratch_itch.expert import surface
from avrgym.tasks.scratch_itch.patient import INWARDS, NOT_DOWN, TurnsOver, patient_expert
from avrgym.tasks.scratch_itch.reactive import faces_in
from avrgym.tasks.scratch_itch.reward import limb_frame
from itches import forearm_itch

INNER_RAD = np.radians(np.linspace(-165.0, -135.0, 8))
"""Places on the forearm that face the other arm, from its outer side."""


def begun(robot: str, angle_rad: np.ndarray) -> Episodes:
    """Episodes with itches in the middle of the forearm."""
    count = len(angle_rad)
    episodes = Episodes(f"avrgym/ScratchItch{robot}-v1", count, distribution="revised", num_threads=1)
    episodes.begin(np.arange(count), [np.random.default_rng([8, i]) for i in range(count)])
    episodes.task_state = forearm_itch(episodes, angle_rad)
    return episodes


@pytest.mark.parametrize(
    ("robot", "angle_rad"), [("Jaco", INNER_RAD), ("PR2", np.radians(np.linspace(-60.0, 60.0, 8)))]
)
def test_who_need_not_turn_the_arm_does_as_the_reactive_expert(robot, angle_rad):
    episodes = begun(robot, angle_rad)
    patient, reactive = patient_expert(episodes), episodes.task.reactive_expert(episodes)
    for _ in range(40):
        observation = episodes.observe()
        action = patient(observation)
        assert_array_equal(action, reactive(observation))
        episodes.step(action)


def test_the_arm_of_the_pr2_turns_over_once_before_it_comes_to_the_inner_side():
    episodes = begun("PR2", INNER_RAD)
    patient, reactive = TurnsOver(episodes), episodes.task.reactive_expert(episodes)
    out_w, _ = surface(episodes.task_state, limb_frame(episodes.state(), episodes.task_state)[1])
    assert np.all(faces_in(out_w, INWARDS, NOT_DOWN) == 1.0)
    turned = []
    for _ in range(60):
        observation = episodes.observe()
        action = patient(observation)
        if not turned:
            assert np.all((action * patient._way_rad).sum(axis=-1) > 0.0)
            assert np.abs(action - reactive(observation)).max() > 0.1
        turned.append(patient._turned.copy())
        episodes.step(action)
    assert not turned[0].any()
    assert turned[-1].mean() > 0.7
    assert np.all(np.diff(np.array(turned, dtype=int), axis=0) >= 0)


@pytest.mark.slow
def test_the_inner_side_of_the_forearm_is_scratched_by_an_arm_that_turned_over():
    episodes = begun("PR2", INNER_RAD)
    scratches = steadied(patient_expert)(episodes)
    for _ in range(EPISODE_STEPS):
        step = episodes.step(scratches(episodes.observe()))
    assert step.success.mean() >= 0.75
