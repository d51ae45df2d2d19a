"""``avrgym study check`` reports before the first participant whether the study can run."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.study.checking.preflight import find_policy_errors, list_environment_policy_pairs
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, make_study

JACO = "avrgym/FeedingJaco-v1"


@pytest.fixture(autouse=True)
def _at_home(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    monkeypatch.chdir(tmp_path)


def with_own_policies(folder: Path, *scenes: str) -> Path:
    """A feeding study with custom policies, which are copies of packaged ones."""
    make_study(
        folder,
        tasks='["Feeding"]',
        robots='["PR2", "Jaco"]',
        policies='["mine"]',
        practice_policy='"mine"',
    )
    (folder / "mine").mkdir()
    for robot, scene in zip(("PR2", "Jaco"), scenes, strict=True):
        source = find_packaged_policies(f"avrgym/{scene}-v1")["revised"]
        shutil.copy(source, folder / "mine" / f"Feeding{robot}.safetensors")
    return folder


def check(folder: Path) -> tuple[int, list[str]]:
    """Exit code and output lines of ``avrgym study check``."""
    result = CliRunner().invoke(app, ["study", "check", str(folder)])
    return result.exit_code, (result.stdout + result.stderr).splitlines()


@pytest.mark.slow
def test_all_policies_are_loaded_in_all_environments(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path / "study")) as store:
        needed = list_environment_policy_pairs(store)
        assert len(needed) == len(set(needed)) == 4 * 2 * 2
        assert list(find_policy_errors(store)) == []
    code, lines = check(tmp_path / "study")
    assert (code, lines[-1]) == (0, "no errors")


def test_matching_custom_policies_are_accepted(tmp_path: Path) -> None:
    assert check(with_own_policies(tmp_path / "study", "FeedingPR2", "FeedingJaco"))[0] == 0


@pytest.mark.parametrize(
    ("changes", "where", "words"),
    [
        ({"policies": '["original", "revisd"]'}, "policy revisd", "original, revised, oracle, "),
        ({"practice_policy": '"revisd"'}, "policy revisd", "revisd/FeedingJaco.safetensors in its folder"),
        ({"policies": '["mine"]'}, "policy mine", "no policy 'mine' for avrgym/FeedingJaco-v1"),
        ({"tasks": '["Feding"]'}, "study.toml:14", "unknown name 'Feding'; allowed: Feeding, Drinking"),
        ({"robots": '["Jako"]'}, "study.toml:15", "unknown name 'Jako'; allowed: "),
    ],
)  # fmt: skip
def test_missing_policies_are_an_error(
    tmp_path: Path, changes: dict[str, str], where: str, words: str
) -> None:
    code, lines = check(make_study(tmp_path / "study", **({"tasks": '["Feeding"]'} | changes)))
    assert code == 1
    assert any(where in line and words in line for line in lines), lines


def test_files_in_the_working_directory_are_ignored(tmp_path: Path) -> None:
    shutil.copy(find_packaged_policies(JACO)["revised"], tmp_path / "revisd")
    code, _ = check(make_study(tmp_path / "study", tasks='["Feeding"]', policies='["revisd"]'))
    assert code == 1


def test_check_and_serve_report_the_same_fault(tmp_path: Path) -> None:
    """For a policy of another task and for a damaged file."""
    folder = with_own_policies(tmp_path / "study", "FeedingPR2", "ScratchItchJaco")
    for _ in range(2):
        code, lines = check(folder)
        with (
            StudyStore(folder) as store,
            pytest.raises(ValueError, match=r"mine/FeedingJaco\.safetensors") as refused,
        ):
            StudyVisit(store, enrol_with_consent(store))
        assert code == 1
        assert any(str(refused.value) in line for line in lines), lines
        (folder / "mine" / "FeedingJaco.safetensors").write_bytes(b"\x00" * 100)


def test_policy_of_another_robot_is_rejected(tmp_path: Path) -> None:
    """Both robots have equal sizes of observations and actions; the file contains its robot."""
    folder = with_own_policies(tmp_path / "feeding", "FeedingJaco", "FeedingJaco")
    words = f"trained for {JACO}, not for avrgym/FeedingPR2-v1"
    code, lines = check(folder)
    assert code == 1
    assert sum(words in line for line in lines) == 1
    policy = str(find_packaged_policies(JACO)["revised"])
    for command in (
        ["study", "simulate", str(folder), "--participants", "1"],
        ["serve", "--env", "avrgym/FeedingPR2-v1", "--policy", policy, "--port", "0"],
        ["view", "avrgym/FeedingPR2-v1", "--policy", policy, "--port", "0"],
        ["evaluate", "avrgym/FeedingPR2-v1", "--policy", policy, "--episodes", "1"],
    ):
        refused = CliRunner().invoke(app, command)
        assert refused.exit_code == 1
        (line,) = refused.stderr.splitlines()
        assert words in line
    allowed = CliRunner().invoke(app, [*command, "--allow-other-environment"])
    assert (allowed.exit_code, allowed.stderr) == (0, "")


def test_damaged_policy_files_raise_no_traceback(tmp_path: Path) -> None:
    """A damaged file either loads and runs, or raises an error with its name."""
    folder = with_own_policies(tmp_path / "study", "FeedingPR2", "FeedingJaco")
    path = folder / "mine" / "FeedingJaco.safetensors"
    whole = path.read_bytes()
    rng = np.random.default_rng(22)
    cut = rng.integers(0, len(whole), 40)
    with StudyStore(folder) as store:
        for size in cut:
            path.write_bytes(whole[:size])
            ((name, fault),) = find_policy_errors(store)
            assert (name, str(path) in fault) == ("mine", True)
        for place in [*range(0, 1000, 5), *rng.integers(0, len(whole), 100)]:
            damaged = bytearray(whole)
            damaged[place] ^= 1 << int(rng.integers(8))
            path.write_bytes(bytes(damaged))
            assert all(str(path) in fault for _, fault in find_policy_errors(store))
