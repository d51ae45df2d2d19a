"""What a standalone headset can bear, in all environments, and a session at length: `make soak`.

``SOAK_MINUTES`` is how long the session lasts.
"""

import os
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest

from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.recording.reader import read_recording
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation import emulated_headset
from avrgym.vr.emulation.emulated_headset import BrowserClient
from avrgym.vr.latency import TOTAL, percentiles_ms
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.browser.journey import Journey

METER = (Path(__file__).parents[1] / "helpers/browser/page_meter.js").read_text("utf-8")
pytestmark = pytest.mark.usefixtures("unhurried", "patient")
MINUTES = float(os.environ.get("SOAK_MINUTES", "60"))
SHARE_WARM = 0.25
"""Of a long session; by then every scene has been shown and every function compiled."""
MOST_GPU_BYTES, MOST_CALLS, MOST_TRIANGLES = 40 << 20, 250, 500_000
MOST_SCRIPT_MS, MOST_SHOWN_MS = 2.0, 1000.0
MOST_SERVER_GROWTH, MOST_PAGE_GROWTH = 32 << 20, 2 << 20
MOST_PARTED_MS = 5.0
MEASURED_S = 15.0


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Software renderers of busy machines draw all of a room in many seconds."""
    monkeypatch.setattr(emulated_headset, "PATIENCE_S", 600.0)


class Visitor(BrowserClient):
    """Attends, and looks at memory and clocks now and then."""

    every_s = 10.0

    def __init__(self, journey: Journey) -> None:
        super().__init__(
            journey.headset, journey.session, journey.participant, journey.folder, lambda words: None, {}
        )
        self._looked_s = -np.inf
        self._cdp = journey.headset.page.context.new_cdp_session(journey.headset.page)
        self.held: list[tuple[float, int, int]] = []
        """When, and how many bytes server and page then held."""
        self.ahead_ms: list[float] = []
        """How far the page's clock then was ahead of the server's, but for a constant."""

    def _act(self, question: dict[str, Any] | None, now_s: float) -> None:
        super()._act(question, now_s)
        if now_s > self._looked_s + self.every_s:
            self._looked_s = now_s
            self.held.append((now_s, server_bytes(), self.page_bytes()))
            self.ahead_ms.append(self.page_ahead_ms())

    def page_bytes(self) -> int:
        """What the page's scripts hold after all garbage is collected."""
        self._cdp.send("HeapProfiler.collectGarbage")
        return int(self._cdp.send("Runtime.getHeapUsage")["usedSize"])

    def page_ahead_ms(self) -> float:
        """By the quickest of a few questions, taken to need as long either way."""
        asked = [
            (time.monotonic(), self._headset.page.evaluate("() => performance.now()"), time.monotonic())
            for _ in range(8)
        ]
        before_s, page_ms, after_s = min(asked, key=lambda each: each[2] - each[0])
        return page_ms - 500.0 * (before_s + after_s)


@dataclass(frozen=True)
class Budget:
    """What one environment takes in full detail; calls and triangles are those of both eyes and the shadows.

    ``script_ms`` is how long the page's scripts take for a frame, messages since the one before included, median.
    ``processor_ms`` is the processor's time for all that is script, in a mean frame: the emulator's as well.
    ``shown_ms`` is the longest time from the message that tells of a scene to its being shown.
    """

    environment: str
    calls: int
    triangles: int
    gpu_mb: float
    script_ms: float
    processor_ms: float
    shown_ms: float

    def __str__(self) -> str:
        return (
            f"| {self.environment} | {self.calls} | {self.triangles // 1000} | {self.gpu_mb:.1f} "
            f"| {self.script_ms:.2f} | {self.processor_ms:.2f} | {self.shown_ms:.0f} |"
        )


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_standalone_headset_can_bear_it(environment: str, tmp_path: Path) -> None:
    """While the participant may move freely: the first scene is the one of the plan, the second has their height."""
    trial = TrialPlan(environment, "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 600.0, simulated=True)
    with ExitStack() as opened:
        how = {
            "width": 640,
            "height": 360,
            "query": "&detail=full",
            "script": f"{METER}; pageMeter.idle = true;",
        }
        journey = Journey(tmp_path, plan, load_policies(plan), opened, draws=True, **how)
        journey.headset.page.evaluate("() => pageMeter.watchFrames()")
        journey.enter()
        journey.calibrate()
        journey.wait_for_phase("free_before")
        budget = measured(journey, environment)
    print(f"\n{budget}", end="")
    assert budget.gpu_mb * (1 << 20) <= MOST_GPU_BYTES
    assert budget.calls <= MOST_CALLS
    assert budget.triangles <= MOST_TRIANGLES
    assert budget.script_ms <= MOST_SCRIPT_MS
    assert budget.shown_ms <= MOST_SHOWN_MS


def measured(journey: Journey, environment: str) -> Budget:
    """The page's frames without the software renderer's work: what the GPU is told to draw it does not draw."""
    page = journey.headset.page
    cdp = page.context.new_cdp_session(page)
    cdp.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.evaluate("() => { pageMeter.frames.length = 0; }")
    spent_s, drawn = script_s(cdp), journey.headset.call("framesDrawn")
    time.sleep(MEASURED_S)
    spent_s, drawn = script_s(cdp) - spent_s, journey.headset.call("framesDrawn") - drawn
    meter = page.evaluate(
        "() => ({ bytes: pageMeter.bytes, frames: pageMeter.frames, scenes: pageMeter.scenes,"
        " largest: pageMeter.largest() })"
    )
    largest = ", ".join(f"{each / (1 << 20):.1f}" for each in meter["largest"])
    shown = ", ".join(f"{each:.0f}" for each in meter["scenes"])
    print(f"\n{drawn} frames; the largest on the GPU, MiB: {largest}; scenes shown after {shown} ms", end="")
    return Budget(
        environment=environment.removeprefix("avrgym/").removesuffix("-v1"),
        calls=max(frame["calls"] for frame in meter["frames"]),
        triangles=round(max(frame["triangles"] for frame in meter["frames"])),
        gpu_mb=meter["bytes"] / (1 << 20),
        script_ms=median(frame["ms"] for frame in meter["frames"]),
        processor_ms=1000.0 * spent_s / drawn,
        shown_ms=max(meter["scenes"]),
    )


def script_s(cdp: Any) -> float:
    """The processor time that the page's scripts have taken so far."""
    metrics = {each["name"]: each["value"] for each in cdp.send("Performance.getMetrics")["metrics"]}
    return float(metrics["ScriptDuration"])


def test_a_long_session_at_90_hz_keeps_memory_flat_and_clocks_together(tmp_path: Path) -> None:
    """Trials in all environments one after another, tracked at 90 Hz, until the time is over."""
    environments = list(ENVIRONMENTS)
    trials = [
        TrialPlan(environments[seed % len(environments)], "revised", seed, practice=False)
        for seed in range(round(60 * MINUTES))
    ]
    plan = SessionPlan(
        trials, "woman", 2.0, simulated=True, items=LIKERT_ITEMS[:1], trial_steps=100, countdown_s=1.0
    )
    ends_s = time.monotonic() + 60.0 * MINUTES
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened)
        visitor = Visitor(journey)
        journey.session._ended_elsewhere = lambda: time.monotonic() > ends_s
        visitor.run()
        ways = [latency_ms(path) for path in journey.session.recordings]
        sent, missed = journey.headset.call("trackingSent"), journey.server.loop.missed_ticks
    lasted_s = visitor.held[-1][0]
    print(
        f"\n{lasted_s / 60:.1f} minutes, {len(ways)} trials, {sent / lasted_s:.0f} frames of tracking a second"
    )
    warm = [each for each in visitor.held if each[0] > SHARE_WARM * lasted_s]
    middle = len(warm) // 2
    for name, column, most in (("server", 1, MOST_SERVER_GROWTH), ("page", 2, MOST_PAGE_GROWTH)):
        early, late = (median(each[column] for each in half) for half in (warm[:middle], warm[middle:]))
        print(f"{name}: {early / 2**20:.1f} MiB, in the later half {(late - early) / 2**20:+.2f} MiB")
        assert late - early < most
    parted_ms = median(visitor.ahead_ms[-5:]) - median(visitor.ahead_ms[:5])
    print(f"clocks: the page's gained {parted_ms:+.2f} ms on the server's")
    assert abs(parted_ms) < MOST_PARTED_MS
    told = [each for each in ways if each]
    quarter = max(len(told) // 4, 1)
    for stage in ("up_ms", "down_ms", TOTAL):
        early, late = (
            median(each[stage]["p50"] for each in some) for some in (told[:quarter], told[-quarter:])
        )
        print(f"{stage}: median {early:.1f} ms at first, {late:.1f} ms at last")
    print(f"ticks given up: {missed}")


def latency_ms(recording: Path) -> dict[str, dict[str, float]]:
    """By stage the percentiles of a trial's frames."""
    return percentiles_ms([record for _, record in read_recording(recording).topics["/latency"]])


def server_bytes() -> int:
    """What this process holds of the machine's memory."""
    pages = Path("/proc/self/statm").read_text("ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
