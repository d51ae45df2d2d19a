"""Admission of participants: capacity, waiting list, codes, limits of requests, and the settings of a host."""

from pathlib import Path

import pytest

from avrgym.hosting.capacity import INITIAL_SESSION_CPU_LOAD, IdleCoreMonitor, SessionCapacity
from avrgym.hosting.headset_codes import CODE_VALIDITY_S, MAX_WRONG_CODES_PER_MINUTE, HeadsetCodes
from avrgym.hosting.rate_limits import RateLimits, find_client_address
from avrgym.hosting.settings import HostSettings, read_host_settings
from avrgym.hosting.waiting_list import PRESENCE_TIMEOUT_S, WaitingList, estimate_wait_s
from avrgym.study.design.toml_validation import DesignError
from avrgym.vr.server.session_links import CodeError, TooManyWrongCodesError


class Clock:
    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def report(
    capacity: SessionCapacity, session: str, cpu_share: float, missed_per_s: int, seconds: int = 40
) -> None:
    for second in range(seconds):
        capacity.add_session_report(session, float(second), cpu_share, missed_per_s * second, in_trial=True)
        capacity.add_session_report(session, float(second), 0.9, missed_per_s * second, in_trial=False)


def test_capacity_follows_the_measured_processor_time() -> None:
    capacity = SessionCapacity(cores=8)
    assert capacity.session_cpu_load == INITIAL_SESSION_CPU_LOAD
    report(capacity, "a", 0.1, 0)
    assert (capacity.session_cpu_load, capacity.max_sessions) == (pytest.approx(0.1), 64)
    report(capacity, "b", 0.3, 0)
    assert (capacity.session_cpu_load, capacity.max_sessions) == (pytest.approx(0.2), 32)
    capacity.remove_session("a")
    assert capacity.session_cpu_load == pytest.approx(0.2)
    assert SessionCapacity(cores=1).can_start_session(0)


@pytest.mark.parametrize(("missed_per_s", "admitted"), [(0, True), (1, False)])
def test_no_session_is_admitted_while_ticks_are_given_up(missed_per_s: int, admitted: bool) -> None:
    capacity = SessionCapacity(cores=8)
    report(capacity, "a", 0.1, missed_per_s)
    assert capacity.missed_tick_fraction == pytest.approx(0.01 * missed_per_s)
    assert capacity.can_start_session(1) is admitted
    assert capacity.can_start_session(0)
    assert not capacity.can_start_session(capacity.max_sessions)


def test_no_session_is_admitted_while_other_programs_use_the_processors(tmp_path: Path) -> None:
    """Two of four cores are idle, then none."""
    clock, statistics = Clock(), tmp_path / "stat"
    idle_cores = IdleCoreMonitor(statistics, clock)

    def measure(busy: int, idle: int) -> float | None:
        cores = "".join(f"cpu{core} 0 0 0 0 0 0 0 0 0 0\n" for core in range(4))
        statistics.write_text(f"cpu {busy} 0 0 {idle} 0 0 0 0 0 0\n{cores}intr 1\n")
        return idle_cores.measure()

    assert measure(100, 100) is None
    clock.now_s = 1.0
    assert measure(300, 300) == 2.0
    clock.now_s = 6.5
    assert measure(700, 300) is None
    clock.now_s = 7.5
    capacity = SessionCapacity(cores=4)
    report(capacity, "a", INITIAL_SESSION_CPU_LOAD, 0)
    capacity.add_session_report(
        "a", 40.0, INITIAL_SESSION_CPU_LOAD, 0, in_trial=True, idle_cores=measure(1100, 300)
    )
    assert capacity.idle_cores == 0.0
    assert [capacity.can_start_session(running) for running in (0, 1)] == [True, False]
    capacity.add_session_report(
        "a", 41.0, INITIAL_SESSION_CPU_LOAD, 0, in_trial=True, idle_cores=2.5 * INITIAL_SESSION_CPU_LOAD
    )
    assert [capacity.can_start_session(2, young) for young in (0, 1, 2)] == [True, True, False]


def test_waiting_time_follows_the_ends_of_running_sessions() -> None:
    assert estimate_wait_s(0, [], 600.0, 2) == 0.0
    assert [estimate_wait_s(place, [100.0, 300.0], 600.0, 2) for place in range(4)] == [
        100.0,
        300.0,
        700.0,
        900.0,
    ]
    assert estimate_wait_s(0, [100.0, 300.0, 500.0], 600.0, 2) == 300.0
    assert estimate_wait_s(2, [], 600.0, 2) == 600.0


def test_waiting_participants_keep_their_order_and_absent_ones_leave() -> None:
    waiting = WaitingList()
    for name in ("a", "b", "c"):
        waiting.join(name, 0.0)
    waiting.join("a", PRESENCE_TIMEOUT_S)
    waiting.join("c", PRESENCE_TIMEOUT_S)
    assert [waiting.count_participants_ahead(name) for name in ("a", "b", "c")] == [0, 1, 2]
    waiting.remove_absent(PRESENCE_TIMEOUT_S)
    assert (waiting.find_next_present(), waiting.count_participants_ahead("c"), "b" in waiting) == (
        "a",
        1,
        False,
    )
    waiting.leave("a")
    waiting.leave("c")
    assert waiting.find_next_present() is None


def test_codes_are_valid_once_and_for_minutes() -> None:
    clock = Clock()
    codes = HeadsetCodes(clock)
    first = codes.create_code("token")
    second = codes.create_code("token")
    with pytest.raises(CodeError):
        codes.exchange_code(first)
    assert codes.exchange_code(second) == "token"
    with pytest.raises(CodeError):
        codes.exchange_code(second)
    third = codes.create_code("token")
    clock.now_s = CODE_VALIDITY_S
    with pytest.raises(CodeError):
        codes.exchange_code(third)


def test_wrong_codes_are_limited_also_for_a_right_one() -> None:
    clock = Clock()
    codes = HeadsetCodes(clock)
    code = codes.create_code("token")
    for _ in range(MAX_WRONG_CODES_PER_MINUTE):
        with pytest.raises(CodeError):
            codes.exchange_code("x")
    with pytest.raises(TooManyWrongCodesError):
        codes.exchange_code(code)
    clock.now_s = 61.0
    assert codes.exchange_code(code) == "token"


def test_requests_are_limited_by_key() -> None:
    clock = Clock()
    limits = RateLimits(2, 60.0, clock)
    assert [limits.allows("a") for _ in range(3)] == [True, True, False]
    assert limits.allows("b")
    clock.now_s = 1.0
    assert [limits.allows("a") for _ in range(2)] == [True, False]


@pytest.mark.parametrize(
    ("peer", "forwarded", "expected"),
    [
        ("10.0.0.9", "1.2.3.4", "10.0.0.9"),
        ("10.0.0.1", "6.6.6.6, 1.2.3.4", "1.2.3.4"),
        ("10.0.0.1", "1.2.3.4, 10.0.0.2", "1.2.3.4"),
        ("10.0.0.1", "", "10.0.0.1"),
    ],
)
def test_only_proxies_state_the_address_of_a_client(peer: str, forwarded: str, expected: str) -> None:
    scope = {"type": "http", "client": (peer, 1), "headers": [(b"x-forwarded-for", forwarded.encode())]}
    assert find_client_address(scope, ("10.0.0.1", "10.0.0.2")) == expected


def test_settings_of_a_host(tmp_path: Path) -> None:
    assert read_host_settings(tmp_path) == HostSettings()
    file = tmp_path / "host.toml"
    file.write_text('session_minutes = 30\n[completed]\ncode = "C1"\nredirect = "https://a.example/x?cc=1"\n')
    settings = read_host_settings(tmp_path)
    assert (settings.session_minutes, settings.completed.code) == (30.0, "C1")
    for text, message in (
        ('[completed]\nredirect = "javascript:alert(1)"\n', "host.toml:2: .*allowed: an https address"),
        ("session_minutes = 0\n", "host.toml:1: "),
        ("[finished]\n", "finished"),
    ):
        file.write_text(text)
        with pytest.raises(DesignError, match=message):
            read_host_settings(tmp_path)
