"""How feeding is trained."""

from avrgym.tasks.training_settings import TrainingSettings

TRAINING = TrainingSettings(imitation_rounds=0, log_std=(-0.7, -2.5))
