"""Kills and a long session: `make soak`."""

import os
from itertools import pairwise
from pathlib import Path

import pytest

from avrgym.recording.reader import read_recording
from avrgym.study.storage import database
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation.in_process_client import InProcessClient
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.session import Session
from helpers.studies.small_studies import make_study
from helpers.system.killed_processes import compare_with_killed
from helpers.vr.visit import constant_policies

WARM_TRIALS, TRIALS = 24, 240
MAX_GROWTH_BYTES = 64 << 20


def memory_bytes() -> int:
    """Return the resident memory of this process."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def test_200_kills_do_not_change_a_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    design = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "trial_steps": "3", "free_movement_s": "0.1"}
    undisturbed, killed = (make_study(tmp_path / name, **design) for name in ("undisturbed", "killed"))
    print(compare_with_killed(undisturbed, killed, tmp_path / "journal", kills=200))


def test_a_long_session_has_constant_memory_and_loses_no_frame(tmp_path: Path) -> None:
    """Trials of two seconds in all environments."""
    environments = list(ENVIRONMENTS)
    trials = [
        TrialPlan(environments[seed % len(environments)], "drive", seed, practice=False)
        for seed in range(TRIALS)
    ]
    plan = SessionPlan(
        trials, "woman", 0.5, is_simulated=True, questionnaire_items=(), trial_steps=20, countdown_s=0.5
    )
    memory: list[int] = []
    client = InProcessClient(
        SimulatedParticipant(sample_participant_traits("woman", 1), 1),
        lambda _: memory.append(memory_bytes()),
    )
    session = Session(plan, constant_policies(plan), tmp_path, client.receive, "soak")
    client.run(session)
    assert len(session.recordings) == TRIALS
    for path in session.recordings:
        frames = [frame.sequence for _, frame in read_recording(path).messages_by_topic["/tracking"]]
        assert all(after == before + 1 for before, after in pairwise(frames))
    warm = memory[len(memory) * WARM_TRIALS // TRIALS]
    growth = memory[-1] - warm
    print(f"\n{TRIALS} trials: {warm >> 20} MiB after {WARM_TRIALS}, {growth >> 20} MiB more at the end")
    assert growth < MAX_GROWTH_BYTES
