"""Very short trainings."""

from dataclasses import replace

import pytest

from avrgym.learning import configuration as learning_configuration
from avrgym.learning import training


def shorten_training(patch: pytest.MonkeyPatch) -> None:
    """Make trainings use two worlds, one epoch and one evaluation episode."""
    usual = learning_configuration.make_feedforward_configuration
    little = {"num_envs": 2, "batch_size": 100, "n_epochs": 1}
    patch.setattr(
        learning_configuration,
        "make_feedforward_configuration",
        lambda *given, **named: replace(usual(*given, **named), **little),
    )
    patch.setattr(training, "EVALUATION_EPISODES", 1)
