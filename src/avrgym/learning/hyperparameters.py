"""Hyperparameters of every recipe, named as in Stable-Baselines3.

``FeedforwardHyperparameters`` are for feed-forward policies (imitation, then PPO). Users change them with ``avrgym
train --config FILE``. ``TASK_HYPERPARAMETERS`` contains values for specific tasks, ``PAPER_HYPERPARAMETERS`` the
values of ``--recipe paper``. ``IMITATION_HYPERPARAMETERS``, ``RECURRENT_HYPERPARAMETERS`` and
``VISUAL_HYPERPARAMETERS`` contain the fixed values of imitation, ``--recipe adaptive`` and ``--recipe visual``.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from msgspec import Meta

from avrgym.tasks.registry import TASKS, find_environment

UnitInterval = Annotated[float, Meta(ge=0.0, le=1.0)]


@dataclass(frozen=True, kw_only=True)
class FeedforwardHyperparameters:
    """Hyperparameters of a feed-forward policy: imitation of the task's expert, then PPO.

    Network and PPO are those of the paper (section V). The finished policy has the ``log_std`` of its last update.
    """

    num_envs: Annotated[
        int, Meta(ge=1, description="worlds that are stepped together; each makes one episode per update")
    ] = 32
    batch_size: Annotated[int, Meta(ge=2, description="control steps in a minibatch of PPO")] = 320
    n_epochs: Annotated[int, Meta(ge=1, description="passes of PPO over the steps of an update")] = 10
    learning_rate: Annotated[
        float,
        Meta(gt=0.0, description="learning rate of PPO at its start; decreases linearly to a hundredth"),
    ] = 3e-4
    gamma: Annotated[UnitInterval, Meta(description="discount factor per control step")] = 0.99
    gae_lambda: Annotated[UnitInterval, Meta(description="λ of generalised advantage estimation")] = 0.95
    clip_range: Annotated[
        float, Meta(gt=0.0, description="limit of the change of an action's probability in PPO, as a share")
    ] = 0.2
    ent_coef: Annotated[float, Meta(ge=0.0, description="weight of the entropy in PPO's loss")] = 0.0
    vf_coef: Annotated[float, Meta(ge=0.0, description="weight of the value function in PPO's loss")] = 0.5
    max_grad_norm: Annotated[float, Meta(gt=0.0, description="limit of the norm of PPO's gradients")] = 0.5
    log_std: Annotated[
        tuple[float, float],
        Meta(
            description="exploration noise: natural logarithm of the standard deviation of actions (action_std) "
            "at the start and the end of PPO"
        ),
    ] = (-1.5, -3.0)
    net_arch: Annotated[
        tuple[Annotated[int, Meta(ge=1)], ...],
        Meta(min_length=1, description="units of the hidden layers of actor and critic"),
    ] = (64, 64)
    imitation_rounds: Annotated[
        int, Meta(ge=0, description="updates at the start that imitate the expert instead of PPO")
    ] = 8
    imitation_share: Annotated[
        UnitInterval, Meta(description="upper limit of imitation's share of all steps")
    ] = 0.5
    critic_updates: Annotated[
        int, Meta(ge=0, description="updates after imitation in which only the critic learns")
    ] = 5
    force_weight_per_n: Annotated[
        float,
        Meta(
            ge=0.0,
            description="reward penalty per newton on the person, in addition to the task's own; grows from 0 to "
            "this value over the second third of PPO",
        ),
    ] = 0.03
    detour_weight_per_m: Annotated[
        float, Meta(ge=0.0, description="reward penalty per metre of detour of the tool around the arm")
    ] = 0.0
    hard_share: Annotated[
        UnitInterval,
        Meta(
            description="upper limit of the share of worlds that repeat failed episodes in an update of PPO; "
            "reported rewards leave these out"
        ),
    ] = 0.0


TASK_HYPERPARAMETERS: Mapping[str, Mapping[str, Any]] = {
    "Feeding": {"imitation_rounds": 0, "log_std": (-0.7, -2.5)},
    "Drinking": {
        "imitation_rounds": 24,
        "log_std": (-2.2, -3.0),
        "critic_updates": 3,
        "learning_rate": 1e-4,
    },
    "ScratchItch": {
        "num_envs": 128,
        "batch_size": 1280,
        "imitation_rounds": 15,
        "log_std": (-1.9, -2.5),
        "force_weight_per_n": 0.05,
        "detour_weight_per_m": 5.0,
        "hard_share": 0.5,
    },
    "BedBathing": {
        "imitation_rounds": 100,
        "imitation_share": 1.0,
        "log_std": (-3.0, -3.0),
        "learning_rate": 1e-4,
        "force_weight_per_n": 0.0,
    },
    "ArmManipulation": {
        "imitation_rounds": 12,
        "imitation_share": 1.0,
        "log_std": (-2.5, -3.0),
        "learning_rate": 1e-4,
    },
}
"""Values that differ from the defaults, by task. Tasks of other packages define them in ``Task.hyperparameters``."""

PAPER_HYPERPARAMETERS = FeedforwardHyperparameters(
    num_envs=1024,
    batch_size=5120,
    imitation_rounds=0,
    imitation_share=0.0,
    critic_updates=0,
    log_std=(-0.7, -2.5),
    force_weight_per_n=0.0,
    detour_weight_per_m=0.0,
    hard_share=0.0,
)
"""The paper's recipe, the same for every task: PPO alone, with the tasks' own rewards.

The paper does not report the exploration noise and the number of episodes per update. ``log_std`` is that of the task
Feeding.
"""
PAPER_TRAINING_STEPS = 10_000_000
"""Environment steps of each training run in the paper (section VI)."""
DEFAULT_TRAINING_STEPS = 1_000_000
"""Default number of environment steps for training a feed-forward policy."""


@dataclass(frozen=True, kw_only=True)
class ImitationHyperparameters:
    """Hyperparameters of imitation by a feed-forward policy. After each round, Adam minimises the squared error of
    actions over the demonstrations of all rounds."""

    expert_fraction: float = 0.8
    """Share of worlds that the expert controls, relative to the previous round. In the first round the expert
    controls all worlds.
    """
    batch_size: int = 1024
    n_epochs: int = 10
    final_round_n_epochs: int = 100
    """Number of epochs of the fit after the last round. ``n_epochs`` is the number after each other round."""
    learning_rate: float = 1e-3
    lr_decay: float = 0.3
    final_round_lr_decay: float = 0.01
    """Final learning rate of the last round's fit, relative to ``learning_rate``. ``lr_decay`` is the value for each
    other round.
    """


@dataclass(frozen=True, kw_only=True)
class RecurrentHyperparameters:
    """Hyperparameters of a recurrent policy (``--recipe adaptive``): imitation, then PPO.

    PPO's learning rate after imitation is low. With a higher rate, the policy would forget the imitated behaviour.
    """

    bptt_steps: int = 50
    """Horizon of truncated backpropagation through time, in control steps."""

    imitation_share: float = 0.25
    """Default share of imitation updates in all updates."""
    expert_fraction: float = 0.7
    """Share of worlds that the expert controls, relative to the previous round; 1 in the first round."""
    imitation_minibatch_episodes: int = 32
    """Number of episodes in a minibatch of imitation."""
    gradient_steps: int = 40
    final_round_gradient_steps: int = 1500
    """Number of gradient steps after the last round of imitation. ``gradient_steps`` is the number after each other
    round.
    """
    imitation_learning_rate: float = 1e-3
    lr_decay: float = 0.3
    final_round_lr_decay: float = 0.01
    """Final learning rate of the last round's fit, relative to ``imitation_learning_rate``. ``lr_decay`` is the value
    for each other round.
    """
    imitation_max_grad_norm: float = 1.0

    learning_rate: float = 3e-5
    learning_rate_without_imitation: float = 1e-4
    final_lr_fraction: float = 0.02
    """Final learning rate of PPO, relative to the initial one. The learning rate decreases linearly."""
    gamma: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    n_epochs: int = 4
    minibatch_episodes: int = 16
    max_minibatches: int = 8
    """Maximum number of minibatches in an epoch of PPO. ``minibatch_episodes`` is the number of episodes in a
    minibatch.
    """
    target_kl: float = 0.03
    """Limit of the mean Kullback-Leibler divergence between old and new policy. If an epoch exceeds it, the update
    ends.
    """
    max_grad_norm: float = 0.5
    critic_memory_size: int = 64
    critic_net_arch: tuple[int, ...] = (64,)
    critic_learning_rate: float = 1e-3
    critic_only_updates: int = 4
    """Number of updates after imitation in which only the critic learns."""
    log_std: tuple[float, float] = (-2.3, -2.6)
    """Natural logarithm of the action standard deviation at the start and the end of PPO."""
    candidate_action_stds: tuple[float, ...] = (0.0, 0.05, 0.08)
    """Candidates for the action standard deviation of the trained policy. The one with the highest success rate is
    selected.
    """

    force_weight_per_n: float = 0.02
    """Reward penalty per newton on the person in PPO, in addition to the task's reward terms."""
    max_rewarded_force_n: float = 1.5
    """Force on the person in newtons above which PPO's reward for force does not increase."""
    overload_weight: float = 5.0
    """Reward penalty in PPO for a force at the transient limit of a body region, see ``rollouts.RolloutRequest``."""


@dataclass(frozen=True, kw_only=True)
class VisualHyperparameters:
    """Hyperparameters of a policy with vision, which imitates a teacher (``--recipe visual``)."""

    episode_steps: int = 32
    """Number of control steps of each episode in training. Most of the teacher's episodes succeed earlier."""
    expert_fraction: float = 0.5
    """Share of worlds that the teacher controls, relative to the previous round; 1 in the first round."""
    teacher_noise_std: float = 0.3
    """Standard deviation of the noise on the teacher's actions."""
    action_loss_weight: float = 2.0
    """Weight of the squared error of actions in the loss. The error of the normalised estimates has weight 1."""
    batch_size: int = 128
    gradient_steps: int = 500
    final_round_gradient_steps: int = 4000
    """Number of gradient steps after the last round. ``gradient_steps`` is the number after each other round."""
    learning_rate: float = 1e-3
    lr_decay: float = 0.3
    final_round_lr_decay: float = 0.01
    """Final learning rate of the last round's fit, relative to ``learning_rate``. ``lr_decay`` is the value for each
    other round.
    """


IMITATION_HYPERPARAMETERS = ImitationHyperparameters()
RECURRENT_HYPERPARAMETERS = RecurrentHyperparameters()
VISUAL_HYPERPARAMETERS = VisualHyperparameters()


def make_hyperparameters(environment: str) -> FeedforwardHyperparameters:
    """Returns the hyperparameters of feed-forward policies in an environment.

    Raises:
        ValueError: for an unknown environment. The message contains the allowed ids.
    """
    task, _ = find_environment(environment)
    return FeedforwardHyperparameters(**{**TASK_HYPERPARAMETERS.get(task, {}), **TASKS[task].hyperparameters})
