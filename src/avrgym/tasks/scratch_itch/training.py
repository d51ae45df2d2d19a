"""How scratching is trained."""

from avrgym.tasks.training_settings import TrainingSettings

TRAINING = TrainingSettings(
    worlds=128,
    minibatch=1280,
    imitation_rounds=15,
    log_std=(-1.9, -2.5),
    force_weight_per_n=0.05,
    detour_weight_per_m=5.0,
    hard_share=0.5,
)
