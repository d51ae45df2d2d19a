"""How washing is trained."""

from avrgym.tasks.training_settings import TrainingSettings

TRAINING = TrainingSettings(
    imitation_rounds=100,
    imitation_share=1.0,
    log_std=(-3.0, -3.0),
    learning_rate=1e-4,
    force_weight_per_n=0.0,
)
