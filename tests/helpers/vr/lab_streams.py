"""Lab Streaming Layer outlets on this machine, and a session in real time."""

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from avrgym.vr.protocol.messages import TICK_S
from avrgym.vr.session.session import Session
from helpers.vr.visit import Visit, constant_policies, plan

pylsl = pytest.importorskip("pylsl", reason="`pip install avrgym[lsl]` brings Lab Streaming Layer")

from avrgym.vr.lab_streaming.outlets import SENT_BODIES as SENT_BODIES  # noqa: E402
from avrgym.vr.lab_streaming.streams import LabStreams  # noqa: E402
from avrgym.vr.lab_streaming.streams import open_lab_streams as open_lab_streams  # noqa: E402

LSL_SESSION = f"avrgym-tests-{os.getpid()}"
"""Separates these streams from those of tests that run at the same time."""
RATE_HZ = 200.0
TIMEOUT_S = 60.0

pylsl.set_config_content(
    f"[multicast]\nResolveScope = machine\n[lab]\nSessionID = {LSL_SESSION}\n[log]\nlevel = -3\n"
)


class Device:
    """A device with a constant sample rate. Each sample contains its time and its number."""

    def __init__(self, name: str = "Belt", kind: str = "ECG", rate_hz: float = RATE_HZ) -> None:
        info = pylsl.StreamInfo(name, kind, 2, rate_hz, "double64", f"{name}-of-the-tests")
        info.set_channel_labels(["taken", "number"])
        info.set_channel_units(["s", ""])
        self._outlet = pylsl.StreamOutlet(info)
        self._rate_hz = rate_hz
        self._off = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        began_s, number = pylsl.local_clock(), 0
        while not self._off.wait(0.01):
            while (taken_s := began_s + number / self._rate_hz) < pylsl.local_clock():
                self._outlet.push_sample([taken_s, float(number)], taken_s)
                number += 1

    def turn_off(self) -> None:
        self._off.set()
        self._thread.join()
        del self._outlet  # ends the stream


class LiveVisit(Visit):
    """A visit on the clock of Lab Streaming Layer."""

    def __init__(self, folder: Path, streams: LabStreams) -> None:
        self._began_s = pylsl.local_clock()
        short = plan(free_movement_s=0.05, trial_steps=2)
        super().__init__(
            folder,
            short,
            make=lambda send: Session(
                short,
                constant_policies(short),
                folder,
                send,
                "visit",
                observe=self.observed.append,
                streams=streams,
            ),
        )

    @property
    def began_s(self) -> float:
        """Start of the session on the clock of Lab Streaming Layer."""
        return self._began_s

    @property
    def now_s(self) -> float:
        return pylsl.local_clock() - self._began_s

    def run_live(self, until: Callable[[], bool]) -> None:
        """Tick in real time until a condition is true."""
        discard_attempt = time.monotonic() + TIMEOUT_S
        while not until():
            assert time.monotonic() < discard_attempt, f"still in {self.phase}; problems: {self.problems}"
            self.tick()
            time.sleep(TICK_S / 2)

    def run_live_until(self, phase: str) -> None:
        self.run_live(lambda: self.phase == phase)
