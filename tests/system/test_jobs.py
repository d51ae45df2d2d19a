"""Work in several processes gives the same results as in one process."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from avrgym.learning import evaluation
from avrgym.learning.evaluation import evaluate, evaluate_all
from avrgym.policies.trained_policies import PolicyError
from avrgym.study.sessions.dry_run import simulate_study
from avrgym.study.storage import database
from avrgym.system.parallel_calls import count_available_cores, report_progress, starmap
from avrgym.tasks.constants import EPISODE_STEPS
from helpers.studies.small_studies import make_study
from helpers.system.killed_processes import SEED, assert_same

SLEEPING = """
import os, time
from pathlib import Path

def sleep(name):
    Path(name).write_text(str(os.getpid()))
    time.sleep(600)
"""
JACO, PR2 = "avrgym/FeedingJaco-v1", "avrgym/FeedingPR2-v1"


def twice(number: int) -> int:
    """Reports its argument and gives it doubled; refuses a negative one."""
    if number < 0:
        raise ValueError(f"{number} is negative")
    report_progress(number)
    return 2 * number


def end(number: int) -> None:
    """Ends its process without a word."""
    os._exit(number)


@pytest.mark.slow
def test_results_are_in_order_and_progress_is_reported() -> None:
    told: list[int] = []
    assert starmap(twice, [(number,) for number in range(5)], 2, told.append) == [0, 2, 4, 6, 8]
    assert told[-1] == 10
    assert starmap(twice, [], 2) == []
    assert 1 <= count_available_cores() <= (os.cpu_count() or 1)


@pytest.mark.slow
def test_an_error_in_a_process_is_that_of_the_call() -> None:
    with pytest.raises(ValueError, match="-1 is negative"):
        starmap(twice, [(1,), (-1,)], 2)
    with pytest.raises(RuntimeError, match="terminated abruptly"):
        starmap(end, [(3,)], 1)


def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    """However that ends."""
    (tmp_path / "sleeping.py").write_text(SLEEPING)
    code = (
        "from avrgym.system.parallel_calls import starmap; from sleeping import sleep;"
        "starmap(sleep, [('one',), ('other',)], 2) if __name__ == '__main__' else None"
    )
    with subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path) as parent:
        files = [tmp_path / "one", tmp_path / "other"]
        while not all(file.exists() and file.read_text() for file in files):
            assert parent.poll() is None
            time.sleep(0.05)
        parent.send_signal(signal.SIGKILL)
    for file in files:
        while Path("/proc", file.read_text()).exists():
            time.sleep(0.05)


@pytest.mark.slow
def test_rows_are_the_same_from_any_number_of_processes() -> None:
    """Two environments, with batches that end in the middle of those of one process."""
    rows, steps = {}, {}
    for jobs in (1, 2, 3):
        told: list[int] = []
        rows[jobs] = evaluate_all([JACO, PR2], "revised", "revised", 5, 7, told.append, jobs=jobs)
        steps[jobs] = sum(told)
    assert rows[1] == rows[2] == rows[3]
    assert [row.env for row in rows[1]] == [JACO, PR2]
    assert rows[1][1] == evaluate(PR2, "revised", "revised", 5, 7)
    assert set(steps.values()) == {2 * 5 * EPISODE_STEPS}


@pytest.mark.slow
@pytest.mark.parametrize("environment", [JACO, "avrgym/BedBathingPR2-v1"])
def test_results_of_a_script_do_not_depend_on_other_processes(environment, monkeypatch) -> None:
    whole = evaluate(environment, "oracle", "participants", 3, 2)
    monkeypatch.setattr(evaluation, "MAX_WORLDS_PER_BATCH", 2)
    assert evaluate(environment, "oracle", "participants", 3, 2) == whole


def test_few_episodes_need_no_other_process(monkeypatch) -> None:
    monkeypatch.setattr(evaluation, "starmap", None)
    assert evaluate_all([JACO], "zero", "original", 2, 0)[0].episodes == 2


def test_invalid_jobs_are_refused_before_processes_start(monkeypatch) -> None:
    monkeypatch.setattr(evaluation, "starmap", None)
    with pytest.raises(PolicyError, match="no policy 'nope'"):
        evaluate_all([JACO, PR2], "nope", "original", 40, 0, jobs=2)


@pytest.mark.slow
def test_a_dry_run_is_the_same_from_any_number_of_processes(tmp_path: Path, monkeypatch) -> None:
    """Rows, and all that the recordings hold."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    design = {"tasks": '["ScratchItch"]', "robots": '["Jaco"]', "trial_steps": "3", "free_movement_s": "0.1"}
    one, two = (make_study(tmp_path / name, **design) for name in ("one", "two"))
    simulate_study(one, 2, SEED, jobs=1)
    simulate_study(two, 2, SEED, jobs=2)
    assert assert_same(one, two) == 2 * 3
