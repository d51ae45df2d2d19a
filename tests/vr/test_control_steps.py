"""Laws of control steps that are taken in ticks."""

import numpy as np
from numpy.testing import assert_array_equal

from avrgym.models.scene import SUBSTEPS
from avrgym.tasks.episodes import Episodes
from avrgym.vr.live_world.world import ControlSteps

ENVIRONMENT = "avrgym/ScratchItchJaco-v1"


def persons_joints(*, amended: bool):
    """Where the person's joints are after three control steps of a robot that rests, told so once or in every tick."""
    episodes = Episodes(ENVIRONMENT, 1, distribution="zoo/train", impairment="tremor", num_threads=1)
    episodes.begin(np.array([0]), [np.random.default_rng(3)])
    rest, steps = np.zeros((1, episodes.action_size)), ControlSteps(episodes)
    for _ in range(3 * SUBSTEPS):
        steps.tick(lambda observation: rest, (lambda: rest) if amended else lambda: None)
    return episodes.state().right_arm_pos_w


def test_people_live_one_control_step_however_often_the_robot_is_told_otherwise():
    assert_array_equal(persons_joints(amended=True), persons_joints(amended=False))
