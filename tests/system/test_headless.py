"""How MuJoCo draws where there is no screen."""

import os

import pytest

from avrgym.system import headless


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch):
    """Gives what is chosen with some libraries installed, in an environment of its own."""
    for name in ("MUJOCO_GL", *headless.SCREENS):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")

    def choose(*installed: str, **environment: str) -> str | None:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(headless, "find_library", lambda name: name if name in installed else None)
        headless.choose_renderer()
        return os.environ.get("MUJOCO_GL")

    yield choose
    os.environ.pop("MUJOCO_GL", None)


def test_the_first_library_that_is_installed_draws(chosen) -> None:
    assert chosen("OSMesa") == "osmesa"


def test_a_graphics_card_comes_first(chosen) -> None:
    assert chosen("OSMesa", "EGL") == "egl"


def test_nothing_is_chosen_without_a_library(chosen) -> None:
    assert chosen() is None


@pytest.mark.parametrize("screen", headless.SCREENS)
def test_a_screen_is_left_to_mujoco(chosen, screen: str) -> None:
    assert chosen("EGL", **{screen: ":0"}) is None


def test_what_is_set_stays(chosen) -> None:
    assert chosen("EGL", MUJOCO_GL="osmesa") == "osmesa"
