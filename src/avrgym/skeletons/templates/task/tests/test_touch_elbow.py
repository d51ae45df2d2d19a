"""The task is registered, and does in motion what its record says."""

from avrgym.tasks.checking import check_task
from avrgym.tasks.registry import ENVIRONMENTS


def test_it_has_an_environment() -> None:
    assert "avrgym/TouchElbowJaco-v1" in ENVIRONMENTS


def test_it_does_what_its_record_says() -> None:
    check_task("TouchElbow")
