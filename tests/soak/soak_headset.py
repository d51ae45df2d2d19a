"""What a standalone headset can bear, in all environments, and a session at length: `make soak`.

``SOAK_MINUTES`` is how long the session lasts, ``SOAK_PICTURES`` a folder for contact sheets of what each eye sees in
every phase.
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
from PIL import Image, ImageDraw

from avrgym.recording.files import read_recording
from avrgym.recording.latency import TOTAL, percentiles_ms
from avrgym.recording.questionnaire import LIKERT_ITEMS
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation import headset
from avrgym.vr.emulation.headset import BrowserAttendance
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from journey import Journey

METER = (Path(__file__).parents[1] / "helpers/page_meter.js").read_text("utf-8")
pytestmark = pytest.mark.usefixtures("unhurried", "patient")
MINUTES = float(os.environ.get("SOAK_MINUTES", "60"))
SHARE_WARM = 0.25
"""Of a long session; by then every scene has been shown and every function compiled."""
MOST_GPU_BYTES, MOST_CALLS, MOST_TRIANGLES = 40 << 20, 250, 500_000
MOST_SCRIPT_MS, MOST_SHOWN_MS = 2.0, 1000.0
MOST_SERVER_GROWTH, MOST_PAGE_GROWTH = 32 << 20, 2 << 20
MEASURED_S = 15.0
SHEET_COLUMNS = 3
PHASES_S = {
    "calibration": 0.5, "check": 0.3, "free_before": 1.0, "countdown": 0.3, "trial": 1.5, "paused": 0.5, "retreat": 1.0,
    "free_after": 0.5, "questionnaire": 0.5,
}  # fmt: skip
"""How long after the beginning of a phase its picture is taken."""


@pytest.fixture
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Software renderers of busy machines draw all of a room in many seconds."""
    monkeypatch.setattr(headset, "PATIENCE_S", 600.0)


class Visitor(BrowserAttendance):
    """Attends, stops the robot once in the first trial, and looks at the page's memory now and then."""

    every_s = 10.0

    def __init__(self, journey: Journey, pictures: Path, *, stops: bool, after_s: dict[str, float]) -> None:
        super().__init__(
            journey.headset, journey.session, journey.participant, pictures, lambda words: None, after_s
        )
        self._stops, self._looked_s = stops, -np.inf
        self._cdp = journey.headset.page.context.new_cdp_session(journey.headset.page)
        self.held: list[tuple[float, int, int]] = []
        """When, and how many bytes server and page then held."""

    def _act(self, question: dict[str, Any] | None, now_s: float) -> None:
        super()._act(question, now_s)
        if self._stops and self._phase[0] == "trial" and any("trial.png" in path.name for path in self.taken):
            self._headset.press_menu("left")
            self._stops = False
        if now_s > self._looked_s + self.every_s:
            self._looked_s = now_s
            self.held.append((now_s, server_bytes(), self.page_bytes()))

    def page_bytes(self) -> int:
        """What the page's scripts hold after all garbage is collected."""
        self._cdp.send("HeapProfiler.collectGarbage")
        return int(self._cdp.send("Runtime.getHeapUsage")["usedSize"])


@dataclass(frozen=True)
class Budget:
    """What one environment takes in full detail; calls and triangles are those of both eyes and the shadows.

    ``script_ms`` is the processor time of the page's scripts for a frame, messages since the one before included.
    """

    environment: str
    calls: int
    triangles: int
    gpu_mb: float
    script_ms: float
    shown_ms: float

    def __str__(self) -> str:
        return (
            f"| {self.environment} | {self.calls} | {self.triangles // 1000} | {self.gpu_mb:.1f} "
            f"| {self.script_ms:.2f} | {self.shown_ms:.0f} |"
        )


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_standalone_headset_can_bear_it_and_every_phase_is_pictured(
    environment: str, tmp_path: Path
) -> None:
    trial = TrialPlan(environment, "revised", seed=3, practice=False)
    plan = SessionPlan(
        [trial], "woman", 6.0, simulated=True, items=LIKERT_ITEMS[:1], trial_steps=60, countdown_s=3.0
    )
    with ExitStack() as opened:
        how = {"width": 640, "height": 360, "query": "&detail=full", "script": METER}
        journey = Journey(tmp_path, plan, load_policies(plan), opened, draws=True, **how)
        page = journey.headset.page
        page.evaluate("() => pageMeter.watchFrames()")
        journey.await_phase("waiting")
        shown = [page_picture(journey, tmp_path / "trial-00-waiting.png")]
        visitor = Visitor(journey, tmp_path, stops=True, after_s=PHASES_S)
        shown += visitor.run()
        shown.append(journey.headset.screenshot(tmp_path / "trial-99-finished.png"))
        budget = measured(journey, environment)
    contact_sheet(shown, environment)
    print(f"\n{budget}", end="")
    assert budget.gpu_mb * (1 << 20) <= MOST_GPU_BYTES
    assert budget.calls <= MOST_CALLS
    assert budget.triangles <= MOST_TRIANGLES
    assert budget.script_ms <= MOST_SCRIPT_MS
    assert budget.shown_ms <= MOST_SHOWN_MS


def page_picture(journey: Journey, path: Path) -> Path:
    journey.headset.page.screenshot(path=path)
    return path


def measured(journey: Journey, environment: str) -> Budget:
    """The page's frames without the software renderer's work: what the GPU is told to draw it does not draw."""
    page = journey.headset.page
    cdp = page.context.new_cdp_session(page)
    cdp.send("Performance.enable", {"timeDomain": "threadTicks"})
    page.evaluate("() => { pageMeter.idle = true; pageMeter.frames.length = 0; }")
    spent_s, drawn = script_s(cdp), journey.headset.call("framesDrawn")
    time.sleep(MEASURED_S)
    spent_s, drawn = script_s(cdp) - spent_s, journey.headset.call("framesDrawn") - drawn
    meter = page.evaluate(
        "() => ({ bytes: pageMeter.bytes, frames: pageMeter.frames, scenes: pageMeter.scenes,"
        " largest: pageMeter.largest() })"
    )
    largest = ", ".join(f"{each / (1 << 20):.1f}" for each in meter["largest"])
    print(f"\n{drawn} frames; the largest on the GPU, MiB: {largest}", end="")
    return Budget(
        environment=environment.removeprefix("avrgym/").removesuffix("-v1"),
        calls=max(frame["calls"] for frame in meter["frames"]),
        triangles=round(max(frame["triangles"] for frame in meter["frames"])),
        gpu_mb=meter["bytes"] / (1 << 20),
        script_ms=1000.0 * spent_s / drawn,
        shown_ms=min(meter["scenes"]),
    )


def script_s(cdp: Any) -> float:
    """The processor time that the page's scripts have taken so far."""
    metrics = {each["name"]: each["value"] for each in cdp.send("Performance.getMetrics")["metrics"]}
    return float(metrics["ScriptDuration"])


def contact_sheet(pictures: list[Path], environment: str) -> None:
    """All pictures on one sheet, under their names."""
    folder = os.environ.get("SOAK_PICTURES")
    if folder is None:
        return
    opened = [Image.open(path).convert("RGB") for path in pictures]
    width, height = opened[0].width, opened[0].height + 14
    rows = -(-len(opened) // SHEET_COLUMNS)
    sheet = Image.new("RGB", (SHEET_COLUMNS * width, rows * height), "white")
    for number, (path, picture) in enumerate(zip(pictures, opened, strict=True)):
        left, top = number % SHEET_COLUMNS * width, number // SHEET_COLUMNS * height
        sheet.paste(picture, (left, top + 14))
        ImageDraw.Draw(sheet).text((left + 4, top), path.stem, fill="black")
    Path(folder).mkdir(parents=True, exist_ok=True)
    sheet.save(Path(folder) / f"{environment.removeprefix('avrgym/')}.jpg", quality=85)


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
        visitor = Visitor(journey, tmp_path, stops=False, after_s={})
        journey.session._called_off = lambda: time.monotonic() > ends_s
        visitor.run()
        recordings = [read_recording(path) for path in journey.session.recordings]
        sent, missed = journey.headset.call("trackingSent"), journey.server.loop.missed_ticks
    lasted_s = visitor.held[-1][0]
    print(
        f"\n{lasted_s / 60:.1f} minutes, {len(recordings)} trials, {sent / lasted_s:.0f} frames of tracking a second"
    )
    warm = [each for each in visitor.held if each[0] > SHARE_WARM * lasted_s]
    middle = len(warm) // 2
    for name, column, most in (("server", 1, MOST_SERVER_GROWTH), ("page", 2, MOST_PAGE_GROWTH)):
        early, late = (median(each[column] for each in half) for half in (warm[:middle], warm[middle:]))
        print(f"{name}: {early / 2**20:.1f} MiB, in the later half {(late - early) / 2**20:+.2f} MiB")
        assert late - early < most
    ways = [percentiles_ms([record for _, record in each.topics["/latency"]]) for each in recordings]
    told = [each for each in ways if each]
    quarter = max(len(told) // 4, 1)
    for stage in ("up_ms", "down_ms", TOTAL):
        early, late = (
            median(each[stage]["p50"] for each in some) for some in (told[:quarter], told[-quarter:])
        )
        print(f"{stage}: median {early:.1f} ms at first, {late:.1f} ms at last")
    print(f"ticks given up: {missed}")


def server_bytes() -> int:
    """What this process holds of the machine's memory."""
    pages = Path("/proc/self/statm").read_text("ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")
