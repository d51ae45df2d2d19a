"""Prevention of idle states: its duration, and users without permission."""

import os
from pathlib import Path

import pytest
from test_real_time_loop import FakeSession, run

from avrgym.vr.server import cpu_idle
from avrgym.vr.server.cpu_idle import CPU_IDLE_DRIVER_FILE, CPU_LATENCY_FILE, ZERO_LATENCY, CpuIdlePrevention


@pytest.fixture
def guest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A virtual machine's file of latencies."""
    (tmp_path / "driver").write_text("haltpoll\n")
    monkeypatch.setattr(cpu_idle, "CPU_IDLE_DRIVER_FILE", tmp_path / "driver")
    monkeypatch.setattr(cpu_idle, "CPU_LATENCY_FILE", tmp_path / "latency")
    return tmp_path / "latency"


def holds(kept: CpuIdlePrevention) -> bool:
    """Whether it has the file open."""
    return kept._file is not None and not kept._file.closed


def test_idle_states_are_prevented_until_released(guest: Path) -> None:
    kept = CpuIdlePrevention()
    kept.set_enabled(False)
    assert not guest.exists()
    for _ in range(2):
        for _ in range(2):
            kept.set_enabled(True)
            assert holds(kept)
            assert guest.read_bytes() == ZERO_LATENCY == bytes(4)
        held = kept._file
        kept.set_enabled(False)
        assert not holds(kept)
        assert held is not None
        assert held.closed


@pytest.mark.parametrize("driver", ["intel_idle", "none", None])
def test_physical_machines_are_not_changed(guest: Path, driver: str | None) -> None:
    cpu_idle.CPU_IDLE_DRIVER_FILE.unlink()
    if driver:
        cpu_idle.CPU_IDLE_DRIVER_FILE.write_text(f"{driver}\n")
    CpuIdlePrevention().set_enabled(True)
    assert not guest.exists()


def test_without_permission_nothing_happens(guest: Path) -> None:
    guest.mkdir()
    kept = CpuIdlePrevention()
    kept.set_enabled(True)
    guest.rmdir()
    kept.set_enabled(True)
    assert not guest.exists()


def test_the_loop_keeps_processors_awake_while_something_moves(
    guest: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []
    keep = CpuIdlePrevention.set_enabled

    def note(kept: CpuIdlePrevention, awake: bool) -> None:
        asked.append(awake)
        keep(kept, awake)

    def rest(ticks: int) -> None:
        session.is_at_rest = ticks <= 3

    monkeypatch.setattr(CpuIdlePrevention, "set_enabled", note)
    session = FakeSession(rest)
    run(session, 8)
    assert asked[:8] == 3 * [False] + 5 * [True]
    assert not asked[-1]
    assert guest.read_bytes() == ZERO_LATENCY


@pytest.mark.skipif(
    not CPU_IDLE_DRIVER_FILE.exists()
    or CPU_IDLE_DRIVER_FILE.read_text().strip() != cpu_idle.GUEST_IDLE_DRIVER
    or not os.access(CPU_LATENCY_FILE, os.R_OK | os.W_OK),
    reason="only a virtual machine whose system can keep processors awake, and lets this user, shows it",
)
def test_the_system_hears_it() -> None:
    kept = CpuIdlePrevention()
    before = CPU_LATENCY_FILE.read_bytes()
    kept.set_enabled(True)
    assert CPU_LATENCY_FILE.read_bytes() == ZERO_LATENCY
    kept.set_enabled(False)
    assert CPU_LATENCY_FILE.read_bytes() == before
