"""A badly placed robot fails every check; every packaged robot passes them."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.learning.evaluation import evaluate
from avrgym.models.robot import Robot
from avrgym.robots import registry as robots
from avrgym.robots.jaco.robot import JACO
from avrgym.study.checking.preflight import check_initial_states as check_study_starts
from avrgym.study.people.participants import enrol_participant
from avrgym.study.sessions.dry_run import (
    find_or_enrol_participant,
    make_dry_run_settings,
    simulate_participant,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks import episodes, placement_check, registry, task_check
from avrgym.tasks.constants import make_environment_id
from avrgym.tasks.placement_check import (
    MAX_MEAN_SAMPLES,
    check_initial_states,
    count_samples_by_body,
    is_collision_free,
)
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.placements import offset_mount
from helpers.studies.small_studies import make_study
from helpers.system.paths import ROOT

sys.path.append(str(ROOT / "examples" / "extension" / "src"))
sys.path.append(str(ROOT / "src" / "avrgym" / "skeletons" / "templates" / "robot" / "src"))

from avrgym_example.fetch import FETCH
from example_arm.robot import ROBOT as SKELETON

ENVIRONMENT = "avrgym/FeedingJaco-v1"
CROWDED_M, REFUSED_M = (0.1, 0.0, 0.0), (0.15, 0.0, 0.0)
"""How far Jaco's mount is moved: its elbow is often in the table, and always."""
FEW_DRAWS = 5


@pytest.fixture(autouse=True)
def afresh():
    """Starts are drawn in each test."""
    count_samples_by_body.cache_clear()
    yield
    count_samples_by_body.cache_clear()


@pytest.fixture
def crowded(monkeypatch: pytest.MonkeyPatch) -> None:
    offset_mount(monkeypatch, *CROWDED_M)


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> None:
    offset_mount(monkeypatch, *REFUSED_M)
    monkeypatch.setattr(episodes, "MAX_START_SAMPLES", FEW_DRAWS)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]')


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_packaged_robots_pass_the_placement_check(environment: str) -> None:
    drawn = check_initial_states(environment)
    print(
        f"{environment}: {drawn.mean_samples:.2f} draws a start with random people, {drawn.max_samples} at most"
    )
    assert drawn.mean_samples <= 1.25
    assert all(each.max_samples == 1 for _, each in count_samples_by_body(environment))


@pytest.mark.slow
@pytest.mark.parametrize("robot", [FETCH, SKELETON], ids=lambda robot: robot.name)
def test_example_robots_pass_the_placement_check(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(robots._robots, robot.name, robot)
    for task in ("Feeding", "Drinking", "ScratchItch", "BedBathing"):
        environment = make_environment_id(task, robot.name)
        monkeypatch.setitem(registry._REGISTRY.environments, environment, (task, robot.name))
    drawn = placement_check.check_placement(robot.name)
    assert len(drawn) == 4
    print({environment: (each.mean_samples, each.max_samples) for environment, each in drawn.items()})


def test_a_robot_in_the_table_fails_its_check_and_that_of_the_task(
    crowded: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = rf"FeedingJaco-v1: an initial state is sampled \d\.\d times .* allowed: {MAX_MEAN_SAMPLES:g}"
    with pytest.raises(ValueError, match=words):
        placement_check.check_placement("Jaco")
    monkeypatch.setattr(task_check, "ENVIRONMENTS", {ENVIRONMENT: ("Feeding", "Jaco")})
    with pytest.raises(ValueError, match=words):
        task_check.check_task("Feeding")


def test_a_body_without_an_initial_state_is_named(refused: None) -> None:
    with pytest.raises(
        ValueError, match=rf"none of {FEW_DRAWS} initial states .* the robot's link \d .* inside the table"
    ):
        check_initial_states(ENVIRONMENT)


def test_evaluation_reports_draws_and_warns_above_the_limit(crowded: None, tmp_path: Path) -> None:
    brief = "--episodes", "8", "--episode-steps", "1", "--jobs", "1"
    asked = ["evaluate", ENVIRONMENT, "--policy", "zero", *brief]
    ran = CliRunner().invoke(app, [*asked, "--json", str(tmp_path / "rows.json")])
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert MAX_MEAN_SAMPLES < row["start_draws_mean"] <= row["start_draws_max"]
    assert row["starts_refused"] == round(8 * (row["start_draws_mean"] - 1.0))
    assert f"an initial state is sampled {row['start_draws_mean']:.1f} times on average" in ran.stderr
    assert f"{row['starts_refused']} people were omitted" in ran.stderr


def test_evaluation_of_a_robot_with_room_counts_one_draw_a_start() -> None:
    row = evaluate("avrgym/FeedingPR2-v1", "zero", "revised", 4, 0, steps=1)
    assert (row.start_draws_mean, row.start_draws_max, row.starts_refused) == (1.0, 1, 0)


def test_a_study_is_checked_for_each_body_before_anybody_takes_part(refused: None, folder: Path) -> None:
    with StudyStore(folder) as store:
        found = list(check_study_starts(store))
    assert [(each.where, each.is_error) for each in found] == [(ENVIRONMENT, True)] * 4
    bodies = [f"a {sex} with a torso of {height}" for sex in ("man", "woman") for height in ("0.40", "0.75")]
    assert all(sum(body in each.message for each in found) == 1 for body in bodies)
    ran = CliRunner().invoke(app, ["study", "check", str(folder)])
    assert ran.exit_code == 1
    assert "inside the table" in ran.output


def test_a_study_check_reports_often_rejected_bodies(crowded: None, folder: Path) -> None:
    with StudyStore(folder) as store:
        found = list(check_study_starts(store))
    assert found
    assert not any(each.is_error for each in found)
    assert "an initial state is sampled" in found[0].message


def test_a_task_whose_starts_cannot_be_drawn_is_wrong(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise KeyError("elbow")

    monkeypatch.setattr("avrgym.study.checking.preflight.count_samples_by_body", broken)
    with StudyStore(folder) as store:
        (found,) = check_study_starts(store)
    assert (found.is_error, found.message) == (True, "no initial state can be sampled: KeyError: 'elbow'")


def test_a_study_of_ours_has_room(folder: Path) -> None:
    with StudyStore(folder) as store:
        assert list(check_study_starts(store)) == []


def test_a_dry_run_without_room_names_environment_body_and_what_is_in_the_way(
    refused: None, folder: Path
) -> None:
    cast = make_dry_run_settings(0, "participants", "none")
    with StudyStore(folder) as store:
        pseudonym = find_or_enrol_participant(store, 0, cast)
        assert enrol_participant(store, "woman") != pseudonym
    words = rf"{pseudonym} ses-01 cannot start: {ENVIRONMENT}: none of .* inside the table; .*`avrgym study check`"
    with pytest.raises(StudyError, match=words):
        simulate_participant(folder, pseudonym, cast)


def test_colliding_poses_are_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    seed = JACO.arms["right"].seed_pose
    random = np.random.default_rng(0).uniform(-np.pi, np.pi, (20, len(seed)))
    clear = is_collision_free("Feeding", JACO, np.array([seed, *random]))
    assert clear[0]
    assert 0 < clear[1:].sum() < 20
    assert is_collision_free("Feeding", JACO, random[:3]).tolist() == clear[1:4].tolist()
    assert is_collision_free("Feeding", JACO, random[:0]).shape == (0,)


def test_the_page_s_search_finds_a_collision_free_seed_pose() -> None:
    """With Jaco where many poses are in the table, greatest isotropy alone chooses one of them."""
    page = (ROOT / "docs" / "how_to" / "add_a_robot.md").read_text()
    (search,) = (
        block for block in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S) if "isotropy" in block
    )
    mount = JACO.mounts["wheelchair"]
    moved = replace(mount, pos_w=(mount.pos_w[0] + 0.1, *mount.pos_w[1:]))
    robot = replace(JACO, mounts={**JACO.mounts, "wheelchair": moved})
    assert is_collision_free("Feeding", robot, best(search, robot)).all()
    without = search.replace("poses = poses[is_collision_free", "# ")
    assert not is_collision_free("Feeding", robot, best(without, robot)).any()


def best(search: str, robot: Robot) -> np.ndarray:
    """The pose (1, J) that the page's code prints, radians."""
    names = dict[str, Any](ROBOT=robot)
    exec(search.replace("print(", "best = (").replace(".round()", ""), names)
    return names["best"][None]
