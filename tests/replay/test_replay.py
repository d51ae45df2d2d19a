"""Replay: initial state, commands and the participant's motion determine every recorded trial."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.recording import writer as writing
from avrgym.recording.configuration import Versions
from avrgym.recording.reader import Recording, read_recording
from avrgym.recording.writer import RecordingWriter
from avrgym.replay.playback import ComparedState, Playback, ReplayError
from avrgym.replay.verification import STATE_QUANTITIES, verify_recording
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.protocol.messages import ParticipantDisconnected, ParticipantReady, Stop
from helpers.studies.configurations import with_configuration
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant
from helpers.vr.visit import ENVIRONMENT, Visit, plan

STEPS = 4
TICKS_INTO_STEP = 23
"""Two whole control steps, and a part of the third."""

HELD_ONCE = 2
"""Commands within a control step: one holds the robot while tracking is lost, one lets it go on."""


def visited(folder: Path, environment: str) -> list[Path]:
    """The recordings of three attempts at a trial: stopped in the middle of a control step, left behind by a
    connection that was lost, completed. Tracking is lost for a while in the last."""
    visit = Visit(folder, plan(environments=[environment], trial_steps=STEPS))
    visit.calibrate()
    visit.run_until("trial")
    visit.tick(TICKS_INTO_STEP)
    visit.send(Stop(), ParticipantReady())
    visit.run_until("trial")
    visit.tick(5)
    visit.send(ParticipantDisconnected())
    visit.calibrate()
    visit.run_until("trial")
    visit.tracking = False
    visit.tick(25)
    visit.tracking = True
    visit.run_until("questionnaire")
    visit.tick(20)
    visit.answer(1, 2, 3, 4)
    visit.leave()
    return visit.session.recordings


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """In many small chunks, as a trial in real time has them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(writing, "FLUSH_INTERVAL_S", 0.001)
        return visited(tmp_path_factory.mktemp("feeding"), ENVIRONMENT)


@pytest.fixture(scope="module")
def whole(paths: list[Path]) -> Recording:
    return read_recording(paths[-1])


def avrgym(*arguments: str | Path | int) -> Result:
    return CliRunner().invoke(app, ["replay", *(str(argument) for argument in arguments)])


# Laws --------------------------------------------------------------------------------------------------------


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_every_attempt_steps_again_to_the_same_bits(tmp_path: Path, environment: str) -> None:
    results = []
    for path in visited(tmp_path, environment):
        recording = read_recording(path)
        found = verify_recording(recording)
        assert found.differences == []
        assert found.num_states == found.num_identical_states == len(recording.messages_by_topic["/physics"])
        assert found.num_steps == found.num_identical_steps == len(recording.messages_by_topic["/control"])
        assert (found.is_complete, found.has_same_versions) == (True, True)
        results.append(recording.result)
        steps = len(recording.messages_by_topic["/commands"])
        assert steps == {"stopped": 3, "interrupted": 1, "completed": STEPS + HELD_ONCE}[results[-1]]
    assert results == ["stopped", "interrupted", "completed"]


Change = Callable[[Any], Any]


def changed(recording: Recording, topic: str, number: int, change: Change) -> Recording:
    """A recording with one of a topic's records changed."""
    places = [place for place, (name, _, _) in enumerate(recording.messages) if name == topic]
    messages = list(recording.messages)
    name, time_ns, record = messages[places[number]]
    messages[places[number]] = (name, time_ns, change(record))
    return replace(recording, messages=messages)


def with_number(field: str, place: int, by: float = 0.0) -> Change:
    """Adds to a number of a record's list, at least as much as the next larger double is away."""

    def change(record: Any) -> Any:
        numbers = list(getattr(record, field))
        numbers[place] = float(np.nextafter(numbers[place] + by, np.inf))
        return msgspec.structs.replace(record, **{field: numbers})

    return change


@pytest.mark.parametrize("number", [1, 30, -1])
def test_the_last_bit_of_a_state_is_found(whole: Recording, number: int) -> None:
    time_ns, physics = whole.messages_by_topic["/physics"][number]
    found = verify_recording(changed(whole, "/physics", number, with_number("state", 3)))
    assert found.num_identical_states == found.num_states - 1
    (difference,) = found.differences
    assert (difference.quantity, difference.times) == ("qpos", 1)
    assert difference.first_time_s == time_ns / 1e9
    assert difference.largest == np.spacing(abs(physics.state[3]))
    assert found.agrees_within_rounding


@pytest.mark.parametrize("by", [1e-8, -1e-6, 0.01])
def test_more_than_rounding_is_no_agreement(whole: Recording, by: float) -> None:
    """In a state or in the result of a control step."""
    bent = changed(whole, "/physics", 30, with_number("state", 3, by))
    told = changed(whole, "/control", 2, with_number("observation", 2, by))
    for found in (verify_recording(bent), verify_recording(told)):
        assert not found.is_identical
        assert not found.agrees_within_rounding


@pytest.mark.parametrize(
    ("quantity", "change"),
    [
        ("observation", with_number("observation", 2)),
        ("action", with_number("action", 2)),
        ("reward", lambda record: msgspec.structs.replace(record, reward=record.reward + 1.0)),
        ("success", lambda record: msgspec.structs.replace(record, success=not record.success)),
        ("distance_m", lambda record: msgspec.structs.replace(record, distance_m=0.0)),
        ("force_on_person_n", lambda record: msgspec.structs.replace(record, force_on_person_n=9.0)),
        (
            "term action_squared",
            lambda record: msgspec.structs.replace(
                record, reward_terms=record.reward_terms | {"action_squared": 7.0}
            ),
        ),
        (
            "term unheard_of",
            lambda record: msgspec.structs.replace(
                record, reward_terms=record.reward_terms | {"unheard_of": 7.0}
            ),
        ),
    ],
)
def test_whatever_a_control_step_holds_is_compared(whole: Recording, quantity: str, change: Change) -> None:
    found = verify_recording(changed(whole, "/control", 1, change))
    assert [difference.quantity for difference in found.differences] == [quantity]
    assert found.agrees_within_rounding == (quantity in ("observation", "action"))  # by one bit
    assert (found.num_identical_steps, found.num_identical_states) == (STEPS - 1, found.num_states)


@pytest.mark.parametrize(
    ("topic", "change"),
    [
        ("/commands", with_number("action", 0, by=-0.1)),
        ("/body_targets", with_number("joint_targets", 0, by=0.1)),
    ],
)
def test_other_commands_and_other_movements_lead_elsewhere(
    whole: Recording, topic: str, change: Change
) -> None:
    found = verify_recording(changed(whole, topic, 1, change))
    assert found.num_identical_states < found.num_states
    assert not found.agrees_within_rounding
    assert {difference.quantity for difference in found.differences} >= {"ctrl", "qpos", "qvel"}


def test_every_part_of_a_state_has_a_name(whole: Recording) -> None:
    """The parts add up to the state, so that no difference goes without one."""
    model = Playback(whole).episodes.simulation.model
    named = sum(mujoco.mj_stateSize(model, part) for part in STATE_QUANTITIES.values())
    assert named == mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)


def test_who_follows_goes_on_from_the_recorded_states(whole: Recording) -> None:
    """A changed state is shown as recorded; the one after it differs, because it came from another."""
    bent = changed(whole, "/physics", 10, with_number("state", 3))
    states = [again for again in Playback(bent).recompute(follow=True) if isinstance(again, ComparedState)]
    assert [number for number, again in enumerate(states) if not again.is_identical] == [10, 11]


# What cannot be compared, and says so ------------------------------------------------------------------------


def test_a_recording_that_breaks_off_is_verified_up_to_its_end(tmp_path: Path, paths: list[Path]) -> None:
    content = paths[-1].read_bytes()
    lengths = set()
    for share in (0.5, 0.7, 0.9):
        cut = tmp_path / f"cut-{share}.mcap"
        cut.write_bytes(content[: int(share * len(content))])
        shown = avrgym(cut, "--verify")
        assert shown.exit_code == 0, shown.output
        found = verify_recording(read_recording(cut))
        assert "not complete" in shown.stdout
        assert f"{found.end_time_s:.2f} s" in shown.stdout
        assert (
            f"{found.num_states} states bit-identical, {found.num_steps} control steps identical"
            in shown.stdout
        )
        lengths.add(found.num_states)
    assert len(lengths) > 1


def written(recording: Recording, path: Path, **changes: Any) -> Path:
    """A recording as a file, with some changed fields of its configuration."""
    writer = RecordingWriter(path, msgspec.structs.replace(recording.configuration, **changes))
    for topic, time_ns, record in recording.messages:
        writer.write(topic, time_ns, record)
    writer.close(recording.outcome)
    return path


def test_the_command_tells_what_agreed_or_differs(
    tmp_path: Path, paths: list[Path], whole: Recording
) -> None:
    figures = tmp_path / "figures.json"
    good = avrgym(paths[-1], "--verify", "--json", figures)
    assert good.exit_code == 0
    assert (
        f"{len(whole.messages_by_topic['/physics'])} states bit-identical, {STEPS} control steps identical"
        in good.stdout
    )
    assert "simulated participant" in good.stdout
    assert json.loads(figures.read_text())["num_identical_steps"] == STEPS

    bent = changed(whole, "/physics", 10, with_number("state", 3))
    bad = avrgym(written(bent, tmp_path / "bent.mcap"), "--verify")
    assert bad.exit_code == 1
    assert "1 of" in bad.stdout
    assert "qpos" in bad.stdout
    assert "although both have" in bad.stderr

    other = Versions("0.1.0", "3.3.7")
    older = avrgym(written(bent, tmp_path / "older.mcap", versions=other), "--verify")
    assert older.exit_code == 0
    assert "recorded with AVR Gym 0.1.0, MuJoCo 3.3.7" in older.stdout


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda r: with_configuration(r, body_names=("a",)), "bodies of the recorded scene have changed"),
        (
            lambda r: with_configuration(
                r, episode_start=msgspec.structs.replace(r.configuration.episode_start, memory={})
            ),
            "lacks",
        ),
        (lambda r: with_configuration(r, environment="avrgym/Dance-v1"), "Dance"),
        (
            lambda r: changed(r, "/physics", 0, lambda p: msgspec.structs.replace(p, state=[1.0])),
            "1 values, but a state of this simulator has .* recorded with AVR Gym",
        ),
        (lambda r: replace(r, messages=[m for m in r.messages if m[0] != "/commands"]), "no commands"),
        (
            lambda r: replace(r, messages=[m for m in r.messages if m[0] != "/events"]),
            "does not end at a tick",
        ),
        (lambda r: replace(r, messages=[]), "before its first state"),
    ],
)
def test_what_cannot_be_stepped_again_says_why(
    whole: Recording, change: Callable[[Recording], Recording], words: str
) -> None:
    with pytest.raises(ReplayError, match=words):
        verify_recording(change(whole))


def test_a_recording_tells_its_whole_start_so_that_nothing_is_drawn(whole: Recording) -> None:
    assert verify_recording(with_configuration(whole, seed=12345)).is_identical


def test_the_command_answers_mistakes_in_one_line(tmp_path: Path, paths: list[Path]) -> None:
    (tmp_path / "text.mcap").write_text("not a recording")
    with StudyStore(make_study(tmp_path / "study", tasks='["Feeding"]')) as store:
        run_participant(store, enrol_with_consent(store), trials=1)
    (incomplete,) = (tmp_path / "study").rglob("*.mcap")
    old = tmp_path / "old.png"
    old.write_text("mine")
    for arguments, words in (
        ((tmp_path / "none.mcap", "--verify"), "none.mcap"),
        ((tmp_path / "text.mcap", "--verify"), "not a recording"),
        ((tmp_path / "text.mcap",), "give one of the .mcap files that `avrgym serve` writes"),
        ((tmp_path / "study",), "study is a folder; give one of the .mcap files"),
        ((incomplete, "--verify"), f"{incomplete}: the recording is truncated before its first state"),
        ((paths[-1], "--first-person"), "needs --video, --gif or --frames"),
        ((paths[-1], "--frames", 4), "must be given together"),
        ((paths[-1], "--json", tmp_path / "x.json"), "--verify"),
        ((paths[-1], "--video", tmp_path / "video.avi"), ".mp4"),
        ((paths[-1], "--frames", 4, "--out", tmp_path / "strip.gif"), ".png or .jpg"),
        ((paths[-1], "--frames", 4, "--out", old), "already exists"),
    ):
        shown = avrgym(*arguments)
        assert shown.exit_code == 1, arguments
        assert words in shown.stderr
        assert len(shown.stderr.splitlines()) == 1
    assert old.read_text() == "mine"


def test_a_recording_made_where_rounding_is_another_agrees_within_it(
    tmp_path: Path, whole: Recording
) -> None:
    """A bit is an error where nothing may differ, and none where another C library made the recording."""
    bent = changed(whole, "/physics", 10, with_number("state", 3))
    elsewhere = with_configuration(bent, c_library="elsewhere")
    good = avrgym(written(elsewhere, tmp_path / "elsewhere.mcap"), "--verify")
    assert good.exit_code == 0, good.output
    assert "The replay agrees" in good.stdout
    far = changed(elsewhere, "/physics", 20, with_number("state", 3, 1e-6))
    assert avrgym(written(far, tmp_path / "far.mcap"), "--verify").exit_code == 1
