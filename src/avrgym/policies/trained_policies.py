"""Trained robot policies: packaged policies have names; other policies are files."""

import os
import re
from pathlib import Path

from avrgym.models.cameras import parse_camera
from avrgym.networks.policy import POLICY_FILE_SUFFIX, Policy, PolicyError, PolicyMetadata

__all__ = [
    "PACKAGED_POLICY_FOLDER",
    "POLICY_FILE_SUFFIX",
    "Policy",
    "PolicyError",
    "PolicyMetadata",
    "find_packaged_policies",
    "find_policy_file",
    "load_policy",
]

PACKAGED_POLICY_FOLDER = Path(__file__).parents[1] / "assets" / "policies"


def find_packaged_policies(environment_id: str) -> dict[str, Path]:
    """Returns the paths of an environment's packaged policies, by name of the policy."""
    scene = re.sub(r"^avrgym/|-v\d+$", "", environment_id)
    files = sorted(PACKAGED_POLICY_FOLDER.glob(f"{scene}-*.safetensors"))
    return {file.stem.removeprefix(f"{scene}-"): file for file in files}


def find_policy_file(name_or_path: str | os.PathLike[str], environment_id: str) -> Path:
    """Returns the file of a packaged policy, given its name (such as ``original``), or the given path.

    Raises:
        PolicyError: if there is no policy with this name and no file with this path.
    """
    packaged = find_packaged_policies(environment_id)
    if str(name_or_path) in packaged:
        return packaged[str(name_or_path)]
    if Path(name_or_path).is_file():
        return Path(name_or_path)
    names = ", ".join(packaged) or "no packaged policy"
    raise PolicyError(
        f"no policy {str(name_or_path)!r} for {environment_id}; "
        f"allowed: {names}, or the path of a .safetensors file"
    )


def load_policy(
    name_or_path: str | os.PathLike[str],
    environment_id: str,
    observation_size: int,
    action_size: int,
    *,
    allow_other_environment: bool = False,
) -> Policy:
    """Load and return a policy by name or path, for an environment with observations and actions of the given sizes.

    Raises:
        PolicyError: for an unknown name, a damaged file, wrong sizes, or the policy of a trained human. Also for a
            policy of another environment, unless ``allow_other_environment`` is true.
    """
    path = find_policy_file(name_or_path, environment_id)
    policy = Policy.load(path)
    if policy.metadata.human is not None:
        raise PolicyError(f"{path} is the policy of a trained human, not of a robot; use it with --people")
    if policy.metadata.environment != environment_id and not allow_other_environment:
        raise PolicyError(
            f"{path}: trained for {policy.metadata.environment}, not for {environment_id}; "
            "allowed only with `avrgym evaluate --allow-other-environment`"
        )
    if policy.vision is not None:
        _check_vision(policy, path)
    sizes = (policy.observation_size, policy.action_size)
    if sizes != (observation_size, action_size):
        raise PolicyError(
            f"{path}: was trained for {policy.metadata.environment} with {sizes[0]} observations and {sizes[1]} "
            f"actions; {environment_id} needs {observation_size} observations and {action_size} actions"
        )
    return policy


def _check_vision(policy: Policy, path: Path) -> None:
    """Raises ``PolicyError`` if the policy's vision does not match the images of its camera."""
    assert policy.vision is not None
    try:
        camera = parse_camera(policy.metadata.camera)
        channels = sum(3 if kind == "rgb" else 1 for kind in camera.kinds)
        policy.vision.check_shapes(policy.observation_size, (camera.height_px, camera.width_px, channels))
    except ValueError as error:
        raise PolicyError(f"{path}: {error}") from error
