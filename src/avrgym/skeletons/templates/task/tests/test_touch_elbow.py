"""The task is registered, and does in motion what its record says."""

from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.tasks.task_check import check_task


def test_it_has_an_environment() -> None:
    assert "avrgym/TouchElbowJaco-v1" in ENVIRONMENTS


def test_it_does_what_its_record_says() -> None:
    check_task("TouchElbow")
