"""Laws of control steps that are taken in ticks."""

import numpy as np
from numpy.testing import assert_array_equal

from avrgym.array_types import FloatArray
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.tasks.episodes import Episodes

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"


class RepeatedAction:
    """A robot that rests; ``amended`` repeats its action at every tick."""

    def __init__(self, action: FloatArray, *, amended: bool) -> None:
        self._action, self._amended = action, amended

    def act(self, observation: FloatArray) -> FloatArray:
        return self._action

    def update_action(self) -> FloatArray | None:
        return self._action if self._amended else None


def persons_joints(*, amended: bool) -> FloatArray:
    """Where the person's right arm is after three control steps of a robot that rests."""
    episodes = Episodes(ENVIRONMENT, 1, people="zoo/train", impairment="tremor", num_threads=1)
    episodes.reset(np.array([0]), [np.random.default_rng(3)])
    source = RepeatedAction(np.zeros((1, episodes.action_size)), amended=amended)
    for _ in range(3 * DEFAULT_SUBSTEPS):
        episodes.control_loop.tick(source)
    return episodes.get_state().right_arm_pos_w


def test_amended_actions_do_not_change_how_people_move() -> None:
    assert_array_equal(persons_joints(amended=True), persons_joints(amended=False))
