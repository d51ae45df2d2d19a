"""Stops arms at random moments of their motion."""

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models import human, robot
from avrgym.models.scene import DEFAULT_SUBSTEPS, PHYSICS_STEP_S
from avrgym.people import shoulder_limits
from avrgym.policies.trained_policies import load_policy
from avrgym.tasks.episodes import Episodes

SLOW_M_S, SLOW_AFTER_S = 0.05, 0.1
MAX_REBOUND_M = 0.005
OBSERVED_S = 1.0
MAX_STEPS = 40
WASHCLOTH = robot.ROBOT_NAME_PREFIX + "washcloth"
MOTIONS = ("jerky", "full speed", "towards the person", "trained")


@dataclass(frozen=True)
class Stops:
    """Measurements of stopped arms, one entry for each world.

    ``force_n`` and ``speed_m_s`` are the contact force and the end effector's speed at the stop. The others are maxima
    over all robot bodies: ``residual_speed_m_s`` from 100 ms after the stop, ``rebound_m`` backwards, and ``drift_m``
    after these 100 ms.
    """

    force_n: FloatArray
    speed_m_s: FloatArray
    residual_speed_m_s: FloatArray
    rebound_m: FloatArray
    drift_m: FloatArray

    def __str__(self) -> str:
        touching = np.sum(self.force_n > 1.0)
        slow, back, drift = (
            1e3 * each.max() for each in (self.residual_speed_m_s, self.rebound_m, self.drift_m)
        )
        return (
            f"{len(self.force_n)} stops at up to {1e3 * self.speed_m_s.max():.0f} mm/s, {touching} of them in contact "
            f"with up to {self.force_n.max():.0f} N: after 100 ms up to {slow:.1f} mm/s, rebound up to {back:.2f} mm, "
            f"drift within a second {drift:.2f} mm"
        )


def stop_at_random(environment: str, worlds: int, seed: int) -> Stops:
    """Stop the arms of an environment, each moved by one of ``MOTIONS``; a third of the people wave their arms."""
    rng = np.random.default_rng(seed)
    episodes = Episodes(environment, worlds, people="revised", moving=True)
    episodes.reset(np.arange(worlds), [np.random.default_rng([seed, world]) for world in range(worlds)])
    simulation, rest_rad = episodes.simulation, episodes.people.joint_angles_rad
    simulation.command_person(rest_rad)
    act = _mixed_actor(episodes, rng)
    for _ in range(rng.integers(3, MAX_STEPS)):
        simulation.command_person(_waving(rest_rad, rng))
        episodes.command_robots(act())
        simulation.step(DEFAULT_SUBSTEPS)
    simulation.command_robot(act())
    simulation.step(int(rng.integers(1, DEFAULT_SUBSTEPS)))
    before = simulation.get_state()
    simulation.brake_robot()
    pos_w = np.stack(
        [_robot_pos_w(episodes), *(_step(episodes) for _ in range(round(OBSERVED_S / PHYSICS_STEP_S)))]
    )
    return _measure(before.robot_force_n, np.linalg.norm(before.end_effector_velocity_w, axis=-1), pos_w)


def _step(episodes: Episodes) -> FloatArray:
    episodes.simulation.step(1)
    return _robot_pos_w(episodes)


def _measure(force_n: FloatArray, speed_m_s: FloatArray, pos_w: FloatArray) -> Stops:
    """Measure stops from body positions (T, N, B, 3) after each physics step; the first is at the stop."""
    slow = round(SLOW_AFTER_S / PHYSICS_STEP_S)
    speeds = np.linalg.norm(np.diff(pos_w, axis=0), axis=-1) / PHYSICS_STEP_S
    away = np.linalg.norm(pos_w - pos_w[0], axis=-1)
    back = np.maximum.accumulate(away) - away
    drift = np.linalg.norm(pos_w[slow:] - pos_w[slow], axis=-1)
    return Stops(force_n, speed_m_s, speeds[slow:].max((0, 2)), back.max((0, 2)), drift.max((0, 2)))


def _robot_pos_w(episodes: Episodes) -> FloatArray:
    """Return the positions (N, B, 3) of the robots' bodies, without the compliant washcloth."""
    simulation = episodes.simulation
    names = enumerate(simulation.bodies)
    links = [i for i, name in names if name.startswith(robot.ROBOT_NAME_PREFIX) and name != WASHCLOTH]
    return np.stack([simulation.get_body_poses(world)[links, :3] for world in range(simulation.num_worlds)])


def _waving(rest_rad: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return joint targets of people (N, 20): every third person moves each joint by up to 5 degrees."""
    waving = (np.arange(len(rest_rad)) % 3 == 0)[:, None]
    return shoulder_limits.clip_shoulders(
        rest_rad + waving * np.radians(rng.uniform(-5.0, 5.0, rest_rad.shape))
    )


def _mixed_actor(episodes: Episodes, rng: np.random.Generator) -> Callable[[], FloatArray]:
    """Return a function that returns the next actions (N, A); worlds alternate between ``MOTIONS``."""
    worlds = episodes.simulation.num_worlds
    way = np.arange(worlds) % len(MOTIONS)
    full = np.sign(rng.uniform(-1.0, 1.0, (worlds, episodes.action_size)))
    policy = load_policy(
        "revised", episodes.environment_id, episodes.observation_spec.size, episodes.action_size
    )

    def act() -> FloatArray:
        actions = np.stack(
            [
                rng.uniform(-1.0, 1.0, full.shape),
                full,
                np.stack([_towards_person(episodes, world) for world in range(worlds)]),
                policy.act(episodes.observe(), [rng] * worlds),
            ]
        )
        return actions[way, np.arange(worlds)]

    return act


def _towards_person(episodes: Episodes, world: int) -> FloatArray:
    """Return the action (A,) that moves the end effector fastest towards a person's torso or head. A drive stands."""
    simulation, arm = episodes.simulation, episodes.scene.arm
    model, data = simulation.batch.get_model(world), simulation.batch.get_data(world)
    effector = model.body(robot.ROBOT_NAME_PREFIX + arm.end_effector).id
    goal_w = data.body(human.PERSON_NAME_PREFIX + ("torso" if world % 8 < 4 else "head")).xpos
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacBody(model, data, jacobian, None, effector)
    dofs = [model.joint(robot.ROBOT_NAME_PREFIX + joint).dofadr[0] for joint in arm.joints]
    gradient = jacobian[:, dofs].T @ (goal_w - data.xpos[effector])
    return np.append(gradient / np.abs(gradient).max(), np.zeros(episodes.action_size - len(dofs)))
