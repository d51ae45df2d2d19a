"""Sends streams with Lab Streaming Layer: events, poses of head, hands and tool, and forces on the person."""

from pathlib import Path
from socket import gethostname

import msgspec
import pylsl

from avrgym.models.human import PERSON_NAME_PREFIX
from avrgym.safety.limits import BODY_REGIONS
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import TICK_S
from avrgym.vr.session.device_streams import STATE_SEND_INTERVAL_TICKS
from avrgym.vr.session.events import SessionEvent

SEND_RATE_HZ = 1.0 / (STATE_SEND_INTERVAL_TICKS * TICK_S)
"""Sample rate of poses and forces, in Hz."""
SENT_BODIES = {
    "head": f"{PERSON_NAME_PREFIX}head",
    "left_hand": f"{PERSON_NAME_PREFIX}left_hand",
    "right_hand": f"{PERSON_NAME_PREFIX}right_hand",
    "tool": "robot/tool",
}
"""Name of the body of each sent pose, by the pose's name in the stream."""
POSE_CHANNEL_UNITS = {"x": "m", "y": "m", "z": "m", "qw": "", "qx": "", "qy": "", "qz": ""}
"""The channels of a pose in the world frame (z up), with their units."""
SEND_BUFFER_DURATION_S = 10
"""Duration in seconds of the samples in the send buffer."""


class Outlets:
    """Sends three streams: ``AVR Gym events`` (JSON), ``AVR Gym poses`` and ``AVR Gym forces``.

    The stream of poses contains simulated bodies in the world frame. Forces are in newtons, with one channel for each
    body region.
    """

    def __init__(self) -> None:
        poses = {f"{name}_{part}": unit for name in SENT_BODIES for part, unit in POSE_CHANNEL_UNITS.items()}
        self._events = _outlet("events", "Markers", {"event": ""}, 0.0, pylsl.cf_string)
        self._poses = _outlet("poses", "MoCap", poses, SEND_RATE_HZ, pylsl.cf_float32)
        self._forces = _outlet(
            "forces", "Force", {region.name: "N" for region in BODY_REGIONS}, SEND_RATE_HZ, pylsl.cf_float32
        )

    def send_event(self, event: SessionEvent, time_s: float) -> None:
        """Send an event. ``time_s``: its time on Lab Streaming Layer's clock."""
        self._events.push_sample([encode_event(event)], time_s)

    def send_state(self, world: LiveWorld, time_s: float) -> None:
        """Send poses and forces. ``time_s``: their time on Lab Streaming Layer's clock."""
        simulation = world.simulation
        rows = [world.bodies.index(body) for body in SENT_BODIES.values()]
        self._poses.push_sample(simulation.get_body_poses(0)[rows].ravel().tolist(), time_s)
        self._forces.push_sample(simulation.compute_region_force_n()[0].tolist(), time_s)


def encode_event(event: SessionEvent) -> str:
    """Returns an event as JSON text: its type and its fields, without the time."""
    fields: dict[str, object] = msgspec.to_builtins(event, enc_hook=_file_name)
    del fields["time_s"]
    return msgspec.json.encode({"event": type(event).__name__, **fields}).decode()


def _file_name(recording: Path) -> str:
    return recording.name


def _outlet(
    what: str, kind: str, channels: dict[str, str], rate_hz: float, number_format: int
) -> pylsl.StreamOutlet:
    source = f"avrgym-{what}-{gethostname()}"
    info = pylsl.StreamInfo(f"AVR Gym {what}", kind, len(channels), rate_hz, number_format, source)
    info.set_channel_labels(list(channels))
    info.set_channel_units(list(channels.values()))
    return pylsl.StreamOutlet(info, max_buffered=SEND_BUFFER_DURATION_S)
