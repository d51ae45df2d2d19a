"""Arms that are stopped at random moments, whatever they were doing."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models import human, robot
from avrgym.models.scene import PHYSICS_STEP_S, SUBSTEPS
from avrgym.people import shoulder_limits
from avrgym.policies.trained import load_policy
from avrgym.tasks.episodes import Episodes

SLOW_M_S, SLOW_AFTER_S = 0.05, 0.1
MOST_BACK_M = 0.005
LOOKED_ON_S = 1.0
MOST_STEPS = 40
WASHCLOTH = robot.PREFIX + "washcloth"
WAYS = ("jerky", "full speed", "towards the person", "trained")


@dataclass(frozen=True)
class Stops:
    """How arms stopped, one entry for each world.

    ``pressed_n`` is the force on the person at the stop, ``speed_m_s`` the end effector's then. Of all bodies of
    the robot: ``slow_m_s``, how fast one is at most 100 ms later and from then on; ``back_m``, how far one comes
    back from where it had got to; ``drift_m``, how far one moves away from where it was after these 100 ms.
    """

    pressed_n: FloatArray
    speed_m_s: FloatArray
    slow_m_s: FloatArray
    back_m: FloatArray
    drift_m: FloatArray

    def __str__(self) -> str:
        pressing = np.sum(self.pressed_n > 1.0)
        slow, back, drift = (1e3 * each.max() for each in (self.slow_m_s, self.back_m, self.drift_m))
        return (
            f"{len(self.slow_m_s)} stops at up to {1e3 * self.speed_m_s.max():.0f} mm/s, {pressing} of them pressing "
            f"with up to {self.pressed_n.max():.0f} N: after 100 ms up to {slow:.1f} mm/s, up to {back:.2f} mm back, "
            f"{drift:.2f} mm more within a second"
        )


def stop_at_random(environment: str, worlds: int, seed: int) -> Stops:
    """Stop as many arms of an environment, each moved in one of ``WAYS``, a third of the people waving their arms."""
    rng = np.random.default_rng(seed)
    episodes = Episodes(environment, worlds, people="revised", moving=True)
    episodes.reset(np.arange(worlds), [np.random.default_rng([seed, world]) for world in range(worlds)])
    simulation, rest_rad = episodes.simulation, episodes.people.joint_angles_rad
    simulation.command_person(rest_rad)
    act = _mixed_actor(episodes, rng)
    for _ in range(rng.integers(3, MOST_STEPS)):
        simulation.command_person(_waving(rest_rad, rng))
        episodes.command(act())
        simulation.step(SUBSTEPS)
    simulation.command_robot(act())
    simulation.step(int(rng.integers(1, SUBSTEPS)))
    before = simulation.state()
    simulation.brake_robot()
    pos_w = np.stack(
        [_robot_pos_w(episodes), *(_step(episodes) for _ in range(round(LOOKED_ON_S / PHYSICS_STEP_S)))]
    )
    return _judge(before.robot_force_n, np.linalg.norm(before.effector_velocity_w, axis=-1), pos_w)


def _step(episodes: Episodes) -> FloatArray:
    episodes.simulation.step(1)
    return _robot_pos_w(episodes)


def _judge(pressed_n: FloatArray, speed_m_s: FloatArray, pos_w: FloatArray) -> Stops:
    """From the places (T, N, B, 3) of the robots' bodies after each physics step, the first at the stop."""
    slow = round(SLOW_AFTER_S / PHYSICS_STEP_S)
    speeds = np.linalg.norm(np.diff(pos_w, axis=0), axis=-1) / PHYSICS_STEP_S
    away = np.linalg.norm(pos_w - pos_w[0], axis=-1)
    back = np.maximum.accumulate(away) - away
    drift = np.linalg.norm(pos_w[slow:] - pos_w[slow], axis=-1)
    return Stops(pressed_n, speed_m_s, speeds[slow:].max((0, 2)), back.max((0, 2)), drift.max((0, 2)))


def _robot_pos_w(episodes: Episodes) -> FloatArray:
    """Where the robots' bodies are, (N, B, 3), but for the washcloth, which yields by itself."""
    simulation = episodes.simulation
    names = enumerate(simulation.bodies)
    links = [i for i, name in names if name.startswith(robot.PREFIX) and name != WASHCLOTH]
    return np.stack([simulation.body_poses(world)[links, :3] for world in range(simulation.num_worlds)])


def _waving(rest_rad: FloatArray, rng: np.random.Generator) -> FloatArray:
    """The targets of people (N, 20): every third turns each joint by up to 5 degrees, to and fro."""
    waving = (np.arange(len(rest_rad)) % 3 == 0)[:, None]
    return shoulder_limits.clip(rest_rad + waving * np.radians(rng.uniform(-5.0, 5.0, rest_rad.shape)))


def _mixed_actor(episodes: Episodes, rng: np.random.Generator) -> Callable[[], FloatArray]:
    """What gives every arm its next action (N, 7), one of ``WAYS`` after another."""
    worlds = episodes.simulation.num_worlds
    way = np.arange(worlds) % len(WAYS)
    full = np.sign(rng.uniform(-1.0, 1.0, (worlds, 7)))
    policy = load_policy("revised", episodes.environment_id, episodes.observation.size, 7)

    def act() -> FloatArray:
        actions = np.stack(
            [
                rng.uniform(-1.0, 1.0, (worlds, 7)),
                full,
                np.stack([_towards_person(episodes, world) for world in range(worlds)]),
                policy.act(episodes.observe(), [rng] * worlds),
            ]
        )
        return actions[way, np.arange(worlds)]

    return act


def _towards_person(episodes: Episodes, world: int) -> FloatArray:
    """The action (7,) that moves the end effector fastest towards a person's torso or head."""
    simulation, arm = episodes.simulation, episodes.scene.arm
    model, data = simulation.batch.get_model(world), simulation.batch.get_data(world)
    effector = model.body(robot.PREFIX + arm.end_effector).id
    goal_w = data.body(human.PREFIX + ("torso" if world % 8 < 4 else "head")).xpos
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, jacobian, None, effector)
    dofs = [model.joint(robot.PREFIX + joint).dofadr[0] for joint in arm.joints]
    gradient = jacobian[:, dofs].T @ (goal_w - data.xpos[effector])
    return gradient / np.abs(gradient).max()
