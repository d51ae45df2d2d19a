"""Checks of the installation, with met and unmet requirements."""

from pathlib import Path

import pytest
from packaging.requirements import Requirement

from avrgym.doctor import installation
from avrgym.vr.server import web_server


@pytest.mark.parametrize(("running", "state"), [("3.10.14", "error"), ("3.11.0", "ok"), ("3.15.0rc1", "ok")])
def test_an_old_python_is_an_error(running: str, state: str) -> None:
    assert installation.check_python(running).state == state


def test_a_missing_and_an_old_package_are_named_with_the_line_that_brings_them() -> None:
    found = installation.check_packages(
        [Requirement(each) for each in ("numpy>=2.0", "mujoco>=1000", "no-such-package>=1")]
    )
    assert found.state == "error"
    assert "mujoco" in found.message
    assert "no-such-package is missing" in found.message
    assert "numpy" not in found.message
    assert found.fix == "pip install 'mujoco>=1000' 'no-such-package>=1'"


def test_requirements_are_read_from_the_metadata() -> None:
    by_itself = {each.name for each in installation.find_requirements()}
    assert {"mujoco", "numpy", "gymnasium"} <= by_itself
    assert {each.name for each in installation.find_requirements("browser")} == {"playwright"}
    assert not by_itself & {
        each.name
        for extra in installation.list_user_extras()
        for each in installation.find_requirements(extra)
    }
    assert installation.check_packages(installation.find_requirements()).state == "ok"


def test_all_user_extras_are_listed() -> None:
    offered = set(installation.list_user_extras())
    assert {"train", "lsl", "foxglove", "usd", "cluster"} <= offered
    assert not {"dev", "docs"} & offered


def test_a_missing_extra_is_ok_and_a_conflicting_version_a_warning() -> None:
    there, missing, other = ([Requirement(each)] for each in ("numpy", "no-such-package", "numpy>=1000"))
    found = installation.check_extras({"a": there, "b": missing})
    assert (found.state, "installed: a" in found.message, "avrgym[b]" in found.message) == ("ok", True, True)
    assert installation.check_extras({"a": other}).fix == "pip install 'numpy>=1000'"


def test_a_missing_client_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(web_server, "STATIC_FOLDER", tmp_path)
    for page in web_server.CLIENT_PAGES:
        assert installation.check_browser_client().state == "error"
        (tmp_path / page).touch()
    assert installation.check_browser_client().state == "ok"
