"""Pictures of environments in the middle of an episode, the robot led by its oracle.

MUJOCO_GL=egl python examples/pictures.py docs/pictures [ENVIRONMENT_ID…]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.image import imsave
from numpy.typing import NDArray

from avrgym.episodes import Episodes
from avrgym.oracles import ORACLES
from avrgym.rendering import Camera
from avrgym.tasks import ENVIRONMENTS

MOMENTS = {"Feeding": (3, 75), "Drinking": (3, 110), "ScratchItch": (6, 30), "BedBathing": (3, 90)}
"""By task, the seed of an episode and the control step at which it shows."""


def picture(environment_id: str) -> NDArray[np.uint8]:
    """One world of an environment at its moment."""
    episodes = Episodes(environment_id, 1, distribution="revised", num_threads=1)
    seed, steps = MOMENTS[episodes.task.name]
    episodes.begin(np.array([0]), [np.random.default_rng(seed)])
    act = ORACLES[episodes.task.name](episodes)
    for _ in range(steps):
        episodes.step(act(episodes.observe()))
    camera = Camera(episodes, 0)
    try:
        return camera.picture()
    finally:
        camera.close()


def main() -> None:
    """Write ``<task>_<robot>.png`` for the environments named on the command line, or for all."""
    folder, wanted = Path(sys.argv[1]), sys.argv[2:] or list(ENVIRONMENTS)
    folder.mkdir(parents=True, exist_ok=True)
    for environment_id in wanted:
        task, robot = ENVIRONMENTS[environment_id]
        name = "".join(f"_{c.lower()}" if c.isupper() else c for c in task).lstrip("_")
        file = folder / f"{name}_{robot.lower()}.png"
        imsave(file, picture(environment_id))
        print(file)


if __name__ == "__main__":
    main()
