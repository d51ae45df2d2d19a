"""Zoo partners: their parameters, and motion according to their style within human limits."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models.human import JOINT_INDEX, SEATED_POSTURE, People, Person
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import distributions, impairments, motor_model, shoulder_limits
from avrgym.people.cooperation import OfferedBodyPart
from avrgym.people.motor_model import MotorState
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partner_behaviour import PartnerState
from avrgym.people.zoo.partners import (
    PARAMETER_BOUNDS,
    PARAMETER_NAMES,
    PARTNER_PARAMETERS,
    PARTNERS,
    ZOO_PARTNER_SETS,
    apply_partner_bodies,
)
from avrgym.people.zoo.styles import PARAMETER_SOURCES, STYLES
from avrgym.simulation.worlds import State
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import TASKS
from helpers.simulation.worlds import resting_state

FEEDING = "avrgym/FeedingJaco-v1"
ALL = np.arange(len(PARTNERS))
HEAD_X, HEAD_Z, WAIST_X, WAIST_Y = (JOINT_INDEX[name] for name in ("head_x", "head_z", "waist_x", "waist_y"))
ELBOW = JOINT_INDEX["right_elbow_x"]
FAR, NEAR = (-0.2, -0.9, 0.0), (-0.1, -0.05, 0.0)
"""Places of the tool from the mouth: an arm's length ahead, and about to arrive from the right."""


def rows(zoo: str, style: str) -> np.ndarray:
    return np.array([i for i, one in enumerate(PARTNERS) if (one.zoo, one.style) == (zoo, style)])


def reset_episodes(partners: np.ndarray, uniforms: float | np.ndarray = 0.3) -> tuple[People, PartnerState]:
    parameters = PARTNER_PARAMETERS.select_partners(partners)
    people = apply_partner_bodies(distributions.repeat_person(Person("man", 0.6), len(partners)), parameters)
    return people, partner_behaviour.make_initial_state(
        people, parameters, np.broadcast_to(uniforms, (len(partners), 4))
    )


def seeing(offset: tuple[float, ...] | np.ndarray) -> State:
    """Observation of an upright person, with the tool at an offset (3,) or (N, 3) from mouth and elbow."""
    mouth, arm = (
        np.array([[0.0, -0.1, 1.2]]),
        np.array([[[-0.2, 0.0, 1.1], [-0.2, 0.0, 0.85], [-0.2, -0.3, 0.85]]]),
    )
    return replace(
        resting_state(),
        tool_pos_w=mouth + offset,
        mouth_pos_w=mouth,
        head_pos_w=mouth + np.array([0.0, 0.1, 0.0]),
        right_arm_pos_w=arm,
    )


@dataclass(frozen=True)
class Moved(PartnerState):
    """Partners with their motor model, and their last joint targets (N, 20)."""

    motor: MotorState
    shown_rad: np.ndarray


def stepped(
    mind: PartnerState,
    people: People,
    offset: tuple[float, ...] | np.ndarray,
    steps: int,
    offered: OfferedBodyPart = "mouth",
) -> Moved:
    moved = (
        mind.motor if isinstance(mind, Moved) else partner_behaviour.make_initial_motor_state(mind, people)
    )
    kept, shown = {name: getattr(mind, name) for name in PartnerState.__dataclass_fields__}, np.empty(0)
    for _ in range(steps):
        now = PartnerState(**{**kept, "joint_targets_rad": moved.second_filter_angles_rad})
        now, goals = partner_behaviour.choose_goal_angles(
            now, sight(offset, len(now.time_s)), offered, SEATED_POSTURE
        )
        moved = motor_model.set_goal_angles(
            moved, possible_for(people)(goals), partner_behaviour.are_startled(now)
        )
        for _ in range(9):
            moved = motor_model.advance_motor_state(moved)
        moved, shown = motor_model.advance_joint_targets_rad(moved, 1)
        kept = vars(now)
    return Moved(
        **{**kept, "joint_targets_rad": moved.second_filter_angles_rad},
        motor=moved,
        shown_rad=possible_for(people)(shown[0]),
    )


def sight(offset: tuple[float, ...] | np.ndarray, count: int) -> State:
    one = seeing(offset)
    names = ("tool_pos_w", "mouth_pos_w", "head_pos_w", "right_arm_pos_w")
    each = {
        name: np.broadcast_to(getattr(one, name), (count, *getattr(one, name).shape[1:])) for name in names
    }
    return replace(one, **each)


def possible_for(people: People):
    return lambda angles: shoulder_limits.clip_shoulders(impairments.clip_to_joint_ranges(people, angles))


# Who there is ------------------------------------------------------------------------------------------------


def test_the_held_out_zoo_has_at_least_625_partners():
    traits = np.stack([getattr(PARTNER_PARAMETERS, trait) for trait in PARAMETER_NAMES], axis=-1)
    zoo = np.array([partner.zoo for partner in PARTNERS])
    unseen = np.unique(traits[zoo == "zoo/unseen"], axis=0)
    assert len(unseen) == len(ZOO_PARTNER_SETS["zoo/unseen"]) >= 625
    assert len(np.unique(traits, axis=0)) == len(PARTNERS)


@pytest.mark.parametrize("trait", [trait for trait in PARAMETER_NAMES if trait != "tremor_hz"])
def test_training_and_held_out_parameters_differ(trait):
    values = {zoo: set[float]() for zoo in ZOO_PARTNER_SETS}
    for row, partner in enumerate(PARTNERS):
        if any(trait in axis for axis in STYLES[partner.style].axis_ranges):
            values[partner.zoo].add(float(getattr(PARTNER_PARAMETERS, trait)[row].round(9)))
    assert values["zoo/train"]
    assert not values["zoo/train"] & values["zoo/unseen"]


def test_each_parameter_has_a_source_or_is_an_assumption():
    assert tuple(PARAMETER_SOURCES) == PARAMETER_NAMES
    for text in PARAMETER_SOURCES.values():
        assert "assumption" in text or re.search(r"\d{4}", text)


def test_extreme_partners_are_outside_the_range_of_training():
    for row, partner in enumerate(PARTNERS):
        if partner.zoo != "zoo/extreme":
            continue
        for axis in STYLES[partner.style].axis_ranges:
            for trait, ends in axis.items():
                value, bounds = (
                    getattr(PARTNER_PARAMETERS, trait)[row],
                    PARAMETER_BOUNDS.get(trait, (0.0, np.inf)),
                )
                assert value <= min(ends) or value >= max(ends)
                assert value not in ends or value in bounds
                assert bounds[0] <= value <= bounds[1]


def test_style_parameters_stay_within_their_ranges():
    for style in STYLES.values():
        moved = [trait for axis in style.axis_ranges for trait in axis]
        assert set(moved) <= set(PARAMETER_NAMES)
        assert len(set(moved)) == len(moved)
    for row, partner in enumerate(PARTNERS):
        if partner.zoo == "zoo/extreme":
            continue
        for axis in STYLES[partner.style].axis_ranges:
            for trait, (first, last) in axis.items():
                assert first - 1e-9 <= getattr(PARTNER_PARAMETERS, trait)[row] <= last + 1e-9


def test_styles_and_their_partners_are_equally_likely(rng):
    partners = ZOO_PARTNER_SETS["zoo/unseen"].sample_partner_rows(rng.random((60_000, 2)))
    styles = [PARTNERS[row].style for row in partners]
    assert {PARTNERS[row].zoo for row in partners} == {"zoo/unseen"}
    for style in STYLES:
        assert styles.count(style) / len(styles) == pytest.approx(1.0 / len(STYLES), abs=0.01)
    assert len(np.unique(partners)) == len(ZOO_PARTNER_SETS["zoo/unseen"])


@pytest.mark.parametrize("name", [*ZOO_PARTNER_SETS, "zoo/train/startled"])
def test_zoos_and_single_styles_have_names(name):
    found = distributions.find_distribution(name, TASKS)
    assert found.is_moving
    assert found.partners is not None
    (row, *_) = found.partners.sample_partner_rows(np.full((1, 2), 0.5)).tolist()
    assert name.startswith(PARTNERS[row].zoo)


@pytest.mark.parametrize("name", ["zoo", "zoo/test", "zoo/train/", "zoo/train/nope", "zoo/unseen/train"])
def test_unknown_zoos_and_styles_list_the_names(name):
    with pytest.raises(
        ValueError, match=r"zoo/train, zoo/unseen, zoo/extreme, a style of the zoo such as .*hesitant"
    ):
        distributions.find_distribution(name, TASKS)


# How they move -----------------------------------------------------------------------------------------------


def test_all_partners_start_at_rest_in_their_pose():
    people, mind = reset_episodes(ALL)
    assert_array_equal(mind.joint_targets_rad, mind.initial_angles_rad)
    assert np.abs(stepped(mind, people, FAR, 1).shown_rad - mind.initial_angles_rad).max() < np.radians(0.6)


@pytest.mark.parametrize("style", ["cooperating", "startled", "talking", "weak"])
def test_no_partner_reacts_before_the_reaction_time(style):
    partners = rows("zoo/unseen", style)
    people, mind = reset_episodes(partners, 0.0)
    steps = np.floor(PARTNER_PARAMETERS.select_partners(partners).reaction_s / CONTROL_STEP_S)
    before = stepped(mind, people, NEAR, int(steps.min()) + 1)
    assert_array_equal(before.joint_targets_rad[:, WAIST_X], mind.initial_angles_rad[:, WAIST_X])
    later = stepped(mind, people, NEAR, int(steps.max()) + 6)
    assert (np.abs(later.joint_targets_rad - mind.initial_angles_rad).max(axis=-1) > 0.01).all()


def test_still_partners_keep_their_pose():
    partners = rows("zoo/train", "still")
    people, mind = reset_episodes(partners)
    assert_array_equal(stepped(mind, people, NEAR, 60).joint_targets_rad, mind.initial_angles_rad)


def test_cooperating_partners_lean_to_the_tool_and_averse_ones_away():
    for style, sign in (("cooperating", 1.0), ("averse", -1.0)):
        people, mind = reset_episodes(rows("zoo/unseen", style))
        moved = stepped(mind, people, NEAR, 40).joint_targets_rad - mind.initial_angles_rad
        assert (moved[:, WAIST_X] > np.radians(4.0)).all() == (sign > 0.0)
        assert (moved[:, WAIST_Y] > np.radians(1.5)).all() == (sign < 0.0)
        back = stepped(stepped(mind, people, NEAR, 40), people, FAR, 60).joint_targets_rad
        assert_allclose(
            back[:, [WAIST_X, WAIST_Y]], mind.initial_angles_rad[:, [WAIST_X, WAIST_Y]], atol=1e-6
        )


def test_hesitant_partners_wait_and_stop_half_way():
    partners = rows("zoo/unseen", "hesitant")
    people, mind = reset_episodes(partners)
    goal = PARTNER_PARAMETERS.select_partners(partners).approach_share * np.radians(10.0)
    leans, wait_s, reaction_s = (
        [],
        PARTNER_PARAMETERS.select_partners(partners).pause_s,
        PARTNER_PARAMETERS.select_partners(partners).reaction_s,
    )
    for _ in range(80):
        mind = stepped(mind, people, NEAR, 1)
        leans.append(mind.joint_targets_rad[:, WAIST_X] - mind.initial_angles_rad[:, WAIST_X])
    leaned = np.array(leans)
    waited = (leaned < 1e-9).sum(axis=0) * CONTROL_STEP_S
    assert (waited >= wait_s).all()
    before_the_rest = ((reaction_s + 1.9 * wait_s) / CONTROL_STEP_S).astype(int)
    half = leaned[before_the_rest, np.arange(len(partners))]
    assert ((half > 0.2 * goal) & (half <= 0.5 * goal + 1e-9)).all()
    assert_allclose(leaned[-1], goal, atol=1e-6)


def test_startled_partners_withdraw_return_and_habituate():
    partners = rows("zoo/unseen", "startled")
    people, mind = reset_episodes(partners)
    peaks = []
    for _ in range(3):
        extent = np.zeros(len(partners))
        for _ in range(12):
            mind = stepped(mind, people, NEAR, 1)
            extent = np.maximum(
                extent, mind.joint_targets_rad[:, WAIST_Y] - mind.initial_angles_rad[:, WAIST_Y]
            )
        peaks.append(extent)
        mind = stepped(mind, people, FAR, 60)
        assert_allclose(mind.joint_targets_rad[:, WAIST_Y], mind.initial_angles_rad[:, WAIST_Y], atol=1e-6)
    assert (peaks[0] > np.radians(3.0)).all()
    assert (peaks[1] < 0.6 * peaks[0]).all()
    assert (peaks[2] < 0.6 * peaks[1]).all()


def test_startled_and_averse_partners_withdraw_the_arm():
    for style in ("startled", "averse"):
        people, mind = reset_episodes(rows("zoo/train", style))
        drawn = (
            stepped(mind, people, (-0.2, 0.1, -0.35), 10, "arm").joint_targets_rad - mind.initial_angles_rad
        )
        assert (drawn[:, ELBOW] < -np.radians(2.0)).all()


def heads(style: str, steps: int = 200) -> np.ndarray:
    """Where the heads of a style turn, (steps, N, 3), degrees from where they were found, the tool far ahead."""
    people, mind = reset_episodes(rows("zoo/unseen", style))
    turned = []
    for _ in range(steps):
        mind = stepped(mind, people, (0.0, -0.9, 0.1), 1)
        turned.append(
            np.degrees(mind.shown_rad - mind.initial_angles_rad)[:, [HEAD_X, JOINT_INDEX["head_y"], HEAD_Z]]
        )
    return np.array(turned)


def test_talking_partners_turn_to_one_side_and_distracted_ones_to_any():
    talking, distracted = heads("talking")[..., 2], heads("distracted")[..., 2]
    assert (np.abs(talking).max(axis=0) > 20.0).all()
    assert ((talking < -10.0).any(axis=0) != (talking > 10.0).any(axis=0)).all()
    share = (np.abs(talking) > 10.0).mean(axis=0)
    assert 0.2 < share.min() < share.max() < 0.8
    assert ((distracted < -5.0).any(axis=0) & (distracted > 5.0).any(axis=0)).all()


def test_chewing_partners_chew_at_their_frequency():
    partners = rows("zoo/unseen", "chewing")
    back = heads("chewing", 100)[10:, :, 0]
    back -= back.mean(axis=0)
    crossings = (np.diff(np.sign(back), axis=0) > 0).sum(axis=0)
    assert_allclose(crossings / 9.0, PARTNER_PARAMETERS.select_partners(partners).chew_hz, atol=0.25)


def test_restless_partners_shift_every_few_seconds():
    partners = rows("zoo/unseen", "restless")
    people, mind = reset_episodes(partners)
    waists = []
    for _ in range(200):
        mind = stepped(mind, people, FAR, 1)
        waists.append(mind.joint_targets_rad[:, WAIST_X : WAIST_X + 3])
    moved = np.degrees(np.ptp(np.array(waists), axis=0))
    assert (moved.max(axis=-1) > 0.5 * PARTNER_PARAMETERS.select_partners(partners).shift_deg).all()
    assert (moved <= 2.0 * PARTNER_PARAMETERS.select_partners(partners).shift_deg[:, None] + 1e-9).all()


def test_styles_set_bodies_and_impairments_add_to_them(rng):
    people = distributions.repeat_person(Person("woman", 0.54), len(ALL))
    body, manner = apply_partner_bodies(people, PARTNER_PARAMETERS), PARTNER_PARAMETERS
    assert_allclose(body.strength_share, manner.strength_share)
    assert_allclose(np.degrees(body.tremor_rad[:, HEAD_X]), manner.tremor_deg)
    uniforms = rng.random((len(ALL), impairments.NUM_RANDOM_NUMBERS))
    weaker = impairments.apply_impairment(body, "weakness", uniforms)
    assert (weaker.strength_share <= body.strength_share).all()
    stiffer = impairments.apply_impairment(body, "limits", uniforms)
    assert (stiffer.range_share <= body.range_share).all()
    shakier = impairments.apply_impairment(body, "tremor", uniforms)
    assert (shakier.tremor_rad >= body.tremor_rad).all()


def test_joints_move_smoothly_between_control_steps():
    """The speeds of joints change by no more in 10 ms than those of a head in running do (Grossman et al., 1988)."""
    episodes = Episodes(FEEDING, 6, people="zoo/train/cooperating", num_threads=1)
    episodes.reset(np.arange(6), [np.random.default_rng(i) for i in range(6)])
    simulation = episodes.simulation
    angles = [simulation.get_person_joint_angles_rad()]
    for _ in range(20):
        episodes.command_robots(np.zeros((6, 7)))
        for substep in range(10):
            episodes.step_physics(substep, 1)
            angles.append(simulation.get_person_joint_angles_rad())
    acceleration = np.diff(np.array(angles), n=2, axis=0) / 0.01**2
    assert 1.0 < np.abs(acceleration).max() < 31.0


def test_a_partner_does_not_depend_on_other_worlds(rng):
    many, alone = (Episodes(FEEDING, count, people="zoo/train", num_threads=1) for count in (9, 1))
    many.reset(np.arange(9), [np.random.default_rng(i) for i in range(9)])
    alone.reset(np.array([0]), [np.random.default_rng(7)])
    for action in rng.uniform(-1.0, 1.0, (25, 9, 7)):
        among, one = many.step(action), alone.step(action[7:8])
        assert_array_equal(among.observation[7], one.observation[0])
        assert_array_equal(among.reward[7], one.reward[0])
