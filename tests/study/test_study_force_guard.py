"""The design of a study contains the setting of the force guard."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text
from avrgym.study.sessions.study_visit import plan_session
from avrgym.study.storage.store import StudyStore
from helpers.studies.known_results import enrol_included
from helpers.studies.small_studies import make_study

LINE = "force_guard = true\n"


def test_default_of_the_force_guard() -> None:
    assert parse_design(read_default_design_text()).force_guard
    assert not parse_design(read_default_design_text().replace(LINE, "")).force_guard
    with pytest.raises(DesignError, match="force_guard"):
        parse_design(read_default_design_text().replace(LINE, 'force_guard = "yes"\n'))


@pytest.mark.parametrize("force_guard", ["true", "false"])
def test_sessions_use_the_force_guard_of_the_design(tmp_path: Path, force_guard: str) -> None:
    with StudyStore(make_study(tmp_path / "study", force_guard=force_guard)) as store:
        plan = plan_session(store, enrol_included(store))
    assert plan.has_force_guard == (force_guard == "true")


def test_server_has_no_force_guard_option_for_studies(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study")
    for option in ("--force-guard", "--no-force-guard"):
        refused = CliRunner().invoke(app, ["serve", "--study", str(folder), option])
        assert refused.exit_code == 1
        assert f"force_guard in {folder / 'study.toml'}" in refused.output
