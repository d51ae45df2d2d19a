"""How policies are trained in a task."""

from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

Share = Annotated[float, Meta(ge=0.0, le=1.0)]


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """What a training run is made of: what each field means, in which limits, and what it is unless a task differs.

    Network and algorithm are the paper's (section V); the rest is ours. The policy first imitates its task's reactive
    expert; then PPO goes on. The learning rate falls to a hundredth, so that in the end the policy is a mean of many
    updates. The policy keeps the chance of its last update.
    """

    worlds: Annotated[
        int, Meta(ge=1, description="worlds stepped together; each makes an episode an update")
    ] = 32
    minibatch: Annotated[int, Meta(ge=2, description="control steps of one step of PPO's optimizer")] = 320
    epochs: Annotated[int, Meta(ge=1, description="how often PPO goes through an update's steps")] = 10
    learning_rate: Annotated[
        float, Meta(gt=0.0, description="of PPO at its beginning; falls to a hundredth")
    ] = 3e-4
    discount: Annotated[Share, Meta(description="of rewards, for each control step")] = 0.99
    gae_lambda: Annotated[Share, Meta(description="of generalised advantage estimation")] = 0.95
    clip_range: Annotated[
        float, Meta(gt=0.0, description="how far PPO changes an action's chance, as a share")
    ] = 0.2
    log_std: Annotated[
        tuple[float, float],
        Meta(description="logarithm of how random actions are, at the beginning and the end of PPO"),
    ] = (-1.5, -3.0)
    hidden: Annotated[
        tuple[Annotated[int, Meta(ge=1)], ...],
        Meta(min_length=1, description="units of the network's hidden layers"),
    ] = (64, 64)
    imitation_rounds: Annotated[
        int, Meta(ge=0, description="episodes in every world that imitate the expert, first of all")
    ] = 8
    imitation_share: Annotated[Share, Meta(description="of all steps that imitation takes at most")] = 0.5
    critic_updates: Annotated[
        int, Meta(ge=0, description="updates after imitation in which only the critic learns")
    ] = 5
    force_weight_per_n: Annotated[
        float,
        Meta(
            ge=0.0,
            description="what each newton on the person takes off a step's reward at the end of PPO, beyond the "
            "task's own; it grows over the second third: first the policy learns to help, then to be gentle",
        ),
    ] = 0.03
    detour_weight_per_m: Annotated[
        float,
        Meta(ge=0.0, description="what each metre takes off that tool and hand go farther than straight on"),
    ] = 0.0
    hard_share: Annotated[
        Share,
        Meta(
            description="of the worlds, at most, that begin an update of PPO with episodes that went badly before; "
            "what training tells of itself leaves them out"
        ),
    ] = 0.0
