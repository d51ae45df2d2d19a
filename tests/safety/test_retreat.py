"""Robots that have finished take their tools away from people, in every environment."""

from collections.abc import Iterator

import numpy as np
import pytest

from avrgym.models.scene import CONTROL_STEP_S, DEFAULT_SUBSTEPS
from avrgym.policies.trained_policies import find_packaged_policies, load_policy
from avrgym.safety.retreat import MAX_RETREAT_DURATION_S, Retreat
from avrgym.simulation.worlds import State
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS

HELPED_STEPS = 120
"""By then policies are at mouth or arm."""
BRAKED_STEPS = 3
SEEDS = (11, 18)
"""Among them spoons that lie in the mouth, and an arm on whose way the wheelchair stands."""
RELEASED_N = 1.0
"""What the force of a contact may rise by when the brakes let go."""
CARRIED_N, LEFT_N = 12.0, 1.5
"""What the force of a limp arm on the tool may rise by, and what may be left of it, when the tool moves away."""
WITH_POLICIES = [
    environment for environment in ENVIRONMENTS if "revised" in find_packaged_policies(environment)
]


def helped(environment: str, seed: int) -> Episodes:
    """A robot at the end of its trial: it has helped, and its brakes have stopped it."""
    episodes = Episodes(environment, 1, people="revised", moving=True, num_threads=1)
    policy = load_policy("revised", environment, episodes.observation_spec.size, episodes.action_size)
    generators = [np.random.default_rng(seed)]
    episodes.reset(np.array([0]), generators)
    episodes.simulation.command_person(episodes.people.joint_angles_rad)
    for _ in range(HELPED_STEPS):
        episodes.step(policy.act(episodes.observe(), generators))
    episodes.simulation.brake_robot()
    episodes.simulation.step(BRAKED_STEPS * DEFAULT_SUBSTEPS)
    return episodes


def retreated(episodes: Episodes) -> Iterator[State]:
    """The states after each physics step of the robot's retreat."""
    retreat = Retreat(episodes.simulation)
    while (action := retreat.compute_next_action()) is not None:
        episodes.simulation.command_robot(action[None])
        for _ in range(DEFAULT_SUBSTEPS):
            episodes.simulation.step(1)
            yield episodes.simulation.get_state()


def from_mouth_m(state: State) -> float:
    """How far the tool is from the mouth."""
    return float(np.linalg.norm(state.tool_pos_w - state.mouth_pos_w))


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("environment", WITH_POLICIES)
def test_a_tool_leaves_slowly_and_presses_nobody(environment: str, seed: int) -> None:
    episodes = helped(environment, seed)
    carries = "ArmManipulation" in environment
    before = episodes.simulation.get_state()
    states = list(retreated(episodes))
    assert len(states) <= round(MAX_RETREAT_DURATION_S / CONTROL_STEP_S) * DEFAULT_SUBSTEPS
    for state in states:
        assert state.total_force_n[0] <= before.total_force_n[0] + (CARRIED_N if carries else RELEASED_N)
        if np.linalg.norm(state.tool_pos_w - state.head_pos_w) < 0.3:
            assert np.linalg.norm(state.tool_velocity_w) < 0.1
    after = states[-1] if states else before
    assert after.total_force_n[0] <= (LEFT_N if carries else 0.0)
    assert from_mouth_m(after) >= max(0.3, from_mouth_m(before))


def test_a_tool_that_is_away_stays() -> None:
    episodes = Episodes("avrgym/FeedingJaco-v1", 1, moving=True, num_threads=1)
    episodes.reset(np.array([0]), [np.random.default_rng(0)])
    assert Retreat(episodes.simulation).compute_next_action() is None
