"""Events of a trial, folded: nothing is lost, and what comes again stands in one line."""

import pytest

from avrgym.demo.events import folded
from avrgym.recording.schema import Event

SECOND_NS = 1_000_000_000


def lost_and_found(times: int, every_s: float, lasts_s: float) -> list[tuple[int, Event]]:
    return [
        (round(SECOND_NS * (i * every_s + shift_s)), Event(name, detail))
        for i in range(times)
        for name, detail, shift_s in (
            ("tracking_lost", "no frame for 0.2 s: the person holds still", 0.0),
            ("tracking_found", "", lasts_s),
        )
    ]


def test_thirty_losses_of_tracking_are_one_line_with_their_count_and_time() -> None:
    phase = (0, Event("phase", "trial"))
    first, second = folded([phase, *lost_and_found(30, 0.5, 0.1)], until_s=20.0)
    assert (first.name, first.detail, first.times, first.lasted_s) == ("phase", "trial", 1, None)
    assert (second.name, second.times) == ("tracking_lost", 30)
    assert second.lasted_s == pytest.approx(3.0)


def test_what_nothing_ends_lasts_to_the_end() -> None:
    (lost,) = folded(lost_and_found(2, 4.0, 1.0)[:-1], until_s=10.0)
    assert lost.lasted_s == pytest.approx(1.0 + 6.0)


def test_parts_of_the_body_are_told_apart() -> None:
    events = [
        (SECOND_NS * at_s, Event(name, part))
        for at_s, name, part in (
            (1, "pose_held", "left"),
            (2, "pose_held", "head"),
            (4, "pose_followed", "left"),
            (8, "pose_followed", "head"),
            (9, "pose_held", "left"),
        )
    ]
    left, head = folded(events, until_s=10.0)
    assert (left.detail, left.times, left.lasted_s) == ("left", 2, pytest.approx(4.0))
    assert (head.detail, head.times, head.lasted_s) == ("head", 1, pytest.approx(6.0))


def test_phases_stand_in_their_order() -> None:
    names = ["free_before", "countdown", "trial", "free_after"]
    events = [(i, Event("phase", name)) for i, name in enumerate(names)]
    assert [each.detail for each in folded(events, until_s=1.0)] == names
