"""Rebuilds the world of a recording, and renders its recorded states."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from avrgym.models.cameras import CameraSpec
from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import Recording
from avrgym.tasks.episodes import Episodes


def rebuild_world(configuration: TrialConfiguration, *, by_region: bool = False) -> Episodes:
    """Returns the world of a recording in its initial state. ``by_region``: whether to measure forces by body region.

    Raises:
        ValueError: if the world cannot be created.
    """
    try:
        episodes = Episodes(
            configuration.environment,
            1,
            person=configuration.start_person,
            moving=True,
            num_threads=1,
            by_region=by_region,
            settings=configuration.settings,
        )
        episodes.reset_to_episode_start(configuration.episode_start)
    except KeyError as error:
        raise ValueError(f"the initial state in the recording lacks {error}; restore a backup") from error
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"the recorded world cannot be created: {error}; it was recorded with {configuration.versions}"
        ) from error
    return episodes


def render_recorded_images(
    recording: Recording, cameras: Sequence[CameraSpec]
) -> Iterator[dict[str, np.ndarray]]:
    """Yields the camera images at the start of each control step, by entry name. The images are rendered from the
    recorded states.

    Raises:
        ValueError: if the world cannot be created, or if the recorded states have a different size.
        RuntimeError: if rendering fails.
    """
    episodes = rebuild_world(recording.configuration)
    size = len(episodes.simulation.get_integration_state())
    states: deque[list[float]] = deque(maxlen=episodes.scene.substeps + 1)
    try:
        for topic, _, record in recording.messages:
            if topic == "/physics":
                states.append(record.state)
            elif topic == "/control":
                start = states[0] if states else []
                if len(start) != size:
                    raise ValueError(
                        f"a recorded state has {len(start)} values, but a state of this scene has {size}; install the "
                        f"recorded version: {recording.configuration.versions}"
                    )
                episodes.simulation.set_integration_state(np.array(start))
                yield {name: image[0] for name, image in episodes.render_images(cameras).items()}
    finally:
        episodes.close_renderer()
