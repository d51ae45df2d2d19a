"""The rendering backend of MuJoCo without a screen."""

import os

import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.system import mujoco_setup


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch):
    """Gives what is chosen with some libraries installed, in an environment of its own."""
    for name in ("MUJOCO_GL", *mujoco_setup.DISPLAY_VARIABLES):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")

    def choose(*installed: str, **environment: str) -> str | None:
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        monkeypatch.setattr(mujoco_setup, "find_library", lambda name: name if name in installed else None)
        mujoco_setup.choose_rendering_backend()
        return os.environ.get("MUJOCO_GL")

    yield choose
    os.environ.pop("MUJOCO_GL", None)


def test_the_first_library_that_is_installed_draws(chosen) -> None:
    assert chosen("OSMesa") == "osmesa"


def test_egl_is_preferred(chosen) -> None:
    assert chosen("OSMesa", "EGL") == "egl"


def test_without_a_library_no_backend_is_chosen(chosen) -> None:
    assert chosen() is None


@pytest.mark.parametrize("screen", mujoco_setup.DISPLAY_VARIABLES)
def test_a_screen_is_left_to_mujoco(chosen, screen: str) -> None:
    assert chosen("EGL", **{screen: ":0"}) is None


def test_a_set_variable_is_not_changed(chosen) -> None:
    assert chosen("EGL", MUJOCO_GL="osmesa") == "osmesa"


@pytest.mark.parametrize("value", ["", "off", "EGL ", "glfw"])
def test_values_of_mujoco_are_accepted(chosen, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setattr(mujoco_setup, "_can_load", lambda library: True)
    monkeypatch.setenv("MUJOCO_GL", value)
    mujoco_setup.check_rendering_backend()


@pytest.mark.parametrize(
    ("value", "library", "said"),
    [
        ("elg", True, "MUJOCO_GL=elg.*allowed: glx, egl, osmesa, glfw, off"),
        ("cgl", True, "MUJOCO_GL=cgl.*allowed"),
        ("osmesa", False, "the library OSMesa, which is not installed; install OSMesa, or unset MUJOCO_GL"),
    ],
)
def test_invalid_values_raise_an_error(
    chosen, monkeypatch: pytest.MonkeyPatch, value: str, library: bool, said: str
) -> None:
    monkeypatch.setattr(mujoco_setup, "_can_load", lambda _: library)
    monkeypatch.setenv("MUJOCO_GL", value)
    with pytest.raises(ValueError, match=said):
        mujoco_setup.check_rendering_backend()


def test_every_command_reports_an_invalid_backend_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "elg")
    said = CliRunner().invoke(app, ["envs"])
    assert said.exit_code == 1
    assert said.output.startswith(
        "avrgym: unknown value of the environment variable MUJOCO_GL=elg; allowed: "
    )
    assert said.output.count("\n") == 1
