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
from avrgym.networks.vision import vision_input
from avrgym.policies import controllers, lerobot
from avrgym.policies.actors import Actor
from avrgym.policies.controllers import ExternalController
from avrgym.policies.names import DEFAULT_POLICIES, OPERATOR_POLICY, POLICY_FILE_FORMS, SCRIPTED_POLICIES
from avrgym.policies.onnx import ONNX_SUFFIX, load_onnx_controller
from avrgym.policies.trained import Policy, PolicyError, load_policy, packaged_policies
from avrgym.robots.registry import SKIPPED_PLUGINS as BROKEN_ROBOTS
from avrgym.system.used_plugins import UsedPlugin, differences
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import SKIPPED_PLUGINS as BROKEN_TASKS
from avrgym.tasks.registry import instruction, observation_and_action_size, plugins_of, task_and_scene
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings, settings_from_values

ActionFunction = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class ScriptedPolicy:
    """A scripted policy without a network, such as ``oracle``: one of ``SCRIPTED_POLICIES``."""

    name: str


@dataclass(frozen=True)
class HumanOperator:
    """The policy ``operator``: an experimenter controls the robot's hand (teleoperation)."""


RobotPolicy = Policy | ScriptedPolicy | ExternalController
AnyPolicy = RobotPolicy | HumanOperator


def policy_names(environment_id: str) -> list[str]:
    """Returns the names of an environment's packaged policies, scripted policies and registered controllers."""
    return [*packaged_policies(environment_id), *SCRIPTED_POLICIES, *controllers.registered_controllers()]


def default_policy(environment_id: str) -> str:
    """Returns the first name of ``DEFAULT_POLICIES`` that is a policy of the environment."""
    names = policy_names(environment_id)
    return next(name for name in DEFAULT_POLICIES if name in names)


def skipped_plugin_errors() -> list[str]:
    """Returns an error message for each plug-in (robot, task, controller) that cannot be used.

    Imports all controllers.
    """
    records = [f"{broken.entry_point}: {broken.reason}" for broken in (*BROKEN_ROBOTS, *BROKEN_TASKS)]
    return [*records, *controllers.controller_import_errors()]


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
    observation_size, action_size = observation_and_action_size(environment_id)
    if name in SCRIPTED_POLICIES:
        return ScriptedPolicy(name)
    if name in packaged_policies(environment_id) or Path(name).is_file():
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
        cameras_of(policy, environment_id)
        return policy
    if lerobot.is_lerobot_policy(name):
        task, scene = task_and_scene(environment_id, settings)
        controller = lerobot.find_lerobot_policy(
            name, task.observation(scene), action_size, instruction(environment_id, settings)
        )
        cameras_of(controller, environment_id)
        return controller
    if name in controllers.registered_controllers() or ":" in name:
        registered = name in controllers.registered_controllers()
        controller = (
            controllers.import_registered_controller(name)
            if registered
            else controllers.import_python_controller(name)
        )
        cameras_of(controller, environment_id)
        return controller
    if name == OPERATOR_POLICY:
        raise PolicyError(
            f"the policy {OPERATOR_POLICY} needs an experimenter at the robot's controls; allowed in `avrgym view`, "
            "`avrgym serve` and studies"
        )
    allowed = ", ".join([*policy_names(environment_id), POLICY_FILE_FORMS])
    raise PolicyError(f"no policy {name!r} for {environment_id}; allowed: {allowed}")


def _check_settings(policy: Policy, name: str, settings: Settings) -> None:
    trained_with = settings_from_values(policy.metadata.settings)
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
    if name == OPERATOR_POLICY:
        return HumanOperator()
    policy = resolve_policy(name, environment_id, settings, allow_other_settings=allow_other_settings)
    if isinstance(policy, ExternalController):
        policy.prepare()
    return policy


def used_controller_plugin(name: str) -> UsedPlugin | None:
    """Returns the installed version of a controller by the policy's name; ``None`` for policies of AVR Gym."""
    return (
        lerobot.lerobot_policy_plugin(name)
        if lerobot.is_lerobot_policy(name)
        else controllers.controller_plugin(name)
    )


def plugins_used(environment_id: str, policy: AnyPolicy) -> tuple[UsedPlugin, ...]:
    """Returns the installed versions of the plug-ins that an environment and a policy use."""
    controller = policy.plugin if isinstance(policy, ExternalController) else None
    return plugins_of(environment_id) + (() if controller is None else (controller,))


def plugin_changes_since_training(policy: RobotPolicy, environment_id: str) -> list[str]:
    """Returns descriptions of the environment's plug-ins that changed since the policy's training.

    If the policy was trained in another environment, only plug-ins that both environments use are compared.
    """
    if not isinstance(policy, Policy):
        return []
    before, now = policy.metadata.plugins, plugins_of(environment_id)
    if policy.metadata.environment != environment_id:
        both = {each.label for each in before} & {each.label for each in now}
        before, now = (tuple(each for each in plugins if each.label in both) for plugins in (before, now))
    return differences(before, now)


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
        yield action_function(policy, world, generators)
        return
    instances = [policy.make() for _ in generators]
    try:
        for controller, generator in zip(instances, generators, strict=True):
            controllers.reset(controller, draw_controller_seed(generator), world.environment_id)
        yield lambda observations: np.stack(
            [
                controllers.act(*pair, world.action_size)
                for pair in zip(instances, controller_observations(policy, world, observations), strict=True)
            ]
        )
    finally:
        for controller in instances:
            controllers.close_controller(controller)


def action_function(
    policy: Policy | ScriptedPolicy, world: Episodes, generators: Sequence[np.random.Generator]
) -> ActionFunction:
    """Returns a function that maps observations (N, O) to actions (N, A), for one episode of each world.

    Create a new function for each episode, because the function stores the memory of a recurrent policy.
    """
    if isinstance(policy, Policy):
        actor, cameras = Actor(policy, len(generators)), cameras_of(policy, world.environment_id)
        return lambda observation: actor.act(observation, generators, _network_image(world, cameras))
    if policy.name == "zero":
        return lambda observation: np.zeros((len(observation), world.action_size), np.float32)
    if policy.name == "random":
        return lambda observation: np.stack(
            [g.uniform(-1.0, 1.0, world.action_size) for g in generators]
        ).astype(np.float32)
    return world.task.expert(world)


def cameras_of(policy: AnyPolicy, environment_id: str) -> tuple[CameraSpec, ...]:
    """Returns the cameras that a policy needs.

    Raises:
        PolicyError: for a camera that the environment's robot does not have. The message lists the allowed cameras.
    """
    if isinstance(policy, ExternalController):
        wanted: Sequence[CameraDescription] = policy.cameras
    else:
        wanted = (policy.metadata.camera,) if isinstance(policy, Policy) and policy.metadata.camera else ()
    try:
        return parse_cameras(wanted, task_and_scene(environment_id)[1].robot) if wanted else ()
    except ValueError as error:
        raise PolicyError(f"the policy cannot be used in {environment_id}: {error}") from error


def warm_up_renderer(policy: AnyPolicy, world: Episodes) -> None:
    """Renders one image if the policy has cameras. The first rendering is slow, because it compiles the visual geoms.

    Without this call, the first action of the policy would be late.
    """
    cameras = cameras_of(policy, world.environment_id)
    if cameras:
        world.images(cameras)


def controller_observations(
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
    cameras = cameras_of(policy, world.environment_id)
    if not cameras and not policy.takes_commands:
        return [*observations]
    images = world.images(cameras) if cameras else {}
    if policy.takes_commands:
        images = {**images, COMMAND_ENTRY: world.control_loop.command_input()}
    return [
        {STATE_ENTRY: row, **{name: image[number] for name, image in images.items()}}
        for number, row in enumerate(observations)
    ]


def _network_image(world: Episodes, cameras: Sequence[CameraSpec]) -> FloatArray | None:
    """Returns the network's input (N, H, W, C) for a policy with vision, or None without cameras."""
    if not cameras:
        return None
    (camera,) = cameras
    images = world.images(cameras)
    return vision_input({kind: images[f"{camera.name}_{kind}"] for kind in camera.kinds})


def draw_controller_seed(generator: np.random.Generator) -> int:
    """Returns a controller's seed for an episode, sampled with the episode's ``generator``."""
    return int(generator.integers(2**31))
