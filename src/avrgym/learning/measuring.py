"""What a trained policy reaches, written into its own file."""

from dataclasses import replace
from pathlib import Path

import msgspec

from avrgym.learning.evaluation import evaluate
from avrgym.learning.seed_streams import CHOOSING
from avrgym.policies.trained import Policy

MEASURES = ("episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")


def measure(path: Path, people: str, impairment: str, episodes: int, *, human: Path | None = None) -> Policy:
    """Write into a policy's file what it reaches on the stream of choices, and into its human's; gives that policy."""
    policy = Policy.load(path)
    figures = evaluate(
        policy.metadata.environment,
        str(path),
        people,
        episodes,
        seed=0,
        impairment=impairment,
        stream=CHOOSING,
    )
    measured = {name: getattr(figures, name) for name in MEASURES}
    for file in [path] if human is None else [human, path]:
        policy = Policy.load(file)
        policy = replace(policy, metadata=msgspec.structs.replace(policy.metadata, measured=measured))
        policy.save(file, overwrite=True)
    return policy
