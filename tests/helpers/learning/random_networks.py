"""Human and robot policies with random weights."""

from pathlib import Path

import numpy as np

from avrgym.networks.policy import Policy, PolicyMetadata, TrainedHumanMetadata
from avrgym.tasks.human_observation import make_human_observer
from avrgym.tasks.registry import get_observation_and_action_size


def random_network(
    environment: str,
    *,
    of_human: bool = True,
    people: str = "revised",
    impairment: str = "none",
    seed: int = 0,
    deviation: float = 0.1,
) -> Policy:
    """Return the policy of a human or a robot with random weights."""
    view, joints = make_human_observer(environment)
    observed, acted = (view.size, joints) if of_human else get_observation_and_action_size(environment)
    random = np.random.default_rng(seed)
    return Policy(
        weights=(random.normal(0.0, 0.5, (observed, acted)),),
        biases=(random.normal(0.0, 0.5, acted),),
        observation_mean=np.zeros(observed),
        observation_variance=np.ones(observed),
        observation_clip=5.0,
        observation_epsilon=1e-8,
        action_std=deviation,
        metadata=PolicyMetadata(
            environment=environment,
            people=people,
            impairment=impairment,
            steps=0,
            seed=seed,
            human=TrainedHumanMetadata(partner="") if of_human else None,
        ),
    )


def save_network(path: Path, policy: Policy) -> str:
    """Save a policy, create missing folders, and return the path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    policy.save(path)
    return str(path)
