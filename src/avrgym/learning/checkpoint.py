"""A training that was cut off goes on as if nothing had happened: everything its next update depends on, in one file.

The file holds tensors, numbers and text; reading it runs no code. Stable-Baselines3 draws minibatches from NumPy's
global random stream, which therefore belongs to it.
"""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.running_mean_std import RunningMeanStd

from avrgym.learning.stable_baselines import Normaliser, Trainee
from avrgym.system.files import write_whole


def save(
    path: Path, trainees: Sequence[Trainee[Normaliser]], episodes: list[dict[str, Any]], notes: dict[str, Any]
) -> None:
    """Write a checkpoint whole, or nothing. To be called between two updates.

    Args:
        path: the file; an earlier checkpoint is replaced.
        trainees: what is trained, the robot and perhaps a human.
        episodes: states of random streams that the present episodes were drawn from, one a world, where the next
            update goes on with them.
        notes: plain values that ``restore`` gives back.
    """
    robot, *humans = trainees
    state = {
        **_state_of(robot),
        "torch_random": torch.get_rng_state(),
        "minibatches": json.dumps(np.random.get_state(legacy=False), default=np.ndarray.tolist),  # noqa: NPY002
        "episodes": json.dumps(episodes),
        "notes": json.dumps(notes),
    }
    if humans:
        state["human"] = _state_of(humans[0])
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_whole(path, buffer.getvalue())


def _state_of(trainee: Trainee[Normaliser]) -> dict[str, Any]:
    model, normaliser = trainee
    return {
        "steps": model.num_timesteps,
        "updates": model._n_updates,  # pyright: ignore[reportPrivateUsage]
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "observations": moments(normaliser.obs_rms),
        "returns": moments(normaliser.ret_rms),
    }


def restore(
    path: Path, trainees: Sequence[Trainee[Normaliser]]
) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Bring what is trained back to where a checkpoint was saved; give its episodes and notes.

    Raises:
        ValueError: for a file that is no checkpoint of such a training.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
        kept = [state, *([state["human"]] if len(trainees) > 1 else [])]
        for trainee, each in zip(trainees, kept, strict=True):
            trainee.model.policy.load_state_dict(each["policy"])
            trainee.model.policy.optimizer.load_state_dict(each["optimizer"])
    except Exception as error:  # torch raises many kinds
        raise ValueError(f"{path}: not a checkpoint of this training ({error})") from error
    for (model, normaliser), each in zip(trainees, kept, strict=True):
        model.num_timesteps = each["steps"]
        model._n_updates = each["updates"]  # pyright: ignore[reportPrivateUsage]
        set_moments(normaliser.obs_rms, each["observations"])
        set_moments(normaliser.ret_rms, each["returns"])
    torch.set_rng_state(state["torch_random"])
    np.random.set_state(_numpy_state(json.loads(state["minibatches"])))  # noqa: NPY002
    return json.loads(state["episodes"]), json.loads(state["notes"])


def moments(statistics: Any) -> dict[str, Any]:
    """A normaliser's statistics, as a checkpoint keeps them."""
    assert isinstance(statistics, RunningMeanStd)
    return {
        "mean": torch.as_tensor(np.asarray(statistics.mean)),
        "variance": torch.as_tensor(np.asarray(statistics.var)),
        "count": float(statistics.count),
    }


def set_moments(statistics: Any, kept: dict[str, Any]) -> None:
    """Bring statistics back to what ``moments`` gave."""
    assert isinstance(statistics, RunningMeanStd)
    statistics.mean, statistics.var = kept["mean"].numpy(), kept["variance"].numpy()
    statistics.count = kept["count"]


def _numpy_state(state: dict[str, Any]) -> dict[str, Any]:
    state["state"]["key"] = np.array(state["state"]["key"], dtype=np.uint32)
    return state
