"""A training that was cut off goes on as if nothing had happened: everything its next update depends on, in one file.

The file holds tensors, numbers and text; reading it runs no code. Stable-Baselines3 draws minibatches from NumPy's
global random stream, which therefore belongs to it.
"""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.learning.stable_baselines import go_on_from, normaliser_of
from avrgym.system.files import write_whole


def save(path: Path, model: PPO, native: AssistiveVectorEnv, notes: dict[str, Any]) -> None:
    """Write a checkpoint whole, or nothing. To be called where every world has just begun an episode.

    Args:
        path: the file; an earlier checkpoint is replaced.
        model: what is trained, over a ``VecNormalize``.
        native: the environment below.
        notes: plain values that ``restore`` gives back.
    """
    normaliser = normaliser_of(model)
    state = {
        "steps": model.num_timesteps,
        "updates": model._n_updates,  # pyright: ignore[reportPrivateUsage]
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "observations": _moments(normaliser.obs_rms),
        "returns": _moments(normaliser.ret_rms),
        "torch_random": torch.get_rng_state(),
        "minibatches": json.dumps(np.random.get_state(legacy=False), default=np.ndarray.tolist),  # noqa: NPY002
        "episodes": json.dumps(native.drawn_from),
        "notes": json.dumps(notes),
    }
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_whole(path, buffer.getvalue())


def restore(path: Path, model: PPO, native: AssistiveVectorEnv) -> dict[str, Any]:
    """Bring a model and its environment back to where a checkpoint was saved; give its notes.

    Raises:
        ValueError: for a file that is no checkpoint of such a training.
    """
    try:
        state = torch.load(path, weights_only=True)
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
    except Exception as error:  # torch raises many kinds
        raise ValueError(f"{path}: not a checkpoint of this training ({error})") from error
    model.num_timesteps = state["steps"]
    model._n_updates = state["updates"]  # pyright: ignore[reportPrivateUsage]
    normaliser = normaliser_of(model)
    _set_moments(normaliser.obs_rms, state["observations"])
    _set_moments(normaliser.ret_rms, state["returns"])
    observation = native.begin_again_from(json.loads(state["episodes"]))
    go_on_from(model, observation)
    torch.set_rng_state(state["torch_random"])
    np.random.set_state(_numpy_state(json.loads(state["minibatches"])))  # noqa: NPY002
    return json.loads(state["notes"])


def _moments(statistics: Any) -> dict[str, Any]:
    assert isinstance(statistics, RunningMeanStd)
    return {
        "mean": torch.as_tensor(np.asarray(statistics.mean)),
        "variance": torch.as_tensor(np.asarray(statistics.var)),
        "count": float(statistics.count),
    }


def _set_moments(statistics: Any, moments: dict[str, Any]) -> None:
    assert isinstance(statistics, RunningMeanStd)
    statistics.mean, statistics.var = moments["mean"].numpy(), moments["variance"].numpy()
    statistics.count = moments["count"]


def _numpy_state(state: dict[str, Any]) -> dict[str, Any]:
    state["state"]["key"] = np.array(state["state"]["key"], dtype=np.uint32)
    return state
