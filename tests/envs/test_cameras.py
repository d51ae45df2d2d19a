"""Tests of cameras in observations. They render for real."""

import subprocess
import sys
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import check_env
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.envs.benchmark import CAMERA_SIZES_PX, measure_camera_speed
from avrgym.envs.single import AssistiveEnv
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.models.cameras import (
    IMAGE_KINDS,
    MAX_IMAGE_DEPTH_M,
    SCENE_CAMERA,
    SEGMENTATION_LABELS,
    WRIST_CAMERA,
    CameraSpec,
)
from avrgym.models.robot import CameraMount
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.validation import check_robot
from avrgym.tasks.camera_images import CameraImageRenderer, _SexModel, find_rendering_error
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, find_task_and_scene

FEEDING, BATHING = "avrgym/FeedingJaco-v1", "avrgym/BedBathingPR2-v1"
needs_graphics = pytest.mark.skipif(
    find_rendering_error() is not None, reason="no graphics library renders here"
)
EVERY_KIND = [CameraSpec(name, 80, 64, IMAGE_KINDS) for name in (WRIST_CAMERA, SCENE_CAMERA)]


def cameras_of(environment: str) -> list[CameraSpec]:
    robot = find_task_and_scene(environment)[1].robot
    return [*EVERY_KIND, *(CameraSpec(name, 64, 96, ("rgb",)) for name in robot.cameras)]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
@needs_graphics
def test_cameras_change_no_state_and_images_fill_their_spaces(environment: str):
    plain = AssistiveEnv(environment, people="revised")
    seeing = AssistiveEnv(environment, people="revised", cameras=cameras_of(environment))
    assert isinstance(seeing.observation_space, gym.spaces.Dict)
    for seed in range(2):
        expected, _ = plain.reset(seed=seed)
        observed, _ = seeing.reset(seed=seed)
        for _ in range(2):
            assert isinstance(observed, dict)
            assert observed in seeing.observation_space
            assert observed["state"].tobytes() == np.asarray(expected).tobytes()
            assert all(np.ptp(image) > 0 for image in observed.values())
            action = plain.action_space.sample()
            expected, observed = plain.step(action)[0], seeing.step(action)[0]
    assert isinstance(observed, dict)
    seen = np.unique(observed[f"{SCENE_CAMERA}_segmentation"])
    assert {"person", "robot", "furniture"} <= {SEGMENTATION_LABELS[number] for number in seen}
    seeing.close()


@pytest.mark.slow
@needs_graphics
def test_an_environment_with_cameras_follows_gymnasium():
    env = gym.make(FEEDING, cameras=["wrist", {"name": "scene", "kinds": ["depth"], "fovy_deg": 60.0}])
    check_env(env.unwrapped, skip_render_check=True)
    assert env.spec is not None
    same = gym.make(EnvSpec.from_json(env.spec.to_json()))
    first, again = env.reset(seed=3)[0], same.reset(seed=3)[0]
    assert list(first) == ["state", "wrist_rgb", "scene_depth"]
    for name, values in first.items():
        assert_array_equal(values, again[name])
    env.close()
    same.close()


@pytest.mark.slow
@needs_graphics
@pytest.mark.parametrize("mode", ["SameStep", "NextStep"])
def test_many_worlds_see_what_each_alone_sees(mode: str):
    options: dict[str, Any] = {"people": "revised", "cameras": EVERY_KIND, "max_episode_steps": 2}
    vector = AssistiveVectorEnv(FEEDING, 3, autoreset_mode=mode, **options)
    alone = gym.vector.SyncVectorEnv(
        [lambda: gym.make(FEEDING, **options) for _ in range(3)], autoreset_mode=vector.autoreset_mode
    )
    outcomes = [vector.reset(seed=0), alone.reset(seed=0)]
    for _ in range(4):
        (own, own_infos), (expected, infos) = outcomes
        assert isinstance(own, dict)
        assert isinstance(expected, dict)
        for name, values in expected.items():
            assert_array_equal(own[name], values)
        assert ("final_obs" in own_infos) == ("final_obs" in infos)
        for mine, theirs in zip(own_infos.get("final_obs", ()), infos.get("final_obs", ()), strict=True):
            for name in theirs:
                assert_array_equal(mine[name], theirs[name])
        action = vector.action_space.sample()
        outcomes = [(result[0], result[4]) for result in (vector.step(action), alone.step(action))]
    vector.close()
    alone.close()


@needs_graphics
def test_cloth_is_drawn_where_it_is_simulated():
    episodes = Episodes("avrgym/DressingJaco-v1", 1, people="revised", num_threads=1)
    episodes.reset(np.arange(1), [np.random.default_rng(0)])
    episodes.step(np.zeros((1, episodes.action_size)))
    episodes.render_images([CameraSpec(SCENE_CAMERA)])
    (model,) = episodes._images._models.values()  # pyright: ignore
    cloth_w = episodes.get_state().cloth_pos_w
    assert cloth_w is not None
    assert_allclose(model._data.flexvert_xpos, cloth_w[0], atol=1e-9)


@needs_graphics
def test_depth_and_segmentation_are_those_of_the_simulated_bodies():
    episodes = Episodes(FEEDING, 2, people="revised", num_threads=1)
    episodes.reset(np.arange(2), [np.random.default_rng(seed) for seed in range(2)])
    camera = CameraSpec(WRIST_CAMERA, 320, 240, ("depth", "segmentation"))
    images = episodes.render_images([camera])
    for world in range(2):
        depth, labels = images["wrist_depth"][world], images["wrist_segmentation"][world]
        model = episodes._images._models[episodes.get_person(world).sex]  # pyright: ignore
        model.show(episodes, world, episodes.get_person(world))
        data, number = model._data, model.model.camera(WRIST_CAMERA).id
        food_w = episodes.get_state().particle_pos_w[world]
        ahead_m = (data.cam_xpos[number] - food_w) @ data.cam_xmat[number].reshape(3, 3)[:, 2]
        food = depth[labels == SEGMENTATION_LABELS.index("particles")]
        assert_allclose(food.min(), ahead_m.min() - 0.005, atol=0.002)
        assert ((food > ahead_m.min() - 0.006) & (food < ahead_m.max() + 0.005)).all()
        assert depth.max() == np.float32(MAX_IMAGE_DEPTH_M)
        assert (labels[depth < 1.0] > 0).all()
        assert {"person", "robot", "tool", "furniture"} <= {
            SEGMENTATION_LABELS[each] for each in np.unique(labels)
        }


@pytest.mark.slow
@needs_graphics
def test_an_image_depends_neither_on_other_worlds_nor_on_hidden_geoms(monkeypatch: pytest.MonkeyPatch):
    episodes = Episodes(FEEDING, 4, people="revised", num_threads=1)
    episodes.reset(np.arange(4), [np.random.default_rng(seed) for seed in range(4)])
    assert len({episodes.get_person(world).sex for world in range(4)}) == 2
    images = CameraImageRenderer(episodes, EVERY_KIND).render_images()
    monkeypatch.setattr(_SexModel, "_outside", lambda self, camera, number: np.zeros(self.model.ngeom, bool))
    for world in range(4):
        alone = CameraImageRenderer(episodes, EVERY_KIND)
        for name, (image,) in alone.render_images([world]).items():
            assert_array_equal(image, images[name][world], name)
        alone.close()


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        (["head"], "unknown camera 'head' of robot Jaco; allowed: wrist, scene"),
        (
            ["wrist", "wrist:64x64:depth"],
            "cameras are wrist, wrist; allowed: each camera once, with all its kinds",
        ),
        ("wrist", r"cameras is 'wrist'; allowed: a list of camera names, such as \['wrist'\]"),
        (["wrist:32x64"], "width_px of camera 'wrist' is 32; allowed: 64 to 640"),
        (["wrist:64x481"], "height_px of camera 'wrist' is 481; allowed: 64 to 480"),
        (["wrist:64x64:xyz"], "kinds of camera 'wrist' are .*; allowed: one or more of rgb, depth, segment"),
        (["wrist:64"], "the camera is 'wrist:64'; allowed: NAME, NAME:WIDTHxHEIGHT"),
        ([{"name": "wrist", "fov": 3}], "unknown field `fov`; allowed: a text .* or the fields name, width"),
        ([{"name": "wrist", "fovy_deg": 1}], "fovy_deg of camera 'wrist' is 1.0; allowed: 5 to 150"),
        ([3], "camera 3 is invalid: .*; allowed: a text"),
    ],
)
def test_invalid_cameras_are_refused(cameras: Any, message: str):
    with pytest.raises(ValueError, match=message):
        AssistiveEnv(FEEDING, cameras=cameras)


def test_cameras_of_the_pr2_include_its_head():
    with pytest.raises(ValueError, match="unknown camera 'eye' of robot PR2; allowed: wrist, scene, head"):
        AssistiveEnv(BATHING, cameras=["eye"])


@pytest.mark.parametrize(
    ("name", "mount", "message"),
    [
        ("wrist", CameraMount("base", (0, 0, 1), (1, 0, 0), (0, 0, 1), 45.0), "invalid camera name 'wrist'"),
        (
            "eye",
            CameraMount("tail", (0, 0, 1), (1, 0, 0), (0, 0, 1), 45.0),
            "cameras: its model has no 'tail'",
        ),
        ("eye", CameraMount("base", (0, 0, 1), (0, 0, 2), (0, 0, 1), 45.0), "two different directions"),
    ],
)
def test_invalid_cameras_of_robots_are_refused(name: str, mount: CameraMount, message: str):
    with pytest.raises(ValueError, match=message):
        check_robot(replace(JACO, cameras={name: mount}))


@pytest.mark.slow
def test_states_alone_load_no_renderer():
    code = (
        "import sys, gymnasium as gym; env = gym.make('avrgym:avrgym/FeedingJaco-v1'); env.reset(seed=0); "
        "env.step(env.action_space.sample()); "
        "assert not {'PIL', 'avrgym.tasks.camera_images', 'avrgym.models.human_shape'} & {*sys.modules}, "
        "sorted({'PIL', 'avrgym.tasks.camera_images', 'avrgym.models.human_shape'} & {*sys.modules})"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.slow
@needs_graphics
def test_the_benchmark_has_a_row_for_each_kind_and_size():
    rows = measure_camera_speed(FEEDING, frames=1)
    assert {(row.kind, row.size_px) for row in rows} == {
        (kind, f"{width} x {height}") for kind in IMAGE_KINDS for width, height in CAMERA_SIZES_PX
    }
    assert all(row.frames_per_second > 0.0 for row in rows)
