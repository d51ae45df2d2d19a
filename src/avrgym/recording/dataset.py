"""Converts recordings to episodes of LeRobot datasets."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, NumpyArray
from avrgym.learning.lerobot_dataset import DatasetEpisode
from avrgym.recording.reader import Recording
from avrgym.tasks.registry import make_policy_instruction


def make_dataset_episode(
    recording: Recording,
    images: Mapping[str, NumpyArray],
    labels: Mapping[str, Any],
    constants: Mapping[str, bool],
    interventions: BoolArray | None = None,
) -> DatasetEpisode:
    """Returns the control steps of a recording as an episode. The other arguments are fields of the episode."""
    steps = [control for _, control in recording.messages_by_topic["/control"]]
    configuration = recording.configuration
    return DatasetEpisode(
        make_policy_instruction(configuration.environment, configuration.settings),
        observations=np.array([control.observation for control in steps]),
        actions=np.array([control.action for control in steps]),
        rewards=np.array([control.reward for control in steps]),
        successes=np.array([control.success for control in steps]),
        forces_on_person_n=np.array([control.force_on_person_n for control in steps]),
        images=images,
        episode_columns=labels,
        constant_features=constants,
        interventions=interventions,
    )
