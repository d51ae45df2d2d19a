"""Processes of hosted sessions with limits for a busy computer."""

from multiprocessing.connection import Connection

import pytest

from avrgym.hosting.session_process import SessionRequest, run_session
from helpers.vr.time_limits import RELAXED_LIMITS, set_limits

LIMITS = (
    *RELAXED_LIMITS,
    "avrgym.vr.headset_check:MAX_DROPPED_SHARE=1",
    "avrgym.vr.headset_check:MAX_LATENCY_MS=inf",
    "avrgym.vr.headset_check:MIN_TRACKED_SHARE=0",
    "avrgym.vr.headset_check:MIN_DISPLAY_HZ=0",
    "avrgym.vr.headset_check:MIN_RENDERED_FRAMES=1",
)
"""Limits with which the headset check accepts a browser that draws in software."""


def run_slow_session(request: SessionRequest, pipe: Connection) -> None:
    """Run a session as ``run_session`` does, with ``LIMITS``."""
    with pytest.MonkeyPatch.context() as patch:
        set_limits(LIMITS, patch)
        run_session(request, pipe)
