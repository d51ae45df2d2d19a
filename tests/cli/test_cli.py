"""The command ``avrgym``: help, JSON output, and one-line errors."""

import inspect
import json
import os
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.main import get_command
from typer.testing import CliRunner, Result

from avrgym.cli.evaluation import OMITTED_METRICS
from avrgym.cli.main import app
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.system.processes import AVRGYM, kill_with_parent
from helpers.vr.visit import ENVIRONMENT, constant_policy

ROW_KEYS = [
    "env", "policy", "people", "impairment", "split", "episodes", "reward_mean", "reward_std", "success_rate",
    "success_ci95", "force_mean_newton", "episodes_over_limit", "guard_interventions",
    "engine", "device",
]  # fmt: skip
PROGRAM = get_command(app)


def _commands(group, *path: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    for name, command in sorted(group.commands.items()):
        if hasattr(command, "commands"):
            yield from _commands(command, *path, name)
        else:
            yield (*path, name), command


COMMANDS = dict(_commands(PROGRAM))


def avrgym(*arguments: str | Path | int) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run in an empty folder."""
    monkeypatch.chdir(tmp_path)


# Help --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_every_command_and_option_has_help(command: tuple[str, ...]) -> None:
    shown = avrgym(*command, "--help")
    assert shown.exit_code == 0
    declared = COMMANDS[command]
    words = inspect.getdoc(declared.callback)
    assert words
    assert words.splitlines()[0].split()[0] in shown.stdout
    assert all(option.help for option in declared.params)


@pytest.mark.parametrize("group", ["", "study", "new", "bench"])
def test_no_summary_of_a_command_is_truncated(group: str) -> None:
    shown = avrgym(*group.split(), "--help").stdout.partition("Commands:")[2]
    assert shown
    assert "..." not in shown


def test_without_a_command_it_lists_them() -> None:
    shown = avrgym()
    assert all(command[0] in shown.output for command in COMMANDS)


def test_json_output_replaces_only_regular_files(tmp_path: Path) -> None:
    """Links, pipes, sockets and folders are not replaced."""
    (tmp_path / "target.json").write_text("old")
    (tmp_path / "link").symlink_to("target.json")
    (tmp_path / "nowhere").symlink_to("missing.json")
    (tmp_path / "device").symlink_to("/dev/null")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind("socket")
        before = sorted((path.name, path.lstat().st_mode) for path in tmp_path.iterdir())
        for name in ("link", "nowhere", "device", "folder", "pipe", "socket"):
            assert f"cannot write {name}: it is not a regular file" in error_line(
                avrgym("envs", "--json", name)
            )
        assert sorted((path.name, path.lstat().st_mode) for path in tmp_path.iterdir()) == before
    assert (tmp_path / "target.json").read_text() == "old"
    assert avrgym("envs", "--json", "target.json").exit_code == 0
    assert len(json.loads((tmp_path / "target.json").read_text())) == len(ENVIRONMENTS)


# JSON output -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_evaluate_writes_a_row_for_each_environment(tmp_path: Path) -> None:
    file = tmp_path / "values.json"
    result = avrgym(
        "evaluate",
        "--all",
        "--policy",
        "zero",
        "--people",
        "original",
        "--episodes",
        2,
        "--seed",
        3,
        "--json",
        file,
    )
    assert result.exit_code == 0
    rows = json.loads(file.read_text())
    assert [row["env"] for row in rows] == list(ENVIRONMENTS)
    for row in rows:
        assert {*row} == {*ROW_KEYS, *OMITTED_METRICS}
        assert (row["policy"], row["people"], row["episodes"]) == ("zero", "original", 2)
        assert row["success_ci95"][0] <= row["success_rate"] <= row["success_ci95"][1]
    assert all(name in result.stdout for name in ROW_KEYS)


def test_evaluate_shows_forces_by_region(tmp_path: Path) -> None:
    arguments = (
        "evaluate",
        ENVIRONMENT,
        "--episodes",
        1,
        "--seed",
        3,
        "--regions",
        "--force-guard",
        "--json",
        "rows.json",
    )
    shown = avrgym(*arguments)
    assert shown.exit_code == 0, shown.output
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    assert row["guard_interventions"] >= 0.0
    touched = {name: values for name, values in row["force_regions"].items() if values["peak_n"]}
    assert touched.keys() <= {"face", "skull"}
    for name, values in touched.items():
        assert f"{name} " in shown.stdout
        assert f"{values['quasi_static_limit_n']:.3g}" in shown.stdout
    nobody = avrgym("evaluate", ENVIRONMENT, "--policy", "zero", "--episodes", 1, "--regions")
    assert "There were no contact forces." in nobody.stdout


@pytest.mark.slow
def test_evaluate_shows_the_cross_play_matrix(tmp_path: Path) -> None:
    file = tmp_path / "rows.json"
    arguments = [
        "evaluate",
        ENVIRONMENT,
        "--cross-play",
        "--episodes",
        1,
        "--json",
        file,
        "--impairment",
        "tremor",
    ]
    result = avrgym(*arguments, "--policy", "zero", "--people", "original", "--people", "zoo/unseen")
    assert result.exit_code == 0, result.output
    rows = json.loads(file.read_text())
    assert [(row["policy"], row["people"], row["impairment"]) for row in rows] == [
        ("zero", "original", "tremor"),
        ("zero", "zoo/unseen", "tremor"),
    ]
    assert result.stdout.count("0% [0, 79]") == 2
    assert "zoo/unseen" in result.stdout


def test_evaluate_takes_a_policy_file(tmp_path: Path) -> None:
    file = tmp_path / "drive.safetensors"
    constant_policy(ENVIRONMENT).save(file)
    result = avrgym(
        "evaluate", ENVIRONMENT, "--policy", file, "--episodes", 1, "--json", tmp_path / "rows.json"
    )
    assert result.exit_code == 0
    assert json.loads((tmp_path / "rows.json").read_text())[0]["policy"] == str(file)


def test_envs_lists_the_environments(tmp_path: Path) -> None:
    file = tmp_path / "envs.json"
    assert avrgym("envs", "--json", file).exit_code == 0
    rows = json.loads(file.read_text())
    assert [row["env"] for row in rows] == list(ENVIRONMENTS)
    assert list(rows[0]) == ["env", "task", "robot", "observation_size", "policies"]


@pytest.mark.slow
def test_bench_sim_compares_episodes_with_physics_alone(tmp_path: Path) -> None:
    file = tmp_path / "speed.json"
    result = avrgym("bench", "sim", "--env", ENVIRONMENT, "--num-envs", 2, "--json", file)
    assert result.exit_code == 0
    (row,) = json.loads(file.read_text())
    assert list(row) == [
        "env", "engine", "device", "num_envs", "threads", "steps_per_second", "reset_ms_per_env",
        "physics_steps_per_second", "ratio",
    ]  # fmt: skip
    assert [row[name] for name in list(row)[:4]] == [ENVIRONMENT, "threads", "cpu", 2]
    assert all(row[name] > 0 for name in list(row)[3:])


# Errors --------------------------------------------------------------------------------------


@pytest.fixture
def used_port() -> Iterator[int]:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        yield listener.getsockname()[1]


def error_line(result: Result) -> str:
    """Return the line on stderr of a failed command."""
    assert result.exit_code == 1
    assert isinstance(result.exception, SystemExit)
    assert result.stderr.endswith("\n")
    (line,) = result.stderr.splitlines()
    assert line.startswith("avrgym: ")
    return line


@pytest.mark.parametrize(
    ("arguments", "allowed"),
    [
        (["evaluate"], f"allowed: --all, or some of {ENVIRONMENT}"),
        (["evaluate", "avrgym/Nope-v1"], ENVIRONMENT),
        (["evaluate", ENVIRONMENT, "--people", "martians"], "original, revised"),
        (["evaluate", ENVIRONMENT, "--impairment", "gout"], "none, limits, weakness, tremor"),
        (["view", ENVIRONMENT, "--impairment", "gout", "--port", "0"], "none, limits, weakness, tremor"),
        (["study", "simulate", ".", "--people", "martians"], "zoo/train, zoo/unseen"),
        (["evaluate", ENVIRONMENT, "--policy", "nope"], "original, revised, oracle, random, zero, FILE"),
        (
            ["evaluate", ENVIRONMENT, "--policy", "no/such.safetensors"],
            "original, revised, oracle, random, zero, FILE",
        ),
        (["evaluate", ENVIRONMENT, "--policy", "."], "original, revised, oracle, random, zero, FILE"),
        (["evaluate", ENVIRONMENT, "--json", "no/such/folder.json"], "the folder no/such does not exist"),
        (["evaluate", ENVIRONMENT, "--policy", "zero", "--episodes", "1", "--json", "."], "."),
        (["evaluate", ENVIRONMENT, "--json", "/dev/null"], "/dev/null: it is not a regular file"),
        (["envs", "--json", "no/such/folder.json"], "no/such"),
        (["envs", "--json", "/dev/stdout"], "not a regular file"),
        (["train", "avrgym/Nope-v1"], ENVIRONMENT),
        (["serve", "--env", "avrgym/Nope-v1"], ENVIRONMENT),
        (["serve", "--person", "child"], "man, woman"),
        (["serve", "--policy", "nope"], "original, revised, oracle, random, zero, FILE"),
        (["serve", "--host", "no.such.host.invalid"], "--host"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_an_unknown_name_lists_the_allowed_names(arguments: list[str], allowed: str) -> None:
    assert allowed in error_line(avrgym(*arguments))


@pytest.mark.parametrize("content", [b"", b"nonsense" * 100, b"\x08" + b"\x00" * 7 + b"{}      "])
def test_an_invalid_policy_file_is_rejected(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "policy.safetensors"
    file.write_bytes(content)
    for command in (["evaluate", ENVIRONMENT], ["serve"]):
        line = error_line(avrgym(*command, "--policy", file))
        assert str(file) in line


def test_a_folder_with_a_training_is_rejected(tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    (tmp_path / "configuration.json").write_text("{}")
    assert "choose another folder" in error_line(avrgym("train", ENVIRONMENT, "--out", tmp_path))
    wrong = avrgym("train", ENVIRONMENT, "--people", "martians", "--out", tmp_path / "new")
    assert "original, revised" in error_line(wrong)
    assert not (tmp_path / "new").exists()


def test_an_error_names_the_used_port(used_port: int) -> None:
    line = error_line(avrgym("serve", "--port", used_port))
    assert f"127.0.0.1:{used_port}" in line
    assert "--port" in line


def test_demo_rejects_a_file_as_output_folder(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("")
    assert "out" in error_line(avrgym("demo", "--out", tmp_path / "out"))


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["evaluate", ENVIRONMENT, "--episodes", "0"], "--episodes"),
        (["evaluate", ENVIRONMENT, "--seed", "-1"], "--seed"),
        (["serve", "--port", "65536"], "--port"),
        (["serve", "--trials", "0"], "--trials"),
        (["train"], "env"),
        (["train", ENVIRONMENT, "--steps", "many"], "--steps"),
        (["nope"], "nope"),
    ],
    ids=lambda part: " ".join(part) if isinstance(part, list) else "",
)
def test_usage_errors_name_the_argument(arguments: list[str], named: str) -> None:
    result = avrgym(*arguments)
    assert result.exit_code == 2
    assert named in result.stderr.partition("Error")[2].lower()
    assert "Traceback" not in result.output


# Process ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_serve_prints_its_address_and_stops_on_sigint(tmp_path: Path) -> None:
    command = [AVRGYM, "serve", "--port", "0", "--study", tmp_path / "study"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=kill_with_parent
    ) as running:
        assert running.stdout is not None
        address = next(line.strip() for line in running.stdout if "/#token=" in line)
        assert httpx.get(address.partition("#")[0], timeout=60.0).status_code == 200
        running.send_signal(signal.SIGINT)
        rest, errors = running.communicate(timeout=60.0)
    assert running.returncode == 0
    assert "stopped" in rest
    assert errors == ""
    assert not (tmp_path / "study").exists()
