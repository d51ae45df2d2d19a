"""Recipe of policies with vision (``--recipe visual``): imitation of a trained policy without vision, the teacher.

The teacher receives the whole observation. The policy with vision receives only the arm's joint angles, and the tool's
pose, which follows from these angles. It estimates all other entries of the observation from a camera image. The
teacher's layers then compute the actions from the estimates ("learning by cheating", Chen et al., CoRL 2019). Training
is dataset aggregation: from the second round on, the policy controls an increasing share of the worlds. The loss is the
sum of the errors of estimates and actions.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from torch.nn.functional import mse_loss, smooth_l1_loss
from torch.optim.lr_scheduler import ExponentialLR

from avrgym.array_types import Float32Array, FloatArray, NumpyArray
from avrgym.learning.configuration import VisualConfiguration, find_stored_people
from avrgym.learning.hyperparameters import VISUAL_HYPERPARAMETERS
from avrgym.learning.imitation import Demonstration, DemonstrationDataset
from avrgym.learning.recipe import UpdateResults
from avrgym.learning.visual_network import TrainableVisionNetwork
from avrgym.models.cameras import CameraSpec, parse_cameras
from avrgym.networks.vision import make_vision_input
from avrgym.policies import registry
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.system import random_streams
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import find_task_and_scene

TEACHER_FILE = "teacher.safetensors"
"""Name of the teacher's copy in the folder of a training run."""
MEASURED_ENTRY_NAMES = ("tool_from_torso_m", "tool_rotation", "arm_angles_rad")
"""Names of the observation's entries that are computed from the joint angles of the arm."""


@dataclass(frozen=True)
class VisualDemonstration(Demonstration):
    """Observations (S, O), the teacher's mean actions (S, A) and images (S, H, W, C) in half precision."""

    images: NumpyArray


def load_teacher(configuration: VisualConfiguration) -> Policy:
    """Load and return the teacher of a training run.

    Raises:
        ValueError: for a policy that cannot be a teacher, or if the robot does not have the camera.
    """
    parse_training_camera(configuration)
    teacher = registry.resolve_policy(
        configuration.teacher, configuration.environment, configuration.settings
    )
    if not isinstance(teacher, Policy) or teacher.memory is not None or teacher.vision is not None:
        raise ValueError(
            f"{configuration.teacher!r} cannot be the teacher of a visual policy; allowed: a feed-forward "
            f"policy without cameras, "
            "by its name or file"
        )
    return teacher


def parse_training_camera(configuration: VisualConfiguration) -> CameraSpec:
    """Returns the camera of a training run.

    Raises:
        ValueError: if the robot does not have the camera, or if the images are segmentations.
    """
    _, scene = find_task_and_scene(configuration.environment, configuration.settings)
    (camera,) = parse_cameras([configuration.camera], scene.robot)
    if "segmentation" in camera.kinds:
        raise ValueError(
            f"the camera of the policy is {configuration.camera!r}; allowed kinds of images: rgb, depth"
        )
    return camera


class VisualRecipe:
    """Recipe of policies with vision (``--recipe visual``), an implementation of ``recipe.Recipe``."""

    def __init__(self, configuration: VisualConfiguration, out: Path) -> None:
        self._people = find_stored_people(configuration.people, out)
        self._configuration = configuration
        self._teacher = Policy.load(out / TEACHER_FILE)
        self._cameras = (parse_training_camera(configuration),)
        task, scene = find_task_and_scene(configuration.environment, configuration.settings)
        entries = task.make_observation_spec(scene)
        names = np.repeat([each.name for each in entries.entries], [each.size for each in entries.entries])
        self._estimated = [i for i, name in enumerate(names.tolist()) if name not in MEASURED_ENTRY_NAMES]
        (camera,) = self._cameras
        channels = sum(3 if kind == "rgb" else 1 for kind in camera.kinds)
        torch.set_num_threads(1)  # more threads would change the order of sums
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(configuration.seed)
            self._network = TrainableVisionNetwork(
                self._teacher, self._estimated, (camera.height_px, camera.width_px, channels)
            )
        self._demonstrations = DemonstrationDataset(out, VisualDemonstration)
        self._worlds: Episodes | None = None
        self._rounds = 0

    @property
    def num_timesteps(self) -> int:
        return self._rounds * self._configuration.steps_per_update

    @property
    def candidate_action_stds(self) -> tuple[float, ...]:
        return (self._teacher.action_std,)

    def update(self) -> UpdateResults:
        number, configuration = self._rounds, self._configuration
        random = random_streams.make_imitation_rng(configuration.seed, number)
        teacher_drives = (
            random.random(configuration.num_envs) < VISUAL_HYPERPARAMETERS.expert_fraction**number
        )
        returns, success = self._roll_out(number, random, teacher_drives)
        self._fit(random, last=number == configuration.total_updates - 1)
        self._rounds += 1
        own = ~teacher_drives
        if not own.any():
            return UpdateResults("imitation", None, None)
        return UpdateResults("imitation", float(returns[own].mean()), float(success[own].mean()))

    def export_policies(self, metadata: PolicyMetadata) -> list[Policy]:
        metadata = msgspec.structs.replace(metadata, camera=self._configuration.camera)
        return [replace(self._teacher, metadata=metadata, vision=self._network.to_numpy_network())]

    def checkpoint_state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        return {"network": self._network.state_dict()}, {"rounds": self._rounds}

    def restore(self, tensors: dict[str, Any], values: dict[str, Any]) -> None:
        self._network.load_state_dict(tensors["network"])
        self._rounds = values["rounds"]
        if self._rounds < self._configuration.total_updates:
            self._demonstrations.read_rounds(self._rounds)

    def _roll_out(
        self, number: int, random: np.random.Generator, teacher_drives: NumpyArray
    ) -> tuple[FloatArray, NumpyArray]:
        """Run the first steps of an episode in each world, and store the demonstrations. Returns the sum of rewards and
        the success of each world, (N,)."""
        worlds, count = self._episodes(), self._configuration.num_envs
        seeds = random_streams.make_episode_seed_rng(self._configuration.seed, number).integers(
            2**31, size=count
        )
        observation = worlds.reset(
            np.arange(count), [random_streams.make_training_episode_rng(int(seed)) for seed in seeds]
        )
        observations: list[FloatArray] = []
        actions: list[FloatArray] = []
        images: list[NumpyArray] = []
        returns, success = np.zeros(count), np.zeros(count, dtype=bool)
        for _ in range(VISUAL_HYPERPARAMETERS.episode_steps):
            image = self._image(worlds)
            taught = self._teacher.compute_mean_actions(observation)
            observations.append(observation)
            actions.append(taught)
            images.append(image)
            noise = VISUAL_HYPERPARAMETERS.teacher_noise_std * random.standard_normal(taught.shape)
            own = self._act(observation, image)
            action = np.where(teacher_drives[:, None], taught + noise, own)
            step = worlds.step(np.clip(action, -1.0, 1.0).astype(float))
            observation, success = step.observation, step.success
            returns += step.reward
        observed, acted, seen = (np.concatenate(each) for each in (observations, actions, images))
        self._demonstrations.append(
            VisualDemonstration(observed.astype(np.float32), acted.astype(np.float32), seen)
        )
        return returns, success

    def _episodes(self) -> Episodes:
        configuration = self._configuration
        if self._worlds is None:
            self._worlds = Episodes(
                configuration.environment,
                configuration.num_envs,
                people=self._people,
                num_threads=configuration.threads,
                force_guard=configuration.force_guard,
                settings=configuration.settings,
            )
        return self._worlds

    def _image(self, worlds: Episodes) -> NumpyArray:
        """Render the camera images of all worlds. Returns the input of the network (N, H, W, C) in half precision."""
        (camera,) = self._cameras
        images = worlds.render_images(self._cameras)
        return make_vision_input({kind: images[f"{camera.name}_{kind}"] for kind in camera.kinds}).astype(
            np.float16
        )

    def _act(self, observation: FloatArray, image: NumpyArray) -> FloatArray:
        rows = self._normalised(observation.astype(np.float32))
        with torch.no_grad():
            return self._network.compute_teacher_actions(
                rows, self._network(_channels_first(image), rows)
            ).numpy()

    def _normalised(self, observations: Float32Array) -> torch.Tensor:
        return torch.as_tensor(self._teacher.normalise_observations(observations), dtype=torch.float32)

    def _fit(self, random: np.random.Generator, *, last: bool) -> None:
        """Train the network on all demonstrations, with more gradient steps in the last round."""
        rows = self._normalised(self._demonstrations.concatenate("observations"))
        actions = torch.as_tensor(self._demonstrations.concatenate("actions")).clamp(-1.0, 1.0)
        images = torch.as_tensor(self._demonstrations.concatenate("images"))
        true = rows[:, self._estimated]
        steps, decay = (
            (VISUAL_HYPERPARAMETERS.final_round_gradient_steps, VISUAL_HYPERPARAMETERS.final_round_lr_decay)
            if last
            else (VISUAL_HYPERPARAMETERS.gradient_steps, VISUAL_HYPERPARAMETERS.lr_decay)
        )
        optimizer = torch.optim.Adam(self._network.parameters(), VISUAL_HYPERPARAMETERS.learning_rate)
        schedule = ExponentialLR(optimizer, decay ** (1.0 / steps))
        for _ in range(steps):
            batch = torch.as_tensor(random.integers(len(rows), size=VISUAL_HYPERPARAMETERS.batch_size))
            estimates = self._network(_channels_first(images[batch]), rows[batch])
            acted = self._network.compute_teacher_actions(rows[batch], estimates).clamp(-1.5, 1.5)
            loss = smooth_l1_loss(
                estimates, true[batch]
            ) + VISUAL_HYPERPARAMETERS.action_loss_weight * mse_loss(acted, actions[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()


def _channels_first(image: NumpyArray | torch.Tensor) -> torch.Tensor:
    return torch.as_tensor(image).permute(0, 3, 1, 2).float()
