"""What a recorded trial's robot did to each region of the participant's virtual body, found by stepping it again."""

from collections.abc import Callable

from avrgym.recording.reader import Recording
from avrgym.replay.playback import Playback, StateAgain
from avrgym.safety.region_forces import RegionLoadRecorder, RegionLoads


def region_loads(recording: Recording, progress: Callable[[], None] = lambda: None) -> RegionLoads:
    """What the regions bore while the robot was driven, (1, R); ``progress`` is told after each recorded state.

    Raises:
        ReplayError: for a recording that cannot be stepped again.
    """
    playback, watch = Playback(recording, by_region=True), RegionLoadRecorder(1)
    for again in playback.run(follow=True):
        if isinstance(again, StateAgain):
            if playback.driven:
                watch.add(playback.episodes.simulation.region_force_n())
            progress()
    return watch.loads()
