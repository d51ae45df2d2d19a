"""Write ``client/tests/data/scenes.json``: what stands around the person in every environment.

Of each environment, once when the trial begins and once when the robot has helped and taken its tool away: where the
eyes are, and all geoms that can be touched, as type, size, position and quaternion (w, x, y, z) in the world frame.
"""

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from avrgym.models import human
from avrgym.models.collision_bits import COLLISION_GROUP
from avrgym.policies.trained_policies import find_packaged_policies, load_policy
from avrgym.safety.retreat import Retreat
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.constants import PACKAGED_ENVIRONMENTS
from avrgym.tasks.episodes import Episodes

SCENES = Path(__file__).parents[1] / "client" / "tests" / "data" / "scenes.json"
KINDS = ("sphere", "capsule", "cylinder", "box")
HELPED_STEPS = 120
SEED = 7


def main() -> None:
    """Write the file, of the environments with a revised policy."""
    chosen = [
        environment
        for environment in PACKAGED_ENVIRONMENTS
        if "revised" in find_packaged_policies(environment)
    ]
    scenes = [scene for environment in chosen for scene in scenes_of(environment)]
    SCENES.write_text(json.dumps(scenes, separators=(",", ":")) + "\n")


def scenes_of(environment: str) -> list[dict[str, Any]]:
    """The two of an environment."""
    episodes = Episodes(environment, 1, moving=True, num_threads=1)
    policy = load_policy("revised", environment, episodes.observation_spec.size, episodes.action_size)
    generators = [np.random.default_rng(SEED)]
    episodes.reset(np.array([0]), generators)
    simulation = episodes.simulation
    simulation.command_person(episodes.people.joint_angles_rad)
    before = scene_of(f"{environment} before", simulation)
    for _ in range(HELPED_STEPS):
        episodes.step(policy.act(episodes.observe(), generators))
    simulation.brake_robot()
    retreat = Retreat(simulation)
    while (action := retreat.compute_next_action()) is not None:
        simulation.command_robot(action[None])
        simulation.step()
    return [before, scene_of(f"{environment} after", simulation)]


def scene_of(name: str, simulation: Simulation) -> dict[str, Any]:
    """What stands around now."""
    model, data = simulation.batch.get_model(0), simulation.batch.get_data(0)
    mujoco.mj_kinematics(model, data)
    head = data.site(human.PERSON_NAME_PREFIX + "head_centre").xpos
    ahead = data.body(human.PERSON_NAME_PREFIX + "head").xmat.reshape(3, 3)[:, 1]
    return {"name": name, "eyes": rounded(head - human.HEADSET_OFFSET_M * ahead), "geoms": geoms(model, data)}


def geoms(model: mujoco.MjModel, data: mujoco.MjData) -> list[list[Any]]:
    """Everything but crumbs, drops, the floor, and the person's head, neck and arms."""
    found: list[list[Any]] = []
    for geom in np.flatnonzero(model.geom_group == COLLISION_GROUP).tolist():
        kind = mujoco.mjtGeom(model.geom_type[geom]).name.removeprefix("mjGEOM_").lower()
        body = model.body(model.geom_bodyid[geom]).name
        moved = any(part in body for part in ("head", "neck", "arm", "hand")) and body.startswith(
            human.PERSON_NAME_PREFIX
        )
        if kind not in KINDS or moved or body.startswith(("food", "water")):
            continue
        q_w = np.empty(4)
        mujoco.mju_mat2Quat(q_w, data.geom_xmat[geom])
        found.append([kind, rounded(model.geom_size[geom]), rounded(data.geom_xpos[geom]), rounded(q_w)])
    return found


def rounded(values: Any) -> list[float]:
    """To the millimetre, in plain numbers."""
    return [round(float(value), 3) for value in values]


if __name__ == "__main__":
    main()
