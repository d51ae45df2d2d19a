"""Checks of real-time performance, with and without limits of the system."""

import os
import resource
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from avrgym.doctor import machine
from avrgym.vr.server import cpu_idle

NOBODY = 65534


@pytest.fixture
def ordinary_user() -> Iterator[None]:
    """Run a test as an ordinary user without root permissions."""
    root = os.geteuid() == 0
    if root:
        os.seteuid(NOBODY)
    yield
    if root:
        os.seteuid(0)


@pytest.fixture
def one_processor() -> Iterator[None]:
    """This thread may run on one processor alone."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    yield
    os.sched_setaffinity(0, before)


def test_one_processor_is_a_warning(one_processor: None) -> None:
    assert machine.check_processor_count().state == "warning"


def test_one_processor_needs_no_priority(one_processor: None) -> None:
    assert machine.check_real_time_priority().state == "ok"


def test_two_processors_are_enough() -> None:
    assert (machine.check_processor_count().state == "ok") is (len(os.sched_getaffinity(0)) > 1)


@pytest.mark.skipif(len(os.sched_getaffinity(0)) == 1, reason="on one processor nobody goes first")
def test_without_real_time_priority_the_fix_is_printed(ordinary_user: None) -> None:
    _, most = resource.getrlimit(resource.RLIMIT_RTPRIO)
    resource.setrlimit(resource.RLIMIT_RTPRIO, (0, most))
    found = machine.check_real_time_priority()
    assert found.state == "warning"
    assert "- rtprio 10" in found.fix


def test_a_user_without_a_name_is_identified_by_id(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LOGNAME", "USER", "LNAME", "USERNAME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 4321)
    monkeypatch.setattr(machine, "use_real_time_priority", lambda: False)
    assert "`4321 - rtprio 10`" in machine.check_real_time_priority().fix


@pytest.mark.parametrize(("late_s", "state"), [(0.0001, "ok"), (0.0056, "warning")])
def test_a_coarse_timer_is_a_warning(late_s: float, state: str) -> None:
    assert machine.check_sleep_precision(late_s).state == state


def test_sleeps_are_measured() -> None:
    assert 0.0 <= machine.measure_oversleep_s() < 10.0


def test_idle_states_of_virtual_machines_are_a_warning_without_permission(
    ordinary_user: None,
) -> None:
    with tempfile.TemporaryDirectory() as name:
        driver, latency = Path(name, "driver"), Path(name, "latency")
        latency.touch()
        assert machine.check_cpu_idle_states(driver, latency).state == "ok"
        driver.write_text("intel_idle\n")
        assert machine.check_cpu_idle_states(driver, latency).state == "ok"
        driver.write_text(f"{cpu_idle.GUEST_IDLE_DRIVER}\n")
        assert machine.check_cpu_idle_states(driver, latency).state == "ok"
        latency.chmod(0o400)
        found = machine.check_cpu_idle_states(driver, latency)
        assert (found.state, str(latency) in found.fix) == ("warning", True)


def test_few_file_handles_are_a_warning() -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, before[1]))
        assert machine.check_open_file_limit().fix == "ulimit -n 1024"
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
    assert machine.check_open_file_limit(1024).state == "ok"


def test_a_full_path_with_spaces_is_written_to_and_left_as_it_was(tmp_path: Path) -> None:
    folder = tmp_path / "a study's (own) folder"
    assert machine.check_folder_writable(folder).message == f"{folder} can be created"
    assert list(tmp_path.iterdir()) == []
    folder.mkdir()
    assert machine.check_folder_writable(folder).message == str(folder)
    assert list(folder.iterdir()) == []


def test_a_folder_of_another_user_is_an_error(ordinary_user: None) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o555)
        for each in (folder, folder / "within"):
            found = machine.check_folder_writable(each)
            assert (found.state, "Permission denied" in found.message) == ("error", True)
        folder.chmod(0o755)


def test_a_full_disk_is_an_error(tmp_path: Path, small_files: Callable[[int], None]) -> None:
    small_files(1)
    assert machine.check_folder_writable(tmp_path).state == "error"
    small_files(0)
    assert machine.check_folder_writable(tmp_path).state == "ok"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("free_bytes", "state"), [(5e9, "ok"), (5e8, "warning"), (5e7, "error")])
def test_low_disk_space_is_a_warning_and_very_low_an_error(free_bytes: float, state: str) -> None:
    assert machine.check_free_bytes(int(free_bytes)).state == state


def test_free_room_is_that_of_the_disk_on_which_a_folder_would_be(tmp_path: Path) -> None:
    assert machine.check_free_space(tmp_path / "not" / "yet").message.endswith("trials")
