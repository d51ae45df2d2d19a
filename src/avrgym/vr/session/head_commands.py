"""Commands from head gestures and gaze of the participant in a trial."""

from collections.abc import Iterator

import numpy as np

from avrgym.commands.head_motion import GazeTimer, HeadGestureDetector
from avrgym.commands.preferences import TrialRules
from avrgym.commands.vocabulary import ALLOWED_COMMANDS_BY_SOURCE, CommandName, CommandSource
from avrgym.safety.pacing import compute_facing_angle_rad
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import TrackingFrameMessage


class HeadCommandDetector:
    """Converts head motion to commands: a nod to ``ready``, a shake to ``wait``.

    While the robot waits, gaze at the tool is the command ``ready``. While the robot continues, gaze away is ``wait``.
    """

    def __init__(self, rules: TrialRules) -> None:
        """Start a trial with these rules. Only the sources in ``rules.sources`` give commands."""
        self._sources = rules.sources
        self._gestures = (
            HeadGestureDetector(rules.thresholds) if {"nod", "shake"} & {*rules.sources} else None
        )
        self._gaze = GazeTimer(rules.thresholds) if "gaze" in rules.sources else None
        self._mode = ""

    def detect_gesture_commands(
        self, tracking: TrackingFrameMessage
    ) -> Iterator[tuple[CommandName, CommandSource]]:
        """Yields the commands of gestures that end with this tracking frame, with their sources."""
        if self._gestures is None or tracking.head is None:
            return
        x, y, z, w = tracking.head.orientation
        q = np.array([[w, x, y, z]])
        if not (np.isfinite(q).all() and np.linalg.norm(q) > 0.5):
            return
        for name, done in self._gestures.update(q, tracking.client_time_ms / 1000.0).items():
            if done[0] and name in self._sources:
                yield ALLOWED_COMMANDS_BY_SOURCE[name][0], name

    def detect_gaze_commands(self, world: LiveWorld) -> Iterator[tuple[CommandName, CommandSource]]:
        """Yields the commands from gaze at the tool or away from it. Call it after each control step."""
        if self._gaze is None or world.pacing is None:
            return
        mode = world.pacing.get_mode_name(0)
        if mode != self._mode:
            self._gaze.facing_duration_s[:] = self._gaze.facing_away_duration_s[:] = 0.0
            self._mode = mode
        angle_rad = compute_facing_angle_rad(world.simulation.get_state())
        self._gaze.update(angle_rad, world.scene_config.control_step_s)
        if mode == "waiting" and self._gaze.detect_gaze()[0]:
            yield "ready", "gaze"
        if mode == "continuing" and self._gaze.detect_gaze_away()[0]:
            yield "wait", "gaze"
