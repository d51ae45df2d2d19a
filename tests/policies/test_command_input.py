"""Controllers of packages and ONNX files receive the participant's commands if they take them."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from numpy.testing import assert_array_equal
from onnx import TensorProto, helper, numpy_helper

from avrgym.commands.preferences import ConditionRules, apply_preferences
from avrgym.commands.vocabulary import COMMAND_NAMES
from avrgym.models.cameras import COMMAND_ENTRY, STATE_ENTRY
from avrgym.policies import controllers, registry
from avrgym.policies.onnx import load_onnx_controller
from avrgym.policies.registry import resolve_policy
from avrgym.policies.trained_policies import PolicyError
from avrgym.safety.pacing import COMMAND_INPUT_ENTRIES, NO_COMMAND_INPUT
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import get_observation_and_action_size

ENVIRONMENT = "avrgym/FeedingJaco-v1"


class Obedient:
    """Turns the first joint while the latest command is ``ready``."""

    takes_commands = True

    def reset(self, seed: int, environment: str) -> None:
        """Does nothing."""

    def act(self, observation: dict[str, np.ndarray]) -> list[float]:
        """Returns the action for the latest command."""
        return [observation[COMMAND_ENTRY][COMMAND_INPUT_ENTRIES.index("ready")], 0, 0, 0, 0, 0, 0]


def episodes(*, pacing: bool) -> Episodes:
    rules = ConditionRules(policy="obedient", commands=COMMAND_NAMES, sources=("key",), pacing=pacing)
    made = Episodes(ENVIRONMENT, 1, num_threads=1, rules=apply_preferences(rules, None))
    made.reset(np.arange(1), [np.random.default_rng(0)])
    return made


def save_network(path: Path, size: int) -> None:
    """Save a network whose first action is the entry ``ready`` of its input ``command``."""
    observations, actions = get_observation_and_action_size(ENVIRONMENT)
    weight = np.zeros((size, actions))
    weight[COMMAND_INPUT_ENTRIES.index("ready"), 0] = 1.0
    nodes = [
        helper.make_node("MatMul", ["observation", "zeros"], ["still"]),
        helper.make_node("MatMul", [COMMAND_ENTRY, "weight"], ["moves"]),
        helper.make_node("Add", ["still", "moves"], ["action"]),
    ]
    arrays = {"zeros": np.zeros((observations, actions)), "weight": weight}
    graph = helper.make_graph(
        nodes,
        "obedient",
        [
            helper.make_tensor_value_info("observation", TensorProto.DOUBLE, ["N", observations]),
            helper.make_tensor_value_info(COMMAND_ENTRY, TensorProto.DOUBLE, ["N", size]),
        ],
        [helper.make_tensor_value_info("action", TensorProto.DOUBLE, ["N", actions])],
        [numpy_helper.from_array(array, name) for name, array in arrays.items()],
    )
    opset = [helper.make_opsetid("", 17)]
    onnx.save(helper.make_model(graph, opset_imports=opset, ir_version=8), path)


@pytest.mark.parametrize("kind", ["python", "onnx"])
def test_controllers_receive_the_latest_command(kind: str, tmp_path: Path) -> None:
    save_network(tmp_path / "obedient.onnx", len(COMMAND_INPUT_ENTRIES))
    name = f"{__name__}:Obedient" if kind == "python" else str(tmp_path / "obedient.onnx")
    policy = resolve_policy(name, ENVIRONMENT)
    assert isinstance(policy, controllers.ExternalController)
    assert policy.takes_commands
    world = episodes(pacing=False)
    (before,) = registry.make_controller_observations(policy, world, world.observe())
    world.control_loop.apply_command("ready")
    (after,) = registry.make_controller_observations(policy, world, world.observe())
    assert isinstance(before, dict)
    assert isinstance(after, dict)
    assert_array_equal(before[COMMAND_ENTRY], NO_COMMAND_INPUT)
    assert_array_equal(after[STATE_ENTRY], before[STATE_ENTRY])
    controller = policy.make_controller()
    assert controllers.compute_controller_action(controller, before, 7)[0] == 0.0
    assert controllers.compute_controller_action(controller, after, 7)[0] == 1.0


def test_without_the_layer_only_stop_changes_actions() -> None:
    world = episodes(pacing=False)
    action = np.full((1, 7), 0.4)
    assert not world.control_loop.apply_command("slower").any()
    assert_array_equal(world.step(action).executed_action, action)
    assert world.control_loop.apply_command("stop").all()
    assert_array_equal(world.step(action).executed_action, np.zeros((1, 7)))


def test_an_input_of_another_size_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wrong.onnx"
    save_network(path, len(COMMAND_INPUT_ENTRIES) + 1)
    with pytest.raises(
        PolicyError, match=rf"allowed for .*: one command .* \({len(COMMAND_INPUT_ENTRIES)},\)"
    ):
        load_onnx_controller(path, ENVIRONMENT, *get_observation_and_action_size(ENVIRONMENT))
