"""How policies are trained in a task."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TrainingSettings:
    """What a training run is made of. Network and algorithm are the paper's (section V); the rest is ours.

    The policy first imitates its task's reactive expert for ``imitation_rounds`` episodes in every world, though for no
    more than ``imitation_share`` of all steps. Then only the critic learns for ``critic_updates``.
    ``log_std`` is how random actions are at the beginning and at the end of PPO. The ``learning_rate`` is that of its
    beginning and falls to a hundredth, so that in the end the policy is a mean of many updates. The policy keeps the
    chance of its last update.
    ``force_weight_per_n`` is what each newton on the person takes off a step's reward at the end of PPO, beyond what
    the task's own reward does; it grows over the second third: first the policy learns to help, then to be gentle.
    ``detour_weight_per_m`` is what each metre takes off that the way of tool and hand is longer than straight on.
    ``hard_share`` of the worlds, at most, begin an update of PPO with episodes that went badly before; of how training
    stands they tell nothing.
    """

    worlds: int = 32
    minibatch: int = 320
    epochs: int = 10
    learning_rate: float = 3e-4
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    log_std: tuple[float, float] = (-1.5, -3.0)
    hidden: tuple[int, ...] = (64, 64)
    imitation_rounds: int = 8
    imitation_share: float = 0.5
    critic_updates: int = 5
    force_weight_per_n: float = 0.03
    detour_weight_per_m: float = 0.0
    hard_share: float = 0.0
