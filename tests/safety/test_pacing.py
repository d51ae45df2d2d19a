"""Laws of the pacing layer: never faster than the scaled policy, stop always wins, a waiting robot does not move."""

from copy import deepcopy

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.array_types import FloatArray, IntArray
from avrgym.commands.preferences import (
    MAX_SPEED_FACTOR,
    MIN_SPEED_FACTOR,
    BiteTiming,
    ConditionRules,
    Preferences,
    TrialRules,
    apply_preferences,
)
from avrgym.commands.vocabulary import COMMAND_NAMES, CommandName, CommandSource
from avrgym.policies import registry
from avrgym.safety.pacing import (
    COMMAND_INPUT_ENTRIES,
    CONTINUING_MODE,
    DISTANCE_TOLERANCE_M,
    PACING_MODES,
    PacingLayer,
)
from avrgym.safety.retreat import RETREAT_TOOL_SPEED_M_S
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes

FEEDING, SCRATCHING = "avrgym/FeedingJaco-v1", "avrgym/ScratchItchPR2-v1"
SEEDS = (0, 3)
POLICIES = ("revised", "adaptive", "oracle", "random")
"""A policy of each packaged kind: feedforward, recurrent, expert, random."""
SETTLING_STEPS = 6
"""Control steps within which an arm goes from the policy's speed to that of the layer."""


def rules(*, commands: tuple[CommandName, ...] = COMMAND_NAMES, **preferences) -> TrialRules:
    sources: tuple[CommandSource, ...] = ("key",) if commands else ()
    wishes = Preferences(**preferences)
    condition = ConditionRules(policy="revised", commands=commands, sources=sources, defaults=wishes)
    return apply_preferences(condition, None)


def paced(applied: TrialRules, environment: str = FEEDING) -> tuple[Episodes, PacingLayer]:
    episodes = Episodes(environment, len(SEEDS), people="revised", num_threads=1, rules=applied)
    episodes.reset(np.arange(len(SEEDS)), generators())
    assert episodes.control_loop.pacing is not None
    return episodes, episodes.control_loop.pacing


def generators() -> list[np.random.Generator]:
    return [np.random.default_rng(seed) for seed in SEEDS]


def drive(
    episodes: Episodes, policy: str, steps: int, script: dict[int, CommandName]
) -> list[tuple[FloatArray, StepOutcome, IntArray, FloatArray]]:
    """Take control steps. Returns for each one the policy's actions, the step, modes and speed factors."""
    pacing = episodes.control_loop.pacing
    assert pacing is not None
    found = list[tuple[FloatArray, StepOutcome, IntArray, FloatArray]]()
    environment = episodes.environment_id
    with registry.open_policy(registry.resolve_policy(policy, environment), episodes, generators()) as act:
        for number in range(steps):
            if number in script:
                episodes.control_loop.apply_command(script[number])
            actions = act(episodes.observe()).astype(float)
            step = episodes.step(actions)
            found.append((actions, step, pacing.mode_index.copy(), pacing.speed_factor.copy()))
    return found


def test_the_layer_only_scales_the_actions_of_the_policy(rng: np.random.Generator) -> None:
    _, pacing = paced(rules())
    for factor in np.linspace(MIN_SPEED_FACTOR, MAX_SPEED_FACTOR, 9):
        pacing.mode_index[:], pacing.speed_factor[:] = CONTINUING_MODE, factor
        actions = rng.normal(0.0, 1.5, (2, 7))
        executed = pacing.override_within_step(actions)
        assert (np.abs(executed) <= np.minimum(1.0, factor * np.abs(np.clip(actions, -1, 1)))).all()
        assert (executed * actions >= 0.0).all()


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.fast_cases(2)
def test_no_controller_moves_faster_than_scaled(policy: str) -> None:
    """Law: the executed action is the scaled one, or the tool moves with the speed of a retreat, or not at all."""
    episodes, _ = paced(rules())
    script: dict[int, CommandName] = {2: "slower", 18: "faster", 22: "ready", 32: "wait"}
    since = np.zeros(2)
    before = np.full(2, -1)
    for actions, step, mode, factor in drive(episodes, policy, 48, script):
        since = np.where(mode == before, since + 1, 0)
        before = mode
        for world in range(2):
            name = PACING_MODES[mode[world]]
            if name in ("approaching", "continuing"):
                scaled = np.clip(factor[world] * np.clip(actions[world], -1, 1), -1, 1)
                assert_array_equal(step.executed_action[world], scaled)
            elif since[world] >= SETTLING_STEPS:
                limit = RETREAT_TOOL_SPEED_M_S + 0.02 if name == "backing_off" else 0.01
                assert step.tool_speed_m_s[world] < limit, name


@pytest.mark.parametrize("environment", [FEEDING, SCRATCHING])
def test_a_robot_waits_for_ready_at_its_distance(environment: str) -> None:
    episodes, pacing = paced(rules(distance_m=0.12), environment)
    drive(episodes, "revised", 45, {})
    assert pacing.waiting_mask.all()
    assert (np.abs(pacing.tool_distance_m - 0.12) < DISTANCE_TOLERANCE_M + 0.02).all()
    (first, *_) = drive(episodes, "revised", 12, {0: "ready"})
    assert (first[1].executed_action != 0.0).any(axis=-1).all()
    assert (pacing.tool_distance_m < 0.10).all()


def test_stop_wins_over_every_later_command() -> None:
    episodes, _ = paced(rules())
    script: dict[int, CommandName] = {6: "stop", **{7 + i: name for i, name in enumerate(COMMAND_NAMES)}}
    steps = drive(episodes, "random", 24, script)
    assert all((step.executed_action == 0.0).all() for _, step, _, _ in steps[6:])
    assert (steps[-1][1].tool_speed_m_s < 0.01).all()
    assert {PACING_MODES[mode] for _, _, modes, _ in steps[6:] for mode in modes} == {"stopped"}


def test_wait_backs_off_and_other_side_changes_the_side() -> None:
    episodes, pacing = paced(rules())
    drive(episodes, "revised", 80, {5: "ready", 30: "wait"})
    assert pacing.waiting_mask.all()
    assert (pacing.tool_distance_m > 0.14).all()
    state = episodes.get_state()
    before = np.sign(state.tool_pad_pos_w[:, 0] - state.mouth_pos_w[:, 0])
    drive(episodes, "revised", 60, {0: "other_side"})
    state = episodes.get_state()
    assert pacing.waiting_mask.all()
    assert_array_equal(np.sign(state.tool_pad_pos_w[:, 0] - state.mouth_pos_w[:, 0]), -before)


@pytest.mark.parametrize("timing", ["after_swallowing", "with_company"])
def test_robots_can_continue_without_a_command(timing: BiteTiming) -> None:
    episodes, _ = paced(rules(commands=(), bite_timing=timing, pause_s=1.0))
    modes = np.array([mode for _, _, mode, _ in drive(episodes, "revised", 70, {})])
    waiting = (modes == PACING_MODES.index("waiting")).sum(axis=0)
    assert (waiting >= 10).all()
    assert (modes[-1] == CONTINUING_MODE).any()


def test_preferences_without_waiting_change_no_bit() -> None:
    """Law: with speed 1 and no reason to wait, the clipped actions are executed."""
    plain = Episodes(FEEDING, len(SEEDS), people="revised", num_threads=1)
    plain.reset(np.arange(len(SEEDS)), generators())
    episodes, _ = paced(rules(commands=(), side="left"))
    with registry.open_policy(registry.resolve_policy("revised", FEEDING), plain, generators()) as act:
        for _, step, _, _ in drive(episodes, "revised", 20, {}):
            other = plain.step(np.clip(act(plain.observe()).astype(float), -1, 1))
            assert_array_equal(step.observation, other.observation)


def test_a_copy_continues_with_the_same_bits() -> None:
    episodes, _ = paced(rules())
    drive(episodes, "revised", 24, {3: "ready", 18: "wait"})
    copied = deepcopy(episodes)
    for _ in range(4):
        one, other = (each.step(np.full((2, 7), 0.3)) for each in (episodes, copied))
        assert_array_equal(one.observation, other.observation)


def test_again_ends_a_withdrawal() -> None:
    episodes = Episodes(
        FEEDING, 2, people="revised", num_threads=1, withdraw_after_success=True, rules=rules()
    )
    episodes.reset(np.arange(2), generators())
    drive(episodes, "revised", 60, {2: "ready"})
    assert episodes.control_loop.withdrawing_mask.any()
    effective = episodes.control_loop.apply_command("again")
    assert effective[episodes.control_loop.withdrawing_mask | effective].all()
    assert not episodes.control_loop.withdrawing_mask.any()
    drive(episodes, "revised", 5, {})
    assert not episodes.control_loop.withdrawing_mask.any()


def test_controllers_receive_the_latest_command() -> None:
    episodes, pacing = paced(rules())
    pacing.apply_command("slower", np.array([True, False]))
    episodes.step(np.zeros((2, 7)))
    seen = [
        dict(zip(COMMAND_INPUT_ENTRIES, row, strict=True))
        for row in episodes.control_loop.make_command_input()
    ]
    assert (seen[0]["slower"], seen[1]["slower"]) == (1.0, 0.0)
    assert (seen[0]["speed_factor"], seen[1]["speed_factor"]) == (0.75, 1.0)
    assert seen[0]["age_s"] < 0.2 < seen[1]["age_s"]


@pytest.mark.slow
@pytest.mark.parametrize("environment", [SCRATCHING, "avrgym/ScratchItchJaco-v1"])
def test_peak_forces_are_not_higher_than_without_the_layer(environment: str) -> None:
    """The same 16 people, with and without the layer. They give ``ready`` after 1 s, at half of the speeds."""
    worlds, peak_n = 16, list[FloatArray]()
    for applied in (None, rules()):
        random = [np.random.default_rng(seed) for seed in range(worlds)]
        episodes = Episodes(environment, worlds, people="participants", num_threads=1, rules=applied)
        episodes.reset(np.arange(worlds), random)
        pacing, waited, peaks_n = episodes.control_loop.pacing, np.zeros(worlds), np.zeros(worlds)
        with registry.open_policy(registry.resolve_policy("revised", environment), episodes, random) as act:
            for _ in range(150):
                if pacing is not None:
                    waited = np.where(pacing.waiting_mask, waited + 1, 0)
                    episodes.control_loop.apply_command(
                        "slower", (waited == 5) & (np.arange(worlds) % 2 == 0)
                    )
                    episodes.control_loop.apply_command("ready", waited == 10)
                step = episodes.step(act(episodes.observe()).astype(float))
                peaks_n = np.maximum(peaks_n, step.force_on_person_n)
        peak_n.append(peaks_n)
    higher_n = peak_n[1] - peak_n[0]
    assert higher_n.mean() < 2.0 * higher_n.std() / np.sqrt(worlds)
    assert peak_n[0].min() > 0.0
