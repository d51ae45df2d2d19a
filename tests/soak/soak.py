"""What takes too long for every run of the tests: `make soak`."""

import os
from itertools import pairwise
from pathlib import Path

import pytest

from avrgym.recording.reader import read_recording
from avrgym.study.storage import database
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation.in_process_client import InProcessClient
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, draw_traits
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.session import Session
from helpers.studies.small_studies import make_study
from helpers.system.killed_processes import compare_with_killed
from helpers.vr.visit import constant_policies

WARM_TRIALS, TRIALS = 24, 240
MOST_GROWTH_BYTES = 64 << 20


def memory_bytes() -> int:
    """What this process holds of the machine's memory."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def test_200_kills_change_nothing_of_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.URL_VARIABLE, raising=False)
    design = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "trial_steps": "3", "free_movement_s": "0.1"}
    whole, killed = (make_study(tmp_path / name, **design) for name in ("whole", "killed"))
    print(compare_with_killed(whole, killed, tmp_path / "journal", kills=200))


def test_a_long_session_keeps_its_memory_flat_and_loses_no_frame(tmp_path: Path) -> None:
    """In all environments, two seconds a trial."""
    environments = list(ENVIRONMENTS)
    trials = [
        TrialPlan(environments[seed % len(environments)], "drive", seed, practice=False)
        for seed in range(TRIALS)
    ]
    plan = SessionPlan(trials, "woman", 0.5, simulated=True, items=(), trial_steps=20, countdown_s=0.5)
    held: list[int] = []
    client = InProcessClient(
        SimulatedParticipant(draw_traits("woman", 1), 1), lambda _: held.append(memory_bytes())
    )
    session = Session(plan, constant_policies(plan), tmp_path, client.hear, "soak")
    client.run(session)
    assert len(session.recordings) == TRIALS
    for path in session.recordings:
        frames = [frame.sequence for _, frame in read_recording(path).topics["/tracking"]]
        assert all(after == before + 1 for before, after in pairwise(frames))
    warm = held[len(held) * WARM_TRIALS // TRIALS]
    growth = held[-1] - warm
    print(f"\n{TRIALS} trials: {warm >> 20} MiB after {WARM_TRIALS}, {growth >> 20} MiB more at the end")
    assert growth < MOST_GROWTH_BYTES
