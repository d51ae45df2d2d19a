"""A session in headless Chromium with an emulated headset, the real server and physics."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from avrgym.vr.emulation.emulated_headset import EmulatedHeadset
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session.plan import SessionPlan, SessionPolicies
from avrgym.vr.session.session import Session

TIMEOUT_S = 180.0
SEATING = ("calibration", "loading", "check")
"""Phases before the first trial."""
TRIAL = ("free_before", "countdown", "trial", "retreat", "free_after", "questionnaire")
"""Phases of a trial in order. All except the last end automatically."""
WATCH_SCENES = """
window.scenes = [];
window.__THREE_DEVTOOLS__ = new EventTarget();
__THREE_DEVTOOLS__.addEventListener("observe", ({ detail }) => detail.isScene && scenes.push(detail));
"""
"""Collects the scenes that three.js announces to developer tools."""
DRAW_LITTLE = """() => {
    const next = window.requestAnimationFrame.bind(window);
    const asked = new Map();
    let number = 0;
    const draw = (own) => next((now) => {
        const frame = asked.get(own);
        asked.delete(own);
        frame?.(now);
    });
    window.requestAnimationFrame = (frame) => {
        const own = ++number;
        asked.set(own, frame);
        setTimeout(draw, 30, own);
        return own;
    };
    window.cancelAnimationFrame = (own) => asked.delete(own);
    const drawing = ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"];
    for (const name of [...drawing, "clear", "clearBufferfv", "clearBufferfi", "blitFramebuffer"]) {
        const draw = WebGL2RenderingContext.prototype[name];
        WebGL2RenderingContext.prototype[name] = function (...given) {
            if (window.drawsTriangles) draw.apply(this, given);
        };
    }
}"""


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait until a condition is true."""
    discard_attempt = time.monotonic() + TIMEOUT_S
    while not condition():
        assert time.monotonic() < discard_attempt
        time.sleep(0.02)


def finish_phases(headset: EmulatedHeadset, *phases: str) -> None:
    """Press the trigger until the page leaves these consecutive phases.

    A slow page may need several presses. A late press can also end the next phase, so name all phases in one call.
    """
    _wait_for_any(headset, phases)
    while headset.call_emulator("phase")["name"] in phases:
        headset.wait_for_frames(10)
        headset.pull_trigger("right")


def wait_for_phase(headset: EmulatedHeadset, name: str) -> None:
    """Wait until the page shows a phase or a later one of its trial.

    A slow machine can miss a phase that ends automatically.
    """
    _wait_for_any(headset, TRIAL[TRIAL.index(name) :] if name in TRIAL else (name,))


def _wait_for_any(headset: EmulatedHeadset, names: Sequence[str]) -> None:
    headset.page.wait_for_function(
        "([...names]) => names.includes(window.avrgymEmulator?.phase()?.name)",
        arg=list(names),
        timeout=1000 * TIMEOUT_S,
    )


def wait_for_buttons(headset: EmulatedHeadset, item: str) -> None:
    """Wait until the panel shows the buttons of an item, or of the choice ``body``."""
    headset.page.wait_for_function(
        "([item]) => window.avrgymEmulator.buttons()[0]?.item === item",
        arg=[item],
        timeout=1000 * TIMEOUT_S,
    )


def skip_drawing(headset: EmulatedHeadset) -> None:
    """Make the page skip rasterization, which dominates the time of software rendering.

    The page renders every third frame. Tests that compare images call ``draw_triangles``.
    """
    headset.page.add_init_script(f"({DRAW_LITTLE})()")
    headset.page.evaluate(DRAW_LITTLE)


def draw_triangles(headset: EmulatedHeadset) -> None:
    """Rasterize triangles from the next frame on, and wait for that frame."""
    headset.page.evaluate("() => { window.drawsTriangles = true; }")
    headset.wait_for_frames(2)


class Journey:
    """A session on its server, a browser with an emulated headset, and a simulated participant.

    ``observed`` contains the events of the session. Recordings are stored in ``folder``.
    """

    def __init__(
        self,
        folder: Path,
        plan: SessionPlan,
        policies: SessionPolicies,
        opened: ExitStack,
        *,
        draws: bool = False,
        **browser: Any,
    ) -> None:
        """Start server and browser; ``opened`` closes them.

        ``draws``: rasterize triangles from the start. ``browser``: arguments of ``EmulatedHeadset``.
        """
        self.folder = folder
        self.observed: list[read_session_events.SessionEvent] = []
        workers = opened.enter_context(ThreadPoolExecutor(1))

        def make(send) -> Session:
            return Session(
                plan, policies, folder, send, "journey", observe=self.observed.append, workers=workers
            )

        self.server = opened.enter_context(LiveServer(make, "127.0.0.1", 0))
        self.server.export_newest_scene()
        self.headset = opened.enter_context(
            EmulatedHeadset(self.server.participant_url, **{"width": 320, "height": 180, **browser})
        )
        if not draws:
            skip_drawing(self.headset)
        self.participant = SimulatedParticipant(sample_participant_traits(plan.sex, 5), 5, plan.furniture)

    @property
    def session(self) -> Session:
        return self.server.session

    def enter(self) -> None:
        """Enter VR with the participant at rest."""
        self.headset.set_poses(self.participant.make_tracking_frame(0.0, moving=False))
        self.headset.enter_vr()
        self.wait_for_phase("calibration")

    def calibrate(self) -> None:
        """Press the trigger until the participant has completed calibration and body check."""
        self.finish_phases(*SEATING)

    def finish_phases(self, *phases: str) -> None:
        """Press the trigger until the page leaves these consecutive phases."""
        finish_phases(self.headset, *phases)

    def wait_for_phase(self, name: str) -> None:
        """Wait until the page shows a phase or a later one of its trial."""
        wait_for_phase(self.headset, name)

    def wait_for_buttons(self, item: str) -> None:
        """Wait until the panel shows the buttons of an item, or of the choice ``body``."""
        wait_for_buttons(self.headset, item)

    def results(self) -> list[str]:
        """Return the results of the completed attempts."""
        return [each.result for each in self.observed if isinstance(each, read_session_events.TrialEnded)]

    def drop_sockets(self) -> None:
        """Drop every connection to the browser without a close message."""
        for connection in list(self.server._web._uvicorn.server_state.connections):
            connection.loop.call_soon_threadsafe(connection.transport.abort)
