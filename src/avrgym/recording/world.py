"""Rebuilds the world of a recording, and renders its states."""

from collections.abc import Iterator, Sequence

import numpy as np

from avrgym.models.cameras import CameraSpec
from avrgym.recording.configuration import Configuration
from avrgym.recording.reader import Recording
from avrgym.tasks.episodes import Episodes


def recorded_world(configuration: Configuration, *, by_region: bool = False) -> Episodes:
    """The world at the start of a recording; ``by_region`` as for ``Episodes``.

    Raises:
        ValueError: if it cannot be made.
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
        episodes.reset_to_start(configuration.start)
    except KeyError as error:
        raise ValueError(f"its initial state lacks {error}") from error
    except (TypeError, ValueError) as error:
        raise ValueError(f"the recorded world cannot be created: {error}") from error
    return episodes


def recorded_images(recording: Recording, cameras: Sequence[CameraSpec]) -> Iterator[dict[str, np.ndarray]]:
    """Images of the start of each control step, from the recorded states; physics does not run.

    Raises:
        ValueError: if the world cannot be made, or has other states.
        RuntimeError: if nothing can be rendered.
    """
    episodes = recorded_world(recording.configuration)
    size = len(episodes.simulation.integration_state())
    states: list[list[float]] = []
    try:
        for topic, _, record in recording.messages:
            if topic == "/physics":
                states.append(record.state)
            elif topic == "/control":
                start = states[max(0, len(states) - 1 - episodes.scene.substeps)] if states else []
                if len(start) != size:
                    raise ValueError(f"its states have {len(start)} numbers; this scene has {size}")
                episodes.simulation.set_integration_state(np.array(start))
                yield {name: image[0] for name, image in episodes.images(cameras).items()}
    finally:
        episodes.close_images()
