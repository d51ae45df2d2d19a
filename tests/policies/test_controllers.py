"""After any failure of a controller the robot stops and the session continues."""

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.learning import evaluation
from avrgym.learning.evaluation import evaluate, evaluate_all
from avrgym.policies import controllers
from avrgym.policies.controllers import ControllerError, ExternalController
from avrgym.policies.registry import resolve_policy
from avrgym.policies.trained_policies import Policy, PolicyError
from avrgym.recording.reader import Recording, read_recording
from avrgym.recording.schema import Control
from avrgym.replay.verification import verify_recording
from avrgym.study.sessions.dry_run import simulate_study
from avrgym.study.storage.store import StudyStore
from avrgym.system import plugins
from avrgym.vr.live_world import drivers
from avrgym.vr.protocol.messages import TICK_S, Problem
from avrgym.vr.session import events
from avrgym.vr.session.plan import SessionPlan, load_policies
from avrgym.vr.session.session import Session
from helpers.learning import failing_controllers
from helpers.learning.onnx_files import save_onnx
from helpers.studies.small_studies import make_study
from helpers.system.paths import ROOT
from helpers.vr.visit import ENVIRONMENT, Visit, constant_policy, plan

FAILURES = {
    "NotFinite": "not_finite",
    "Infinite": "not_finite",
    "WrongShape": "wrong_shape",
    "TooFew": "wrong_shape",
    "Words": "exception",
    "Nothing": "wrong_shape",
    "Raises": "exception",
    "LeavesAtOnce": "exception",
}
"""Controllers that fail at their second or third step, and the kind of failure that is reported."""
STEPS = 6


def driven_by(name: str, **changes) -> SessionPlan:
    """One short trial with a controller of ``failing_controllers``."""
    planned = plan(trial_steps=STEPS, **changes)
    trials = [
        replace(trial, policy=f"helpers.learning.failing_controllers:{name}") for trial in planned.trials
    ]
    return replace(planned, trials=trials)


def completed(visit: Visit) -> list[Recording]:
    """Run a visit to its end, in real time if controllers run in threads."""
    visit.calibrate()
    while visit.phase != "finished":
        if visit.phase == "questionnaire":
            visit.answer(1)
        visit.tick()
    visit.leave()
    return visit.recordings()


class LiveVisit(Visit):
    """A visit on the wall's clock."""

    def tick(self, count: int = 1) -> None:
        for _ in range(count):
            began_s = time.monotonic()
            super().tick()
            if self.phase == "trial":
                time.sleep(max(0.0, TICK_S - (time.monotonic() - began_s)))


@pytest.fixture
def workers() -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(1) as workers:
        yield workers


def live(folder: Path, plan: SessionPlan, workers: ThreadPoolExecutor) -> LiveVisit:
    """A visit with controllers in threads."""
    told: list[events.SessionEvent] = []
    visit = LiveVisit(
        folder,
        plan,
        make=lambda send: Session(
            plan, load_policies(plan), folder, send, "live", observe=told.append, workers=workers
        ),
    )
    visit.observed = told
    return visit


def steps_of(recording: Recording) -> list[Control]:
    return [step for _, step in recording.messages_by_topic["/control"]]


def events_of(recording: Recording) -> list[tuple[str, str]]:
    named = [(event.name, event.detail) for _, event in recording.messages_by_topic["/events"]]
    return [each for each in named if each[0].startswith("controller")]


def check_held(recording: Recording, name: str, kind: str) -> None:
    """A recording of a trial in which a controller failed at its second and third step, and drove again."""
    steps = steps_of(recording)
    assert [step.idle for step in steps] == [False, True, True, False, False, False]
    assert {step.driver for step in steps} == {f"helpers.learning.failing_controllers:{name}"}
    assert all(step.action[0] == (0.0 if step.idle else 0.5) for step in steps)
    failed, *_, drives = events_of(recording)
    assert failed[0] == "controller_failed"
    assert failed[1].partition(":")[0] == kind
    assert drives == ("controller_drives", "")
    assert recording.outcome is not None
    assert recording.outcome.result == "completed"
    assert verify_recording(recording).is_identical


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("name", "kind"), FAILURES.items())
def test_after_a_failure_the_robot_stops_and_the_session_completes(
    tmp_path: Path, name: str, kind: str
) -> None:
    visit = Visit(tmp_path, driven_by(name), load_policies(driven_by(name)))
    (recording,) = completed(visit)
    check_held(recording, name, kind)
    (problem,) = visit.received(Problem)
    assert (problem.role, kind in problem.message) == ("experimenter", True)
    (told,) = [each for each in visit.observed if isinstance(each, events.ControllerFailed)]
    assert told.reason.startswith(f"{kind}: ")
    assert told.reason.isprintable()


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("name", "kind"), FAILURES.items())
def test_failures_in_a_live_session_stop_the_robot_too(
    tmp_path: Path, workers: ThreadPoolExecutor, name: str, kind: str
) -> None:
    (recording,) = completed(live(tmp_path, driven_by(name), workers))
    steps = steps_of(recording)
    assert len(steps) == STEPS
    assert all(step.action[0] == 0.0 for step in steps if step.idle)
    assert kind in {
        detail.partition(":")[0] for event, detail in events_of(recording) if event == "controller_failed"
    }
    assert verify_recording(recording).is_identical


def test_a_controller_without_answer_is_replaced(tmp_path: Path, workers: ThreadPoolExecutor) -> None:
    visit = live(tmp_path, driven_by("Hangs", seeds=(3, 4)), workers)
    recordings = completed(visit)
    assert len(recordings) == 2
    for recording in recordings:
        steps = steps_of(recording)
        assert steps[0].action[0] == 0.5, "a fresh controller drives every trial"
        assert [step.idle for step in steps[2:]] == [True] * (STEPS - 2)
        assert events_of(recording) == [("controller_failed", "late: no answer within 80 ms")]
        assert verify_recording(recording).is_identical


def test_a_controller_without_answer_does_not_block_simulated_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drivers, "SIMULATED_CONTROLLER_TIMEOUT_S", 0.2)
    plan = driven_by("Hangs", seeds=(3, 4))
    recordings = completed(Visit(tmp_path, plan, load_policies(plan)))
    assert len(recordings) == 2
    for recording in recordings:
        assert [step.idle for step in steps_of(recording)] == [False] + [True] * (STEPS - 1)
        assert events_of(recording) == [("controller_failed", "late: no answer within 200 ms")]
        assert verify_recording(recording).is_identical


def test_a_late_action_is_dropped(tmp_path: Path, workers: ThreadPoolExecutor) -> None:
    visit = live(tmp_path, driven_by("Slow"), workers)
    (recording,) = completed(visit)
    actions = {command.action[0] for _, command in recording.messages_by_topic["/commands"]}
    assert actions == {0.5, 0.0}, "what came after a quarter of a second would have been -0.5"
    assert ("controller_failed", "late: no answer within 80 ms") in events_of(recording)
    assert verify_recording(recording).is_identical


def test_a_controller_that_fails_to_reset_never_drives(tmp_path: Path) -> None:
    visit = Visit(tmp_path, driven_by("RaisesAtReset"), load_policies(driven_by("RaisesAtReset")))
    (recording,) = completed(visit)
    assert all(step.idle and not any(step.action) for step in steps_of(recording))
    assert events_of(recording) == [("controller_failed", "exception: RuntimeError: not today")]


def test_controllers_are_closed_with_their_session(tmp_path: Path) -> None:
    before = failing_controllers.Steady.closed
    completed(Visit(tmp_path, driven_by("Steady"), load_policies(driven_by("Steady"))))
    assert failing_controllers.Steady.closed == before + 2, (
        "the one that was tried out, and the one that drove"
    )


@pytest.mark.slow
def test_results_follow_from_the_seed_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever runs beside, in however many processes, and whether each is made or copied."""
    noisy, ready = (
        "helpers.learning.failing_controllers:Noisy",
        "helpers.learning.failing_controllers:READY",
    )
    first = evaluate(ENVIRONMENT, noisy, "original", 3, 0)
    assert first == evaluate_all([ENVIRONMENT], noisy, "original", 3, 0, jobs=2)[0]
    assert first == replace(evaluate(ENVIRONMENT, ready, "original", 3, 0), policy=noisy)
    assert first != evaluate(ENVIRONMENT, noisy, "original", 3, 1)
    monkeypatch.setattr(evaluation, "MAX_WORLDS_PER_BATCH", 2)
    assert first == evaluate(ENVIRONMENT, noisy, "original", 3, 0)


def test_a_failure_ends_an_evaluation_in_one_line() -> None:
    with pytest.raises(ControllerError, match=r"^not_finite: "):
        evaluate(ENVIRONMENT, "helpers.learning.failing_controllers:NotFinite", "original", 1, 0)
    ended = CliRunner().invoke(
        app,
        [
            "evaluate",
            ENVIRONMENT,
            "--policy",
            "helpers.learning.failing_controllers:Raises",
            "--episodes",
            "1",
        ],
    )
    assert ended.exit_code == 1
    (line,) = ended.stderr.splitlines()
    assert "exception: KeyError" in line


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_module:Thing", "cannot be imported (ModuleNotFoundError: No module named 'no_such_module')"),
        ("helpers.learning.failing_controllers:Missing", "has no attribute 'Missing'"),
        ("helpers.learning.failing_controllers:", "has no attribute ''"),
        (":Steady", "cannot be imported (ValueError: Empty module name)"),
        (
            "helpers.learning.failing_controllers:WithoutReset",
            "WithoutReset has no method reset; a controller needs the methods reset(seed, environment)",
        ),
        ("helpers.learning.failing_controllers:unmakeable", "cannot be created (FileNotFoundError: weights.bin)"),
        ("helpers.learning.failing_controllers:READY.rng.x", "has no attribute 'rng'"),
        ("operator", "operator needs an experimenter at the robot's controls"),
        ("nobody", "allowed: adaptive, original, revised, oracle, random, zero, "),
        ("nobody.onnx", "no policy 'nobody.onnx'"),
    ],
)  # fmt: skip
def test_unsuitable_controllers_are_refused_in_one_line(name: str, words: str) -> None:
    with pytest.raises(PolicyError) as refused:
        resolve_policy(name, ENVIRONMENT)
    assert words in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("policy", ["original", "revised"])
@pytest.mark.parametrize("rows", [1, None, "N"])
def test_a_packaged_policy_as_onnx_acts_the_same(tmp_path: Path, policy: str, rows: int | str | None) -> None:
    """Its mean action, to 1e-6: one row or several at a time, single precision or double."""
    packaged = resolve_policy(policy, ENVIRONMENT)
    assert isinstance(packaged, Policy)
    rng = np.random.default_rng(0)
    observations = rng.normal(packaged.observation_mean, np.sqrt(packaged.observation_variance), (50, 25))
    expected = np.clip(packaged.compute_mean_actions(observations), -1, 1)
    for double, tolerance in ((True, 1e-6), (False, 2e-4)):
        path = tmp_path / f"{double}.onnx"
        save_onnx(packaged, path, rows, double=double)
        found = resolve_policy(str(path), ENVIRONMENT)
        assert isinstance(found, ExternalController)
        actions = [
            controllers.compute_controller_action(found.make_controller(), observation, 7)
            for observation in observations
        ]
        np.testing.assert_allclose(actions, expected, rtol=0, atol=tolerance)


def test_an_onnx_file_drives_a_session_and_an_evaluation(tmp_path: Path, workers: ThreadPoolExecutor) -> None:
    path = tmp_path / "calm.onnx"
    save_onnx(replace(constant_policy(ENVIRONMENT), action_std=0.0), path, 1, double=False)
    planned = plan(trial_steps=STEPS)
    planned = replace(planned, trials=[replace(planned.trials[0], policy=str(path))])
    (recording,) = completed(live(tmp_path / "recordings", planned, workers))
    assert {
        round(abs(value), 3) for step in steps_of(recording) if not step.idle for value in step.action
    } == {0.6}
    assert verify_recording(recording).is_identical
    assert evaluate(ENVIRONMENT, str(path), "original", 1, 0).episodes == 1


def test_unsuitable_onnx_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    save_onnx(constant_policy("avrgym/BedBathingJaco-v1"), path, 1, double=False)
    with pytest.raises(
        PolicyError,
        match=r"allowed for avrgym/\w+-v1: one input of float or double, of shape \(25,\), \(1, 25\)",
    ):
        resolve_policy(str(path), ENVIRONMENT)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(PolicyError, match=r"net\.onnx: not a readable \.onnx file"):
        resolve_policy(str(path), ENVIRONMENT)


OBJECTS = """
import functools
import numpy as np

class Plain:
    def __init__(self, scale=0.5):
        self.scale = scale
    def reset(self, seed, environment):
        pass
    def act(self, observation):
        return np.full(7, self.scale * np.tanh(observation[0]))

class Group:
    Inner = Plain

INSTANCE = Plain()
PARTIAL = functools.partial(Plain, 0.5)
COMPUTE = lambda observation: Plain().act(observation)

def make():
    return Plain()

def compute(observation, scale=0.5):
    return Plain(scale).act(observation)

class Callable:
    def __call__(self, observation):
        return compute(observation)

CALLABLE = Callable()

def two(observation, other):
    return compute(observation)
"""


def test_a_class_an_instance_a_factory_and_a_function_drive_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "kinds_of_objects.py").write_text(OBJECTS)
    monkeypatch.syspath_prepend(tmp_path)
    observation = np.linspace(0.3, 1.0, 25)
    expected = np.full(7, 0.5 * np.tanh(0.3))
    for attribute in (
        "Plain",
        "Group.Inner",
        "INSTANCE",
        "PARTIAL",
        "make",
        "compute",
        "COMPUTE",
        "CALLABLE",
    ):
        found = resolve_policy(f"kinds_of_objects:{attribute}", ENVIRONMENT)
        assert isinstance(found, ExternalController)
        controller = found.make_controller()
        controllers.reset_controller(controller, 1, ENVIRONMENT)
        np.testing.assert_array_equal(
            controllers.compute_controller_action(controller, observation, 7), expected
        )
    with pytest.raises(PolicyError, match=r"kinds_of_objects:two: cannot be created \(TypeError"):
        resolve_policy("kinds_of_objects:two", ENVIRONMENT)


@pytest.mark.slow
def test_the_documented_controller_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From the folder where the program runs."""
    page = (ROOT / "docs" / "how_to" / "add_a_controller.md").read_text()
    code = page.partition("```python\n# mine.py\n")[2].partition("```")[0]
    (tmp_path / "mine.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    one, same = (evaluate(ENVIRONMENT, "mine:Reach", "original", 2, 0) for _ in range(2))
    assert one == same


@pytest.mark.slow
def test_a_study_takes_controllers_of_all_kinds(tmp_path: Path) -> None:
    def study(name: str, policies: str) -> Path:
        choices = {
            "tasks": '["Feeding"]',
            "robots": '["Jaco"]',
            "policies": policies,
            "practice_policy": '""',
        }
        return make_study(tmp_path / name, **choices, trial_steps="3", free_movement_s="0.0")

    folder = study("study", '["helpers.learning.failing_controllers:Raises", "zero", "ours"]')
    (folder / "ours").mkdir()
    save_onnx(constant_policy(ENVIRONMENT), folder / "ours" / "FeedingJaco.onnx", 1, double=False)
    assert CliRunner().invoke(app, ["study", "check", str(folder)]).exit_code == 0
    simulate_study(folder, 1, 0, jobs=1)
    with StudyStore(folder) as store:
        assert {trial.state for trial in store.read_trials("sub-001")} == {"completed"}
        assert [event for event in store.read_events() if event.name == "controller failed"]
    recordings = [read_recording(path) for path in folder.rglob("*.mcap")]
    drivers = {step.driver for recording in recordings for step in steps_of(recording)}
    assert drivers == {"helpers.learning.failing_controllers:Raises", "zero", "ours"}
    assert all(verify_recording(recording).is_identical for recording in recordings)

    with_operator = study("operated", '["operator"]')
    assert CliRunner().invoke(app, ["study", "check", str(with_operator)]).exit_code == 0
    refused = CliRunner().invoke(app, ["study", "simulate", str(with_operator), "--participants", "1"])
    assert (refused.exit_code, "needs a human operator, but a dry run has none" in refused.stderr) == (
        1,
        True,
    )


def test_a_broken_plugin_does_not_affect_others(monkeypatch: pytest.MonkeyPatch) -> None:
    group = plugins.CONTROLLER_ENTRY_POINT_GROUP
    found = [
        EntryPoint("calm", "helpers.learning.failing_controllers:Steady", group),
        EntryPoint("broken", "no_such_module:Thing", group),
    ]
    monkeypatch.setattr(plugins, "list_entry_points", lambda group: found)
    assert resolve_policy("calm", ENVIRONMENT).name == "calm"  # type: ignore[union-attr]
    with pytest.raises(
        PolicyError, match=r"broken = no_such_module:Thing: cannot be imported \(ModuleNotFound"
    ):
        resolve_policy("broken", ENVIRONMENT)
    with pytest.raises(PolicyError, match="zero, calm, broken, FILE"):
        resolve_policy("nobody", ENVIRONMENT)
    listed = CliRunner().invoke(app, ["envs"])
    assert "skipped broken = no_such_module:Thing: cannot be imported (ModuleNotFoundError" in listed.output
    assert listed.output.count("skipped") == 1
    assert evaluate(ENVIRONMENT, "zero", "original", 1, 0).episodes == 1
