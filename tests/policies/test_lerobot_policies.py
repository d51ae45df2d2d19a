"""LeRobot policies drive the robot from a process of their own."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from avrgym.learning.evaluation import evaluate
from avrgym.models.cameras import CameraSpec
from avrgym.policies.controllers import ControllerError, ExternalController
from avrgym.policies.lerobot import LeRobotController, PolicyProcess, split_state_features
from avrgym.policies.registry import find_used_controller_plugin, resolve_policy
from avrgym.policies.trained_policies import PolicyError
from avrgym.replay.verification import verify_recording
from avrgym.tasks.registry import ENVIRONMENTS, find_task_and_scene
from avrgym.vr.session.plan import load_policies
from helpers.learning.lerobot_policies import STUB, lerobot_python, save_act, save_configuration
from helpers.vr.visit import ENVIRONMENT, Visit, plan

STATES = {"observation.state": [15], "observation.environment_state": [10]}
FEATURES = {**STATES, "action": [7]}
ROW = np.arange(25.0)


def observation_of(environment: str):
    task, scene = find_task_and_scene(environment)
    return task.make_observation_spec(scene)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_every_value_is_in_one_feature_and_the_robot_measures_no_person(environment: str) -> None:
    observation = observation_of(environment)
    parts = split_state_features(observation, np.arange(observation.size))
    assert sorted(value for part in parts.values() for value in part) == list(range(observation.size))
    starts = observation.entry_end_indices - [entry.size for entry in observation.entries]
    measured = {
        entry.name
        for entry, start in zip(observation.entries, starts, strict=True)
        if start in parts["observation.state"]
    }
    assert {"tool_from_torso_m", "tool_rotation", "tool_force_n"} < measured
    assert not any(
        word in name for name in measured for word in ("head", "mouth", "itch", "elbow", "forearm")
    )


def found(name: str) -> ExternalController:
    policy = resolve_policy(name, ENVIRONMENT)
    assert isinstance(policy, ExternalController)
    return policy


def act(policy: Any, observation: Any = ROW) -> list[float]:
    return policy.act(observation)


@pytest.fixture
def process() -> Iterator[PolicyProcess]:
    process = PolicyProcess([sys.executable, "-c", STUB], {})
    yield process
    process.stop()


def controller(process: PolicyProcess) -> LeRobotController:
    return LeRobotController(process, observation_of(ENVIRONMENT), ["observation.state"], "Help.")


def test_controllers_share_a_process_and_have_their_own_episodes(process: PolicyProcess) -> None:
    first, second = controller(process), controller(process)
    first.reset(10, ENVIRONMENT)
    second.reset(20, ENVIRONMENT)
    assert [act(first, ROW)[0], act(first, ROW)[0], act(second, ROW)[0]] == [11, 12, 21]
    assert (
        act(first, ROW)[1:]
        == split_state_features(observation_of(ENVIRONMENT), ROW)["observation.state"].tolist()
    )
    first.close()
    with pytest.raises(ControllerError, match="exception: KeyError: no such session"):
        act(first, ROW)
    assert act(second, ROW)[0] == 22


def test_after_a_crash_the_next_controller_starts_the_process_again(process: PolicyProcess) -> None:
    crashed = controller(process)
    crashed.reset(0, ENVIRONMENT)
    for words in (r"the process has ended \(Segmentation fault\)", "policy has ended"):
        with pytest.raises(ControllerError, match=words):
            act(crashed, -ROW - 1.0)
    crashed.close()
    following = controller(process)
    following.reset(0, ENVIRONMENT)
    assert act(following, ROW)[0] == 1


def test_a_process_that_cannot_load_is_refused_with_the_next_step() -> None:
    process = PolicyProcess([sys.executable, "-c", "import lerobot_is_missing"], {})
    with pytest.raises(PolicyError, match=r"No module named 'lerobot_is_missing'.*AVRGYM_LEROBOT_PYTHON"):
        controller(process)


@pytest.mark.parametrize(
    ("features", "words"),
    [
        (
            {**FEATURES, "observation.state": [14]},
            r"input is observation.state \[14\]; allowed: .*state \[15\]",
        ),
        ({**FEATURES, "action": [6]}, r"outputs are {'action': \[6\]}; allowed: action \[7\]"),
        ({**FEATURES, "observation.images.eye_rgb": [3, 64, 64]}, "unknown camera 'eye'"),
        ({**FEATURES, "observation.images.wrist_rgb": [3, 32, 64]}, "height_px of camera 'wrist' is 32"),
        ({**FEATURES, "observation.images.wrist": [3, 64, 64]}, "allowed: .*observation.images.CAMERA_rgb"),
    ],
)
def test_policies_with_other_inputs_or_outputs_are_refused(tmp_path: Path, features, words: str) -> None:
    with pytest.raises(PolicyError, match=words):
        resolve_policy(f"lerobot:{save_configuration(tmp_path, features)}", ENVIRONMENT)


def test_folders_without_a_policy_are_refused(tmp_path: Path) -> None:
    with pytest.raises(
        PolicyError, match=r"contains no LeRobot policy .* allowed: a folder pretrained_model"
    ):
        resolve_policy(f"lerobot:{tmp_path}", ENVIRONMENT)
    save_configuration(tmp_path, FEATURES)
    (tmp_path / "model.safetensors").unlink()
    with pytest.raises(PolicyError, match=r"model\.safetensors is missing"):
        resolve_policy(f"lerobot:{tmp_path}", ENVIRONMENT)


def test_a_policy_names_its_cameras_and_the_hash_of_its_files(tmp_path: Path) -> None:
    name = (
        f"lerobot:{save_configuration(tmp_path, {**FEATURES, 'observation.images.wrist_rgb': [3, 64, 80]})}"
    )
    policy = found(name)
    assert policy.cameras == (CameraSpec("wrist", 80, 64),)
    assert policy.plugin == find_used_controller_plugin(name)
    (tmp_path / "model.safetensors").write_bytes(b"others")
    assert policy.plugin != find_used_controller_plugin(name)


# With LeRobot


@pytest.fixture(scope="module")
def python() -> str:
    found = lerobot_python()
    if found is None:
        pytest.skip("LeRobot is not installed; AVRGYM_LEROBOT_PYTHON may name an environment that has it")
    return found


@pytest.mark.slow
def test_an_act_policy_drives_a_session_that_replays_bit_by_bit(tmp_path: Path, python: str) -> None:
    name = f"lerobot:{save_act(python, tmp_path / 'act', FEATURES, n_action_steps=2)}"
    planned = plan(trial_steps=6)
    planned = replace(planned, trials=[replace(planned.trials[0], policy=name)])
    visit = Visit(tmp_path / "recordings", planned, load_policies(planned))
    visit.calibrate()
    while visit.phase != "finished":
        if visit.phase == "questionnaire":
            visit.answer(1)
        visit.tick()
    visit.leave()
    (recording,) = visit.recordings()
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    assert not any(step.idle for step in steps)
    assert {step.driver for step in steps} == {name}
    assert verify_recording(recording).is_identical
    policy: Any = found(name).make_controller()
    policy.reset(0, ENVIRONMENT)
    expected = [act(policy, np.array(step.observation)) for step in steps]
    policy.close()
    np.testing.assert_array_equal(
        [step.action for step in steps], np.clip(np.array(expected, np.float32), -1.0, 1.0)
    )


@pytest.mark.slow
def test_images_temporal_ensembles_and_seeds(tmp_path: Path, python: str) -> None:
    features = {**FEATURES, "observation.images.wrist_rgb": [3, 64, 64]}
    ensemble = {"n_action_steps": 1, "temporal_ensemble_coeff": 0.01}
    name = f"lerobot:{save_act(python, tmp_path / 'act', features, **ensemble)}"
    one, same = (evaluate(ENVIRONMENT, name, "original", 2, 0, steps=3) for _ in range(2))
    assert one == same
    makers: list[Any] = [found(name).make_controller() for _ in range(2)]
    first, second = makers
    pictures = [
        {"state": ROW, "wrist_rgb": np.full((64, 64, 3), colour, np.uint8)} for colour in (0, 255, 255)
    ]
    actions = []
    for each in makers:
        each.reset(0, ENVIRONMENT)
    for picture in pictures:  # in turn: their ensembles do not mix
        actions.append([act(first, picture), act(second, pictures[0])])
    first.close()
    second.close()
    np.testing.assert_array_equal(*actions[0])
    assert actions[1][0] != actions[1][1]
