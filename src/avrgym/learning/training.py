"""Training: imitation of an expert, then PPO, over worlds here, on a cluster or on a GPU.

Stable-Baselines3 learns, with RSL-RL where the worlds are on a device; see ``updates`` and ``on_device``. Needs the
extra ``train``, on a device ``gpu`` too. What it leaves is a policy file that needs no PyTorch.
"""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from avrgym.learning.configuration import (
    CONFIGURATION_FILE,
    LOG_FOLDER,
    TrainingConfiguration,
    configuration_for,
    lengthened,
    store,
    store_people,
    stored_configuration,
    stored_people,
)
from avrgym.learning.course import CHECKPOINT_FILE, POLICY_FILE, Course, Progress, Tell
from avrgym.learning.exporting import export_policy
from avrgym.learning.measuring import measure
from avrgym.learning.on_device import DeviceImprovement, libraries
from avrgym.learning.ppo import steps_of
from avrgym.learning.rollouts import Order, Rollout, roll_out_all, worlds_of
from avrgym.learning.updates import UpdateLearner, make_here
from avrgym.people.impairments import find_impairment
from avrgym.people.populations import HUMAN_FILE, is_trained
from avrgym.policies.trained import Policy
from avrgym.simulation.engines.engine import check_ready
from avrgym.system.engines import THREADS
from avrgym.system.locks import locked
from avrgym.system.memory import memory_bytes
from avrgym.tasks.company import find_company
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.human_view import human_view_of
from avrgym.tasks.registry import find_environment, sizes

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

__all__ = [
    "LOG_FOLDER",
    "POLICY_FILE",
    "Progress",
    "TrainingConfiguration",
    "configuration_for",
    "export_policy",
    "resume",
    "stored_configuration",
    "train",
]

SHOWN_FOLDER = "shown"
"""What the expert showed, while the policy imitates it."""
MEASURED_EPISODES = 100
LEAST_WORLDS, MOST_WORLDS = 64, 128
"""How many worlds a worker of a cluster has, where the training has enough of them."""
WORLD_BYTES = 4 << 20
"""More than what a world and its part of a rollout take: 2.7 MB where the PR2 brings 64 spheres of water."""


def train(
    configuration: TrainingConfiguration,
    out: Path,
    tell: Tell = lambda progress: None,
    *,
    cluster: "Cluster | None" = None,
) -> Policy:
    """Train, and leave ``policy.safetensors``, ``configuration.json`` and TensorBoard's log in ``out``.

    Where robot and human are trained together, ``human.safetensors`` is the human. The policy carries what it reaches
    on people that training never saw, or with that human. A training that is cut off leaves its latest policy and
    checkpoint, from which ``resume`` goes on.

    Args:
        configuration: what to train, on whom, for how long.
        out: a folder that holds no training yet.
        tell: told of the progress after every update.
        cluster: whose workers make the episodes; without it this process does. It changes no weight.

    Raises:
        ValueError: for an unknown environment or people, or where another training is about to begin in ``out``.
        FileExistsError: when ``out`` already holds a training.
        RuntimeError: where the worlds have no room on the cluster, or it is gone.
    """
    _refuse_used(out)
    _check(configuration, configuration.people, cluster)
    if Path(configuration.people).is_dir() and is_trained(configuration.people):
        configuration = replace(configuration, people=f"{configuration.people.rstrip('/')}/")
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        _refuse_used(out)
        store_people(configuration.people, out)
        course = Course(configuration, out, tell)
        learner = _learner(configuration, out, course, cluster)
        store(configuration, out)
        return _go_on(configuration, out, course, learner)


def _refuse_used(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise FileExistsError(f"{out} is a file; choose a folder with --out")
    if (out / CONFIGURATION_FILE).exists():
        raise FileExistsError(
            f"{out} already holds a training; choose another folder, or go on with --resume"
        )


def resume(
    out: Path,
    tell: Tell = lambda progress: None,
    steps: int | None = None,
    *,
    cluster: "Cluster | None" = None,
) -> Policy:
    """Go on with the training in ``out`` from its latest checkpoint, to the same weights as if never cut off.

    One that was cut off before its first checkpoint begins again, with the same seed.

    Args:
        out: the folder of the training.
        tell: told of the progress after every update.
        steps: how many it shall have made in the end, more than so far; without it as many as it was begun with.
            Imitation gets no longer; PPO goes on, its learning rate and chance where a training of so many steps has
            them.
        cluster: whose workers make the episodes, as for ``train``.

    Raises:
        ValueError: when there is none, when it is complete, when it goes on in another process, or when its files are
            damaged.
    """
    configuration = stored_configuration(out)
    _check(configuration, stored_people(configuration, out), cluster)
    with locked(out):
        if steps is not None and steps != configuration.steps:
            configuration = _extended(configuration, steps, out)
        course = Course(configuration, out, tell)
        return _go_on(configuration, out, course, _learner(configuration, out, course, cluster))


def _extended(configuration: TrainingConfiguration, steps: int, out: Path) -> TrainingConfiguration:
    """The configuration for so many steps in all, stored."""
    done = Policy.load(out / POLICY_FILE).metadata.steps if (out / POLICY_FILE).exists() else 0
    if steps <= done:
        raise ValueError(f"the training in {out} has made {done} steps; to go on, --steps must be more")
    longer = lengthened(configuration, steps)
    store(longer, out)
    return longer


def _check(configuration: TrainingConfiguration, people: str, cluster: "Cluster | None") -> None:
    """Refuse what cannot run, before anything is written."""
    find_environment(configuration.environment)
    find_company(people, configuration.environment)
    find_impairment(configuration.impairment)
    check_ready(configuration.engine)
    if configuration.pairing is not None:
        _check_pairing(configuration.environment, people)
    _check_memory(configuration, cluster)
    if configuration.engine != THREADS:
        libraries()
        if configuration.pairing is not None or is_trained(people):
            raise ValueError(
                f"trained humans act on threads; allowed: them, or --engine {configuration.engine}"
            )
        if cluster is not None:
            raise ValueError(
                f"a cluster's workers step worlds on threads; allowed: --cluster, or --engine {configuration.engine}"
            )
    if cluster is None:
        return
    cluster.need(-(-configuration.worlds // _parts(configuration, cluster)) * WORLD_BYTES)


def _check_pairing(environment: str, people: str) -> None:
    """Refuse to train a human where there is nothing to learn, or who is one already."""
    _, joints = human_view_of(environment)
    if not joints:
        raise ValueError(
            f"{environment} wants nothing of people: there is no human to train beside the robot"
        )
    if is_trained(people):
        raise ValueError(
            f"{people}: trained already, and a pair trains a human of its own; allowed: people by name or a file "
            "of people, whose bodies that human has"
        )


def _check_memory(configuration: TrainingConfiguration, cluster: "Cluster | None") -> None:
    """Refuse more worlds than this computer could hold, or their episodes where a cluster has the worlds."""
    observation, action = sizes(configuration.environment)
    each = EPISODE_STEPS * (3 * observation + 2 * action + 8) * np.dtype(np.float32).itemsize
    needed = configuration.worlds * (each if cluster else WORLD_BYTES)
    there = memory_bytes()
    if there is not None and needed > there:
        raise ValueError(
            f"{configuration.worlds} worlds would take {needed / 2**30:.1f} GiB of this computer's memory, which has "
            f"{there / 2**30:.1f}: at most {there * configuration.worlds // needed} have room"
        )


def _parts(configuration: TrainingConfiguration, cluster: "Cluster") -> int:
    """Among how many calls the worlds of an update are shared: as many as there are workers, or a multiple."""
    worlds, workers = configuration.worlds, min(cluster.count, configuration.worlds)
    if cluster.asked_for is None:
        workers = max(1, min(workers, worlds // LEAST_WORLDS))
    return workers * -(-worlds // (workers * MOST_WORLDS))


def _learner(
    configuration: TrainingConfiguration, out: Path, course: Course, cluster: "Cluster | None"
) -> UpdateLearner:
    people = stored_people(configuration, out)
    how = configuration, people, out, course
    if configuration.engine != THREADS:
        learner = UpdateLearner(
            *how, 1, make_here, configuration.threads, improve=DeviceImprovement(configuration)
        )
        worlds_of(learner.place, configuration.worlds)  # before anything is written, should they have no room
        return learner
    if cluster is None:
        return UpdateLearner(*how, 1, make_here, configuration.threads)

    def make_all(policies: Sequence[Policy], orders: Sequence[Order]) -> list[list[Rollout]]:
        return cluster.run_all(roll_out_all, [(policies, order) for order in orders])

    return UpdateLearner(*how, _parts(configuration, cluster), make_all, 1)


def _go_on(configuration: TrainingConfiguration, out: Path, course: Course, learner: UpdateLearner) -> Policy:
    if (out / CHECKPOINT_FILE).exists():
        learner.restore()
        done = steps_of(learner.model)
        if done >= configuration.steps and Policy.load(out / POLICY_FILE).metadata.measured:
            raise ValueError(f"the training in {out} is complete, after {done} steps; more --steps go on")
    if steps_of(learner.model) < configuration.imitation_steps:
        learner.imitate(configuration.imitation_steps // configuration.update_steps, out / SHOWN_FOLDER)
    shutil.rmtree(out / SHOWN_FOLDER, ignore_errors=True)
    remaining = configuration.steps - steps_of(learner.model)
    if remaining > 0:
        learner.learn(remaining)
    course.tell(f"measuring, {MEASURED_EPISODES} episodes", steps_of(learner.model))
    return _measure(configuration, out)


def _measure(configuration: TrainingConfiguration, out: Path) -> Policy:
    """Write into the policy's file what it reaches, and where a human was trained with it, with that one, into both."""
    if configuration.pairing is not None:
        human = out / HUMAN_FILE
        return measure(out / POLICY_FILE, str(human), "none", MEASURED_EPISODES, human=human)
    people = stored_people(configuration, out)
    return measure(out / POLICY_FILE, people, configuration.impairment, MEASURED_EPISODES)
