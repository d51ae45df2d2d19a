"""Behaviour parameters are recovered from motion that the models of behaviour and movement produce."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from avrgym.analysis.fit_behaviour import fit_behaviour
from avrgym.analysis.recorded_motion import MOTION_JOINT_NAMES, RecordedMotion
from avrgym.analysis.statistics.shrinkage import shrink_estimates
from avrgym.models.human import JOINT_INDEX, SEATED_POSTURE, People, Person
from avrgym.models.scene import CONTROL_STEP_S, DEFAULT_SUBSTEPS
from avrgym.people import motor_model
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partners import BehaviourParameters, apply_partner_bodies, make_behaviour_parameters

PARTICIPANTS, TRIALS, STEPS = 4, 2, 80
MOUTH_W, HEAD_W = np.array([0.0, -0.1, 1.2]), np.array([0.0, 0.0, 1.2])
COLUMNS = [JOINT_INDEX[name] for name in MOTION_JOINT_NAMES]


@dataclass(frozen=True)
class Seen:
    """What people perceive in one step: an upright head, and a tool."""

    tool_pos_w: np.ndarray
    head_pos_w: np.ndarray
    mouth_pos_w: np.ndarray
    right_arm_pos_w: np.ndarray


def recorded(parameters: BehaviourParameters, rng: np.random.Generator) -> list[RecordedMotion]:
    """Motion of people with these parameters (n,), in ``TRIALS`` trials each: the tool comes and goes, twice."""
    rows = np.repeat(np.arange(PARTICIPANTS), TRIALS)
    own, count = parameters.select_partners(rows), PARTICIPANTS * TRIALS
    people = apply_partner_bodies(People.from_persons([Person("man", 0.6)] * count), own)
    state = partner_behaviour.make_initial_state(people, own, rng.random((count, 4)))
    moved = partner_behaviour.make_initial_motor_state(state, people)
    time_s = CONTROL_STEP_S * np.arange(STEPS)[:, None]
    distance_m = 0.3 + 0.26 * np.cos(2.0 * np.pi * time_s / 6.0 + rng.uniform(-0.5, 0.5, count))
    sideways_m = 0.25 * np.sin(2.0 * np.pi * time_s / 3.7 + rng.uniform(0.0, 6.0, count))
    tool_w = MOUTH_W + np.stack([sideways_m, -distance_m, 0.3 * sideways_m], axis=-1)
    head_w, mouth_w = (np.broadcast_to(each, (count, 3)) for each in (HEAD_W, MOUTH_W))
    arm_w, shown = np.zeros((count, 3, 3)), []
    for tool in tool_w:
        state, goals = partner_behaviour.choose_goal_angles(
            replace(state, joint_targets_rad=moved.second_filter_angles_rad),
            Seen(tool, head_w, mouth_w, arm_w),
            "mouth",
            SEATED_POSTURE,
        )
        moved = motor_model.set_goal_angles(moved, goals, partner_behaviour.are_startled(state))
        moved, targets = motor_model.advance_joint_targets_rad(moved, DEFAULT_SUBSTEPS)
        shown.append(targets[..., COLUMNS])
    angles = np.concatenate(shown)
    return [
        RecordedMotion(
            participant=f"sub-{rows[number]}",
            person=Person("man", 0.6),
            offered_body_part="mouth",
            posture=SEATED_POSTURE,
            tool_pos_w=tool_w[:, number],
            head_pos_w=np.tile(head_w[number], (STEPS, 1)),
            mouth_pos_w=np.tile(mouth_w[number], (STEPS, 1)),
            right_arm_pos_w=np.zeros((STEPS, 3, 3)),
            joint_angles_rad=angles[:, number],
            first_robot_motion_sample=0,
        )
        for number in range(count)
    ]


@pytest.mark.slow
def test_parameters_are_recovered_and_a_participant_who_never_starts_stays_so():
    rng = np.random.default_rng(3)
    spread = np.linspace(-1.0, 1.0, PARTICIPANTS)

    def scattered(mean: float, deviation: float) -> np.ndarray:
        return mean + deviation * rng.permutation(spread)

    true = {
        "reaction_s": scattered(0.4, 0.15),
        "facing_share": scattered(0.5, 0.2),
        "approach_share": scattered(0.8, 0.3),
        "speed_share": scattered(0.8, 0.2),
        "sway_deg": scattered(0.8, 0.3),
        "sway_hz": scattered(0.3, 0.05),
        "tremor_deg": scattered(0.5, 0.2),
        "tremor_hz": scattered(6.0, 1.0),
    }
    values = [{name: float(each[row]) for name, each in true.items()} for row in range(PARTICIPANTS)]
    fit = fit_behaviour(recorded(make_behaviour_parameters(values), rng))
    for name, each in true.items():
        error = fit.estimates_by_parameter[name].posterior_mean - each
        assert np.sqrt(np.mean(error**2)) < each.std(), name
    assert fit.estimates_by_parameter["startle_deg"].posterior_mean.max() < 1.5
    assert all(low >= 0.0 for one in fit.list_participant_estimates() for low, _ in one.values())


def test_shrinkage_covers_the_parameters_of_a_group(rng: np.random.Generator):
    """Intervals of 90 % contain 90 % of the parameters; the mean squared error is smaller than that of estimates."""
    covered, raw, shrunken = [], [], []
    for _ in range(300):
        variances = rng.uniform(0.1, 2.0, 12)
        true = rng.normal(3.0, 1.0, 12)
        estimates = rng.normal(true, np.sqrt(variances))
        found = shrink_estimates(estimates, variances)
        covered.append(np.abs(found.posterior_mean - true) < 1.645 * found.posterior_sd)
        raw.append((estimates - true) ** 2)
        shrunken.append((found.posterior_mean - true) ** 2)
    assert np.mean(covered) == pytest.approx(0.9, abs=0.05)
    assert np.mean(shrunken) < 0.8 * np.mean(raw)


def test_equal_estimates_are_shrunk_to_their_mean():
    found = shrink_estimates(np.array([1.0, 1.0, 1.0]), np.array([0.1, 0.2, 0.3]))
    assert found.group_sd == 0.0
    assert found.posterior_mean == pytest.approx([1.0, 1.0, 1.0])
