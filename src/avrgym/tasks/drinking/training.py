"""How giving drink is trained."""

from avrgym.tasks.training_settings import TrainingSettings

TRAINING = TrainingSettings(imitation_rounds=24, log_std=(-2.2, -3.0), critic_updates=3, learning_rate=1e-4)
