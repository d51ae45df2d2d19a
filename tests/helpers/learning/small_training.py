"""Trainings that only show that they run."""

from dataclasses import replace

import pytest

from avrgym.learning import training


def train_little(patch: pytest.MonkeyPatch) -> None:
    """Have trainings take two worlds and one epoch, and be measured by one episode."""
    usual = training.configuration_for
    little = {"worlds": 2, "minibatch": 100, "epochs": 1}
    patch.setattr(
        training, "configuration_for", lambda *given, **named: replace(usual(*given, **named), **little)
    )
    patch.setattr(training, "MEASURED_EPISODES", 1)
