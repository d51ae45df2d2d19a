"""Tests of policies with vision and of controllers with cameras."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.array_types import FloatArray
from avrgym.learning.visual_network import TrainableVisionNetwork
from avrgym.networks.vision import make_vision_input
from avrgym.policies import registry
from avrgym.policies.controllers import ExternalController
from avrgym.policies.trained_policies import Policy, PolicyError, load_policy
from avrgym.tasks.camera_images import find_rendering_error
from avrgym.tasks.episodes import Episodes
from avrgym.vr.live_world.drivers import ThreadedDriver

FEEDING, SIZES = "avrgym/FeedingJaco-v1", (25, 7)
CAMERA = "wrist:64x64:depth"
needs_graphics = pytest.mark.skipif(
    find_rendering_error() is not None, reason="no graphics library renders here"
)
ESTIMATED = [7, 8, 9, *range(17, 25)]


@pytest.fixture(scope="module")
def network() -> TrainableVisionNetwork:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        return TrainableVisionNetwork(load_policy("revised", FEEDING, *SIZES), ESTIMATED, (64, 64, 1))


@pytest.fixture(scope="module")
def policy(network: TrainableVisionNetwork) -> Policy:
    teacher = load_policy("revised", FEEDING, *SIZES)
    metadata: Any = type(teacher.metadata)(
        environment=FEEDING, people="revised", steps=1, seed=0, camera=CAMERA
    )
    return replace(teacher, metadata=metadata, vision=network.to_numpy_network())


@pytest.fixture
def observed(rng: np.random.Generator, policy: Policy) -> tuple[FloatArray, FloatArray]:
    """Observations (4, O) and images (4, 64, 64, 1)."""
    rows = policy.observation_mean + rng.normal(size=(4, 25)) * np.sqrt(policy.observation_variance)
    return rows, make_vision_input({"depth": rng.uniform(0.1, 2.0, (4, 64, 64)).astype(np.float32)})


def test_the_network_in_numpy_computes_that_in_pytorch(
    network: TrainableVisionNetwork, policy: Policy, observed: Any
):
    rows, image = observed
    actions, _ = policy.forward(rows, np.zeros((4, 0)), image)
    normalised = torch.as_tensor(policy.normalise_observations(rows), dtype=torch.float32)
    with torch.no_grad():
        estimates = network(torch.as_tensor(image, dtype=torch.float32).permute(0, 3, 1, 2), normalised)
        assert_allclose(actions, network.compute_teacher_actions(normalised, estimates), atol=1e-4)


def test_actions_depend_on_the_image_and_not_on_what_is_estimated(policy: Policy, observed: Any):
    rows, image = observed
    actions, _ = policy.forward(rows, np.zeros((4, 0)), image)
    others = rows.copy()
    others[:, ESTIMATED] = 3.0
    assert_array_equal(policy.forward(others, np.zeros((4, 0)), image)[0], actions)
    assert_array_equal(policy.forward(rows[1:2], np.zeros((1, 0)), image[1:2])[0], actions[1:2])
    assert (policy.forward(rows, np.zeros((4, 0)), 1.0 - image)[0] != actions).any()


def test_a_file_of_a_policy_with_vision_reads_back(tmp_path: Path, policy: Policy, observed: Any):
    policy.save(tmp_path / "visual.safetensors")
    read = load_policy(tmp_path / "visual.safetensors", FEEDING, *SIZES)
    assert read.metadata == policy.metadata
    assert read.parameters_sha256 == policy.parameters_sha256
    rows, image = observed
    again, expected = (each.forward(rows, np.zeros((4, 0)), image)[0] for each in (read, policy))
    assert_array_equal(again, expected)
    with pytest.raises(PolicyError, match=f"pass images of the camera {CAMERA}"):
        read.forward(rows, np.zeros((4, 0)))


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        ("wrist:64x80:depth", "vision.dense.0 has the shape"),
        ("wrist:64x64:rgb", "vision.kernel.0 has the shape"),
    ],
)
def test_vision_that_does_not_fit_its_camera_is_refused(
    tmp_path: Path, policy: Policy, camera: str, message: str
):
    metadata: Any = type(policy.metadata)(
        environment=FEEDING, people="revised", steps=1, seed=0, camera=camera
    )
    replace(policy, metadata=metadata).save(tmp_path / "odd.safetensors")
    with pytest.raises(PolicyError, match=message):
        load_policy(tmp_path / "odd.safetensors", FEEDING, *SIZES)


class Looking:
    """A controller with two cameras."""

    cameras = ("wrist:64x64:rgb+depth", "scene")

    def __init__(self) -> None:
        self.seen: list[dict[str, Any]] = []

    def reset(self, seed: int, environment: str) -> None:
        """Starts an episode."""

    def act(self, observation: dict[str, Any]) -> FloatArray:
        """No action."""
        self.seen.append(observation)
        return np.zeros(7)


@pytest.mark.slow
@needs_graphics
def test_a_controller_receives_the_images_of_its_own_world():
    controllers: list[Looking] = []

    def make() -> Looking:
        controllers.append(Looking())
        return controllers[-1]

    worlds = Episodes(FEEDING, 2, people="revised", num_threads=1)
    generators = [np.random.default_rng(seed) for seed in range(2)]
    observations = worlds.reset(np.arange(2), generators)
    with registry.open_policy(
        ExternalController("looking", make, cameras=Looking.cameras), worlds, generators
    ) as act:
        act(observations)
    images = worlds.render_images(
        registry.find_policy_cameras(ExternalController("", make, cameras=Looking.cameras), FEEDING)
    )
    for world, controller in enumerate(controllers):
        (seen,) = controller.seen
        assert list(seen) == ["state", "wrist_rgb", "wrist_depth", "scene_rgb"]
        assert_array_equal(seen["state"], observations[world])
        for name, image in images.items():
            assert_array_equal(seen[name], image[world])


def test_a_controller_with_an_unknown_camera_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    code = "class Odd:\n cameras = ['eye']\n def reset(self, seed, environment): pass\n def act(self, seen): pass\n"
    (tmp_path / "odd_cameras.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        PolicyError, match=r"cannot be used in .*: unknown camera 'eye' of robot Jaco; allowed: wrist, scene"
    ):
        registry.resolve_policy("odd_cameras:Odd", FEEDING)


@needs_graphics
def test_a_driver_of_a_live_world_shows_its_controller_the_images():
    looking = Looking()
    driver = ThreadedDriver(
        ExternalController("looking", lambda: looking, cameras=("scene",)), background=False
    )
    world = Episodes(FEEDING, 1, people="revised", num_threads=1)
    generators = [np.random.default_rng(0)]
    observation = world.reset(np.arange(1), generators)
    driver.reset(world, generators)
    assert_array_equal(driver.act(observation), np.zeros((1, 7)))
    assert driver.failure_message == ""
    (seen,) = looking.seen
    assert_array_equal(
        seen["scene_rgb"],
        world.render_images(registry.find_policy_cameras(driver._controller_factory, FEEDING))["scene_rgb"][
            0
        ],
    )
    driver.close()
