"""Policies by name or path (the values of ``--policy``), and functions that compute their actions."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models.cameras import (
    COMMAND_ENTRY,
    STATE_ENTRY,
    AnyObservation,
    CameraDescription,
    CameraSpec,
    parse_cameras,
)
from avrgym.networks.vision import make_vision_input
from avrgym.policies import controllers, lerobot
from avrgym.policies.actors import Actor
from avrgym.policies.controllers import ExternalController
from avrgym.policies.onnx import ONNX_SUFFIX, load_onnx_controller
from avrgym.policies.policy_names import (
    DEFAULT_POLICY_NAMES,
    OPERATOR_POLICY_NAME,
    POLICY_FILE_FORMS_TEXT,
    SCRIPTED_POLICY_NAMES,
)
from avrgym.policies.trained_policies import Policy, PolicyError, find_packaged_policies, load_policy
from avrgym.robots.registry import SKIPPED_PLUGINS as BROKEN_ROBOTS
from avrgym.system.used_plugins import UsedPlugin, describe_plugin_differences
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import SKIPPED_PLUGINS as BROKEN_TASKS
from avrgym.tasks.registry import (
    find_plugins,
    find_task_and_scene,
    get_observation_and_action_size,
    make_policy_instruction,
)
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings, make_settings

ActionFunction = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class ScriptedPolicy:
    """A scripted policy without a network, such as ``oracle``: one of ``SCRIPTED_POLICY_NAMES``."""

    name: str


@dataclass(frozen=True)
class HumanOperator:
    """The policy ``operator``: an experimenter controls the robot's hand (teleoperation)."""


RobotPolicy = Policy | ScriptedPolicy | ExternalController
AnyPolicy = RobotPolicy | HumanOperator


def list_policy_names(environment_id: str) -> list[str]:
    """Returns the names of an environment's packaged policies, scripted policies and registered controllers."""
    return [
        *find_packaged_policies(environment_id),
        *SCRIPTED_POLICY_NAMES,
        *controllers.find_registered_controllers(),
    ]


def find_default_policy_name(environment_id: str) -> str:
    """Returns the first name of ``DEFAULT_POLICY_NAMES`` that is a policy of the environment."""
    names = list_policy_names(environment_id)
    return next(name for name in DEFAULT_POLICY_NAMES if name in names)


def collect_skipped_plugin_errors() -> list[str]:
    """Returns an error message for each plug-in (robot, task, controller) that cannot be used.

    Imports all controllers.
    """
    records = [f"{broken.entry_point}: {broken.reason}" for broken in (*BROKEN_ROBOTS, *BROKEN_TASKS)]
    return [*records, *controllers.collect_controller_import_errors()]


def resolve_policy(
    name: str,
    environment_id: str,
    settings: Settings = DEFAULT_SETTINGS,
    *,
    allow_other_environment: bool = False,
    allow_other_settings: bool = False,
) -> RobotPolicy:
    """Load and return a policy for an environment, by name or path.

    Args:
        name: name of a packaged policy, a script or a registered controller; path of a ``.safetensors`` or ``.onnx``
            file; ``module:attribute``; or ``lerobot:FOLDER``.
        environment_id: environment id such as ``avrgym/FeedingJaco-v1``.
        settings: settings of the environment.
        allow_other_environment: whether to allow a policy that was trained for another environment.
        allow_other_settings: whether to allow a policy that was trained with other settings.

    Raises:
        PolicyError: for an unknown name (the message lists the allowed values). Also if the policy cannot be loaded, or
            was trained for another environment, other settings or other array sizes.
    """
    observation_size, action_size = get_observation_and_action_size(environment_id)
    if name in SCRIPTED_POLICY_NAMES:
        return ScriptedPolicy(name)
    if name in find_packaged_policies(environment_id) or Path(name).is_file():
        if name.endswith(ONNX_SUFFIX):
            return load_onnx_controller(name, environment_id, observation_size, action_size)
        policy = load_policy(
            name,
            environment_id,
            observation_size,
            action_size,
            allow_other_environment=allow_other_environment,
        )
        if not allow_other_settings:
            _check_settings(policy, name, settings)
        find_policy_cameras(policy, environment_id)
        return policy
    if lerobot.is_lerobot_policy(name):
        task, scene = find_task_and_scene(environment_id, settings)
        controller = lerobot.load_lerobot_controller(
            name,
            task.make_observation_spec(scene),
            action_size,
            make_policy_instruction(environment_id, settings),
        )
        find_policy_cameras(controller, environment_id)
        return controller
    if name in controllers.find_registered_controllers() or ":" in name:
        registered = name in controllers.find_registered_controllers()
        controller = (
            controllers.import_registered_controller(name)
            if registered
            else controllers.import_python_controller(name)
        )
        find_policy_cameras(controller, environment_id)
        return controller
    if name == OPERATOR_POLICY_NAME:
        raise PolicyError(
            f"the policy {OPERATOR_POLICY_NAME} needs an experimenter at the robot's controls; allowed in `avrgym "
            f"view`, "
            "`avrgym serve` and studies"
        )
    allowed = ", ".join([*list_policy_names(environment_id), POLICY_FILE_FORMS_TEXT])
    raise PolicyError(f"no policy {name!r} for {environment_id}; allowed: {allowed}")


def _check_settings(policy: Policy, name: str, settings: Settings) -> None:
    trained_with = make_settings(policy.metadata.settings)
    if trained_with != settings:
        raise PolicyError(
            f"{name}: trained with {trained_with}, not with {settings}; to use it anyway, add --allow-other-settings, "
            "or in study.toml allow_other_settings = true"
        )


def resolve_session_policy(
    name: str,
    environment_id: str,
    settings: Settings = DEFAULT_SETTINGS,
    *,
    allow_other_settings: bool = False,
) -> AnyPolicy:
    """Load and return a policy like ``resolve_policy``, or ``HumanOperator`` for the name ``operator``.

    The process of a LeRobot policy is started, to prevent a delay in the first trial.
    """
    if name == OPERATOR_POLICY_NAME:
        return HumanOperator()
    policy = resolve_policy(name, environment_id, settings, allow_other_settings=allow_other_settings)
    if isinstance(policy, ExternalController):
        policy.prepare()
    return policy


def find_used_controller_plugin(name: str) -> UsedPlugin | None:
    """Returns the installed version of a controller by the policy's name; ``None`` for policies of AVR Gym."""
    return (
        lerobot.make_lerobot_plugin(name)
        if lerobot.is_lerobot_policy(name)
        else controllers.find_controller_plugin(name)
    )


def find_used_plugins(environment_id: str, policy: AnyPolicy) -> tuple[UsedPlugin, ...]:
    """Returns the installed versions of the plug-ins that an environment and a policy use."""
    controller = policy.plugin if isinstance(policy, ExternalController) else None
    return find_plugins(environment_id) + (() if controller is None else (controller,))


def describe_plugin_changes(policy: RobotPolicy, environment_id: str) -> list[str]:
    """Returns descriptions of the environment's plug-ins that changed since the policy's training.

    If the policy was trained in another environment, only plug-ins that both environments use are compared.
    """
    if not isinstance(policy, Policy):
        return []
    before, now = policy.metadata.plugins, find_plugins(environment_id)
    if policy.metadata.environment != environment_id:
        both = {each.label for each in before} & {each.label for each in now}
        before, now = (tuple(each for each in plugins if each.label in both) for plugins in (before, now))
    return describe_plugin_differences(before, now)


@contextmanager
def open_policy(
    policy: RobotPolicy, world: Episodes, generators: Sequence[np.random.Generator]
) -> Generator[ActionFunction]:
    """Context manager: yields a function that maps observations (N, O) to actions (N, A), for one episode of each
    world.

    An external controller has one instance per world. The world's generator determines the seed of its instance.
    Instances are closed at the end.

    Raises:
        PolicyError: if an instance cannot be created.
    """
    if not isinstance(policy, ExternalController):
        yield make_action_function(policy, world, generators)
        return
    instances = [policy.make_controller() for _ in generators]
    try:
        for controller, generator in zip(instances, generators, strict=True):
            controllers.reset_controller(controller, draw_controller_seed(generator), world.environment_id)
        yield lambda observations: np.stack(
            [
                controllers.compute_controller_action(*pair, world.action_size)
                for pair in zip(
                    instances, make_controller_observations(policy, world, observations), strict=True
                )
            ]
        )
    finally:
        for controller in instances:
            controllers.close_controller(controller)


def make_action_function(
    policy: Policy | ScriptedPolicy, world: Episodes, generators: Sequence[np.random.Generator]
) -> ActionFunction:
    """Returns a function that maps observations (N, O) to actions (N, A), for one episode of each world.

    Create a new function for each episode, because the function stores the memory of a recurrent policy.
    """
    if isinstance(policy, Policy):
        actor, cameras = Actor(policy, len(generators)), find_policy_cameras(policy, world.environment_id)
        return lambda observation: actor.act(observation, generators, _network_image(world, cameras))
    if policy.name == "zero":
        return lambda observation: np.zeros((len(observation), world.action_size), np.float32)
    if policy.name == "random":
        return lambda observation: np.stack(
            [g.uniform(-1.0, 1.0, world.action_size) for g in generators]
        ).astype(np.float32)
    return world.task.expert(world)


def find_policy_cameras(policy: AnyPolicy, environment_id: str) -> tuple[CameraSpec, ...]:
    """Returns the cameras that a policy needs.

    Raises:
        PolicyError: for a camera that the environment's robot does not have. The message lists the allowed cameras.
    """
    if isinstance(policy, ExternalController):
        wanted: Sequence[CameraDescription] = policy.cameras
    else:
        wanted = (policy.metadata.camera,) if isinstance(policy, Policy) and policy.metadata.camera else ()
    try:
        return parse_cameras(wanted, find_task_and_scene(environment_id)[1].robot) if wanted else ()
    except ValueError as error:
        raise PolicyError(f"the policy cannot be used in {environment_id}: {error}") from error


def warm_up_renderer(policy: AnyPolicy, world: Episodes) -> None:
    """Renders one image if the policy has cameras. The first rendering is slow, because it compiles the visual geoms.

    Without this call, the first action of the policy would be late.
    """
    cameras = find_policy_cameras(policy, world.environment_id)
    if cameras:
        world.render_images(cameras)


def make_controller_observations(
    policy: ExternalController, world: Episodes, observations: FloatArray
) -> list[AnyObservation]:
    """Returns the observation of each world's controller: an array (O,).

    For a controller with cameras or commands, the observation is a dictionary. It contains ``state``, the images and
    ``command``.

    Args:
        policy: controller of another package or file.
        world: episodes in N worlds.
        observations: observations of all worlds (N, O).
    """
    cameras = find_policy_cameras(policy, world.environment_id)
    if not cameras and not policy.takes_commands:
        return [*observations]
    images = world.render_images(cameras) if cameras else {}
    if policy.takes_commands:
        images = {**images, COMMAND_ENTRY: world.control_loop.make_command_input()}
    return [
        {STATE_ENTRY: row, **{name: image[number] for name, image in images.items()}}
        for number, row in enumerate(observations)
    ]


def _network_image(world: Episodes, cameras: Sequence[CameraSpec]) -> FloatArray | None:
    """Returns the network's input (N, H, W, C) for a policy with vision, or None without cameras."""
    if not cameras:
        return None
    (camera,) = cameras
    images = world.render_images(cameras)
    return make_vision_input({kind: images[f"{camera.name}_{kind}"] for kind in camera.kinds})


def draw_controller_seed(generator: np.random.Generator) -> int:
    """Returns a controller's seed for an episode, sampled with the episode's ``generator``."""
    return int(generator.integers(2**31))
