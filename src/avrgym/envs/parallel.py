"""Robot and human as two agents: PettingZoo's parallel environment of one world. Needs the extra ``pettingzoo``."""

# The types of PettingZoo's functions are known only in part.
# pyright: reportUnknownMemberType=false, reportMissingTypeStubs=false

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from pettingzoo import ParallelEnv

from avrgym.array_types import Float32Array, FloatArray
from avrgym.envs.rendering import Renderer
from avrgym.envs.single import check_render_mode, make_info, make_metadata, make_spaces
from avrgym.envs.vector_conventions import check_episode_length, to_python_seed
from avrgym.models.human import Person, convert_to_person
from avrgym.tasks.actions import validate_actions
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.settings import make_settings

Action = Float32Array

ROBOT_AGENT, HUMAN_AGENT = "robot", "human"


class AssistiveParallelEnv(Renderer, ParallelEnv[str, FloatArray, Action]):
    """One world with two agents. The robot's observations, rewards and infos are the same as with ``gym.make``.

    The human's action (K,) contains a number in [−1, 1] for each of ``human_joints``: the joint's speed divided by its
    maximum speed. With the zero action, the human does not move.
    """

    metadata: dict[str, Any]

    def __init__(
        self,
        environment_id: str,
        *,
        people: str = "original",
        person: Person | Mapping[str, Any] | None = None,
        impairment: str = "none",
        shared_reward: bool = True,
        force_guard: bool = False,
        render_mode: str | None = None,
        max_episode_steps: int = EPISODE_STEPS,
        **settings: Any,
    ) -> None:
        """Create one world. People, person, impairment and force guard are arguments of ``Episodes``.

        The other keyword arguments are fields of ``Settings``. The human's actions replace the movements of the
        population. ``person`` may be a mapping with the fields of ``Person``. Without ``shared_reward``, the human's
        reward contains the penalty for the human's action, not the penalty for the robot's action.

        Raises:
            ValueError: for an unknown name. The message lists the allowed names.
        """
        check_render_mode(render_mode, environment_id)
        self.render_mode, self._shared_reward = render_mode, shared_reward
        check_episode_length(max_episode_steps)
        self.max_episode_steps = max_episode_steps
        self.episodes = Episodes(
            environment_id,
            1,
            people=people,
            person=convert_to_person(person),
            impairment=impairment,
            human_actions=True,
            num_threads=1,
            force_guard=force_guard,
            settings=make_settings(settings),
        )
        self.metadata = {**make_metadata(self.episodes), "name": environment_id}
        self.human_joints = self.episodes.offered_joints
        """Joints that the human's action moves, in the order of the action."""
        self.possible_agents, self.agents = [ROBOT_AGENT, HUMAN_AGENT], []
        bound, (seen, acted) = self.episodes.human_observer.bound, make_spaces(self.episodes)
        self.observation_spaces = {
            ROBOT_AGENT: seen,
            HUMAN_AGENT: gym.spaces.Box(-bound, bound, dtype=np.float64),
        }
        human_acts = gym.spaces.Box(-1.0, 1.0, (len(self.human_joints),), np.float32)
        self.action_spaces = {ROBOT_AGENT: acted, HUMAN_AGENT: human_acts}
        self._random: np.random.Generator | None = None
        self._steps_left = 0

    def observation_space(self, agent: str) -> gym.Space[FloatArray]:
        """Returns the observation space of ``agent``: ``robot`` or ``human``."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> gym.Space[Action]:
        """Returns the action space of ``agent``: ``robot`` or ``human``."""
        return self.action_spaces[agent]

    def reset(
        self, seed: int | np.integer | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, FloatArray], dict[str, dict[str, Any]]]:
        """Start an episode. Returns observations and infos by agent.

        A seed results in the same episode as with ``gym.make``. Without a seed, the random stream continues.
        """
        if seed is not None or self._random is None:
            self._random, _ = seeding.np_random(to_python_seed(seed))
        self.agents, self._steps_left = self.possible_agents[:], self.max_episode_steps
        self.episodes.reset(np.array([0]), [self._random])
        self.close()
        start = self.episodes.evaluate_state()
        return self._observations(start), {agent: make_info(start) for agent in self.agents}

    def step(
        self, actions: dict[str, Action]
    ) -> tuple[
        dict[str, FloatArray],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Perform one control step. Returns observations, rewards, terminations, truncations and infos by agent.

        For both agents, the episode is truncated after ``max_episode_steps``. An error does not change the state.

        Raises:
            ValueError: for a missing action, a wrong shape, or numbers that are not finite.
            gymnasium.error.ResetNeeded: before the first reset, and after the end of an episode.
        """
        if not self.agents:
            raise ResetNeeded(
                f"no episode is running; call reset() to start an episode of {self.max_episode_steps} steps"
            )
        robot, human = self._checked(actions)
        self.episodes.command_people(human[None])
        step = self.episodes.step(robot[None])
        self._steps_left -= 1
        ended, agents = self._steps_left == 0, self.agents
        rewards = (
            step.reward,
            self.episodes.compute_human_reward(step, human[None], shared=self._shared_reward),
        )
        if ended:
            self.agents = []
        return (
            self._observations(step),
            {agent: float(reward[0]) for agent, reward in zip(agents, rewards, strict=True)},
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, ended),
            {agent: make_info(step) for agent in agents},
        )

    def _observations(self, step: StepOutcome) -> dict[str, FloatArray]:
        return {ROBOT_AGENT: step.observation[0], HUMAN_AGENT: self.episodes.observe_humans()[0]}

    def _checked(self, actions: Mapping[str, Action]) -> list[FloatArray]:
        """Returns the actions of robot and human as arrays of floats. Raises ``ValueError`` for invalid actions."""
        if set(actions) != set(self.possible_agents):
            found = ", ".join(actions) or "no agent"
            raise ValueError(
                f"received actions for {found}; allowed: one action for each agent: {', '.join(self.possible_agents)}"
            )
        return [self._checked_of(agent, actions[agent]) for agent in self.possible_agents]

    def _checked_of(self, agent: str, action: Action) -> FloatArray:
        shape = self.action_spaces[agent].shape
        assert shape is not None
        try:
            return validate_actions(action, shape)
        except ValueError as error:
            raise ValueError(f"{agent}: {error}") from None
