"""GPU and script budgets of a standalone headset, and a long session: `make soak`.

``SOAK_MINUTES`` sets the duration of the session.
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
from avrgym.vr.latency import TOTAL_LATENCY_KEY, compute_percentiles_ms
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.browser.journey import Journey

METER = (Path(__file__).parents[1] / "helpers/browser/page_meter.js").read_text("utf-8")
pytestmark = pytest.mark.usefixtures("relaxed_limits", "long_timeout")
MINUTES = float(os.environ.get("SOAK_MINUTES", "60"))
WARM_UP_SHARE = 0.25
"""Share of the long session after which all scenes are loaded and all functions compiled."""
MAX_GPU_BYTES, MAX_CALLS, MAX_TRIANGLES = 40 << 20, 250, 500_000
MAX_SCRIPT_MS, MAX_SHOWN_MS = 2.0, 1000.0
MAX_SERVER_GROWTH, MAX_PAGE_GROWTH = 32 << 20, 2 << 20
MAX_DRIFT_MS = 5.0
MEASURED_S = 15.0


@pytest.fixture
def long_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extend the timeout: software rendering of a room takes many seconds."""
    monkeypatch.setattr(emulated_headset, "PAGE_TIMEOUT_S", 600.0)


class MeasuringClient(BrowserClient):
    """A client that measures memory and clocks at intervals."""

    every_s = 10.0

    def __init__(self, journey: Journey) -> None:
        super().__init__(
            journey.headset, journey.session, journey.participant, journey.folder, lambda words: None, {}
        )
        self._measured_s = -np.inf
        self._cdp = journey.headset.page.context.new_cdp_session(journey.headset.page)
        self.memory: list[tuple[float, int, int]] = []
        """Time (s), and memory of server and page (bytes)."""
        self.ahead_ms: list[float] = []
        """Offset of the page's clock from the server's, up to a constant, ms."""

    def _act(self, question: dict[str, Any] | None, now_s: float) -> None:
        super()._act(question, now_s)
        if now_s > self._measured_s + self.every_s:
            self._measured_s = now_s
            self.memory.append((now_s, server_bytes(), self.page_bytes()))
            self.ahead_ms.append(self.page_ahead_ms())

    def page_bytes(self) -> int:
        """Return the page's heap size after garbage collection."""
        self._cdp.send("HeapProfiler.collectGarbage")
        return int(self._cdp.send("Runtime.getHeapUsage")["usedSize"])

    def page_ahead_ms(self) -> float:
        """Return the clock offset from the fastest of a few round trips."""
        round_trips = [
            (time.monotonic(), self._headset.page.evaluate("() => performance.now()"), time.monotonic())
            for _ in range(8)
        ]
        before_s, page_ms, after_s = min(round_trips, key=lambda each: each[2] - each[0])
        return page_ms - 500.0 * (before_s + after_s)


@dataclass(frozen=True)
class Budget:
    """Rendering costs of an environment in full detail, for both eyes and the shadows.

    ``script_ms``: median script time of a frame, with the messages since the previous frame.
    ``processor_ms``: mean processor time of all scripts per frame, with the emulator.
    ``shown_ms``: longest time from the scene message until the scene is shown.
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
def test_environment_fits_the_budget_of_a_standalone_headset(environment: str, tmp_path: Path) -> None:
    """Measured in free movement. The first scene has the planned body, the second the measured height."""
    trial = TrialPlan(environment, "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 600.0, is_simulated=True)
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
    assert budget.gpu_mb * (1 << 20) <= MAX_GPU_BYTES
    assert budget.calls <= MAX_CALLS
    assert budget.triangles <= MAX_TRIANGLES
    assert budget.script_ms <= MAX_SCRIPT_MS
    assert budget.shown_ms <= MAX_SHOWN_MS


def measured(journey: Journey, environment: str) -> Budget:
    """Measure frames of the page without rasterization."""
    page = journey.headset.page
    cdp = page.context.new_cdp_session(page)
    cdp.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.evaluate("() => { pageMeter.frames.length = 0; }")
    spent_s, drawn = script_s(cdp), journey.headset.call_emulator("framesDrawn")
    time.sleep(MEASURED_S)
    spent_s, drawn = script_s(cdp) - spent_s, journey.headset.call_emulator("framesDrawn") - drawn
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
    """Return the processor time of the page's scripts so far."""
    metrics = {each["name"]: each["value"] for each in cdp.send("Performance.getMetrics")["metrics"]}
    return float(metrics["ScriptDuration"])


def test_a_long_session_at_90_hz_has_constant_memory_and_synchronous_clocks(tmp_path: Path) -> None:
    """Trials in all environments, tracked at 90 Hz."""
    environments = list(ENVIRONMENTS)
    trials = [
        TrialPlan(environments[seed % len(environments)], "revised", seed, practice=False)
        for seed in range(round(60 * MINUTES))
    ]
    plan = SessionPlan(
        trials,
        "woman",
        2.0,
        is_simulated=True,
        questionnaire_items=LIKERT_ITEMS[:1],
        trial_steps=100,
        countdown_s=1.0,
    )
    ends_s = time.monotonic() + 60.0 * MINUTES
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened)
        client = MeasuringClient(journey)
        journey.session._ended_elsewhere = lambda: time.monotonic() > ends_s
        client.run()
        ways = [latency_ms(path) for path in journey.session.recordings]
        sent, missed = journey.headset.call_emulator("trackingSent"), journey.server.loop.missed_ticks
    lasted_s = client.memory[-1][0]
    print(
        f"\n{lasted_s / 60:.1f} minutes, {len(ways)} trials, {sent / lasted_s:.0f} frames of tracking a second"
    )
    warm = [each for each in client.memory if each[0] > WARM_UP_SHARE * lasted_s]
    middle = len(warm) // 2
    for name, column, most in (("server", 1, MAX_SERVER_GROWTH), ("page", 2, MAX_PAGE_GROWTH)):
        early, late = (median(each[column] for each in half) for half in (warm[:middle], warm[middle:]))
        print(f"{name}: {early / 2**20:.1f} MiB, in the later half {(late - early) / 2**20:+.2f} MiB")
        assert late - early < most
    parted_ms = median(client.ahead_ms[-5:]) - median(client.ahead_ms[:5])
    print(f"clocks: the page's gained {parted_ms:+.2f} ms on the server's")
    assert abs(parted_ms) < MAX_DRIFT_MS
    told = [each for each in ways if each]
    quarter = max(len(told) // 4, 1)
    for stage in ("up_ms", "down_ms", TOTAL_LATENCY_KEY):
        early, late = (
            median(each[stage]["p50"] for each in some) for some in (told[:quarter], told[-quarter:])
        )
        print(f"{stage}: median {early:.1f} ms at first, {late:.1f} ms at last")
    print(f"ticks given up: {missed}")


def latency_ms(recording: Path) -> dict[str, dict[str, float]]:
    """Return latency percentiles of a trial's frames by stage."""
    return compute_percentiles_ms(
        [record for _, record in read_recording(recording).messages_by_topic["/latency"]]
    )


def server_bytes() -> int:
    """Return the resident memory of this process."""
    pages = Path("/proc/self/statm").read_text("ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
