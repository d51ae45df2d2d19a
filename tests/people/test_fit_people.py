"""Populations fitted to a study, and their use in training, evaluation and Gymnasium's environments."""

import re
from collections.abc import Mapping
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from msgspec.structs import asdict
from typer.testing import CliRunner, Result

from avrgym.analysis.fit_people import (
    FITTED_JOINT_NAMES,
    compute_covering_range,
    fit_people,
    write_people_file,
)
from avrgym.cli.main import app
from avrgym.learning.evaluation import evaluate
from avrgym.models.human import JOINT_INDEX, JOINTS, SEATED_POSTURE, SEXES, Sex
from avrgym.people import distributions
from avrgym.people.people_file import PeopleFileError, parse_people, read_people
from avrgym.recording.configuration import BodyModel
from avrgym.recording.schema import Answer, BodyTargets, Control, Event, Outcome, TrackingFrame
from avrgym.recording.writer import RecordingWriter
from avrgym.study.people.participants import enrol_participant, record_consent, record_inclusion_answers
from avrgym.study.storage.answers import record_trial_answer
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import TASKS
from helpers.studies.configurations import configuration
from helpers.studies.small_studies import METRICS, eligible_answers, make_study
from helpers.system.paths import ROOT

TASK = "Feeding"
REST_DEG = np.degrees(TASKS[TASK].pose_distribution.rest_angles_rad)
ENDS_S = 3.0
"""The robot drives from 1 s until then."""
HEIGHTS_M: Mapping[Sex, list[float]] = {"man": [0.55, 0.58], "woman": [0.51, 0.54, 0.52]}
LEANS_DEG = [1.0, 4.0, -2.0, 0.0, 3.0]
"""How far each participant leans, in the order in which they come."""


def angles_deg(**added: float) -> np.ndarray:
    """The task's pose with some joints turned farther."""
    angles = REST_DEG.copy()
    for joint, degrees in added.items():
        angles[JOINT_INDEX[joint]] += degrees
    return angles


def record(
    path: Path, sex: Sex, torso_height_m: float, lean_deg: float, largest_motion_deg: float, held: bool
) -> None:
    """A trial in which somebody leans, and for its last second turns the head too; ``held``: they were not tracked."""
    recorded = configuration(
        environment=f"avrgym/{TASK}Jaco-v1",
        person=BodyModel(sex, torso_height_m, "fair"),
        joint_names=tuple(JOINTS),
    )
    writer = RecordingWriter(path, recorded)
    leaning, turned = angles_deg(waist_x=lean_deg), angles_deg(waist_x=lean_deg, head_z=largest_motion_deg)
    for time_s, pose in ((0.0, angles_deg(waist_x=40.0)), (0.9, leaning), (ENDS_S - 1.0, turned)):
        writer.write("/body_targets", round(1e9 * time_s), BodyTargets(np.radians(pose).tolist()))
        if time_s == 0.9:
            writer.write("/events", 10**9, Event("phase", "trial"))
    for frame in range(round(10 * ENDS_S)):
        time_s = 0.1 * frame
        tracking = TrackingFrame(frame, 1e3 * time_s, time_s, moved_person=not held, rejected=held)
        writer.write("/tracking", round(1e9 * time_s), tracking)
    control = Control(1, [0.0], [0.0] * 7, -1.0, {"distance_m": 1.0}, False, 1.0, 0.0)
    writer.write("/control", round(1e9 * ENDS_S), control)
    writer.write(
        "/body_targets", round(1e9 * ENDS_S) + 1, BodyTargets(np.radians(angles_deg(waist_x=70)).tolist())
    )
    for item in ("L1", "L2", "L3", "L4"):
        writer.write("/answers", round(1e9 * ENDS_S) + 2, Answer(item, 4, 1.0))
    writer.close(Outcome(result="completed", **asdict(METRICS)))


def take_part(
    store: StudyStore,
    sex: Sex,
    torso_height_m: float,
    lean_deg: float,
    largest_motion_deg: float,
    simulated: bool,
    *,
    held: bool = False,
) -> None:
    """Somebody completes their trials."""
    pseudonym = enrol_participant(store, sex, age_years=22, simulated=simulated)
    record_consent(store, pseudonym)
    assert record_inclusion_answers(store, pseudonym, eligible_answers(store))
    session = open_session(store, pseudonym)
    for trial in store.read_remaining_trials(pseudonym):
        attempt = begin_attempt(store, session.id, trial.position)
        record(store.resolve_path(attempt.recording), sex, torso_height_m, lean_deg, largest_motion_deg, held)
        for item in store.design.list_items_at_moment("after_trial"):
            record_trial_answer(store, attempt.id, Answer(item.id, 4, 1.0))
        complete_attempt(store, attempt.id, METRICS)
    close_session(store, session.id)


def study(folder: Path, *, largest_motion_deg: float = 1.0, simulated: bool = True, count: int = 5) -> Path:
    """A study with one task and robot, two trials each, of so many participants."""
    make_study(folder, tasks=f'["{TASK}"]', robots='["Jaco"]', practice_policy='""')
    bodies: list[tuple[Sex, float]] = [(sex, height_m) for sex in SEXES for height_m in HEIGHTS_M[sex]]
    with StudyStore(folder) as store:
        for (sex, height_m), lean_deg in list(zip(bodies, LEANS_DEG, strict=True))[:count]:
            take_part(store, sex, height_m, lean_deg, largest_motion_deg, simulated)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return study(tmp_path_factory.mktemp("still"))


@pytest.fixture(scope="module")
def fitted(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("people") / "people.toml"
    write_people_file(fit_people(folder), out)
    return out


def avrgym(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


# The rule ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [2, 5, 20])
def test_fitted_ranges_cover_all_participants(rng: np.random.Generator, count: int) -> None:
    drawn = rng.uniform(-1.0, 3.0, (4000, count))
    ranges = np.array([compute_covering_range(values, (-np.inf, np.inf)) for values in drawn])
    assert (ranges[:, 0] <= drawn.min(axis=1)).all()
    assert (ranges[:, 1] >= drawn.max(axis=1)).all()
    error = ranges.std(axis=0) / np.sqrt(len(ranges))
    assert (np.abs(ranges.mean(axis=0) - [-1.0, 3.0]) < 4.0 * error).all()


def test_ranges_stay_within_what_the_model_allows() -> None:
    assert compute_covering_range([0.1, 0.9], (0.0, 1.0)) == (0.0, 1.0)


# From a study ------------------------------------------------------------------------------------------------


def test_still_participants_are_fitted_at_their_pose(fitted: Path) -> None:
    """The head was turned for the last of two seconds: half of it counts. What lies around the trial does not."""
    found = read_people(fitted, TASKS)
    assert not found.cooperating
    pose = found.poses[TASK]
    assert tuple(pose) == FITTED_JOINT_NAMES
    assert pose["waist_x"] == pytest.approx((-2.0 - 6.0 / 4, 4.0 + 6.0 / 4))
    assert pose["head_z"] == pytest.approx((0.5, 0.5))
    assert pose["right_elbow_x"] == pytest.approx((-90.0, -90.0))
    assert found.torso_height_m.man == pytest.approx((0.52, 0.61))
    assert found.torso_height_m.woman == pytest.approx((0.51 - 0.015, 0.54 + 0.015))


def test_moving_participants_are_fitted_at_their_initial_pose(tmp_path: Path) -> None:
    found = fit_people(study(tmp_path / "moving", largest_motion_deg=20.0)).people_file
    assert found.cooperating
    assert found.poses[TASK]["head_z"] == (0.0, 0.0)


def test_the_file_contains_its_source_and_is_reproducible(folder: Path, fitted: Path, tmp_path: Path) -> None:
    source = read_people(fitted, TASKS).source
    assert source is not None
    assert (source.men, source.women, source.trials, source.simulated) == (2, 3, 10, True)
    text = fitted.read_text()
    assert "# People fitted by `avrgym fit-people` to 5 simulated participants" in text
    assert "# Only 5 participants: on average, 67% of other people" in text
    again = tmp_path / "again.toml"
    result = avrgym("fit-people", folder, "--out", again)
    assert result.exit_code == 0
    assert "67% of other people" in result.stdout
    assert again.read_bytes() == fitted.read_bytes()
    assert avrgym("fit-people", folder, "--out", again).exit_code == 1


def test_simulated_participants_are_ignored_among_real_ones(tmp_path: Path) -> None:
    folder = study(tmp_path / "mixed", simulated=False, count=3)
    with StudyStore(folder) as store:
        take_part(store, "man", 0.70, 70.0, 1.0, simulated=True)
    fit = fit_people(folder)
    assert fit.people_file.source is not None
    assert (fit.people_file.source.participants, fit.people_file.source.simulated) == (3, False)
    assert fit.people_file.poses[TASK]["waist_x"][1] < 10.0
    assert "Fewer than two participants have sex 'woman'" in fit.remarks


def test_trials_with_stale_tracking_are_skipped_and_listed(tmp_path: Path) -> None:
    folder = study(tmp_path / "held", count=3)
    with StudyStore(folder) as store:
        take_part(store, "woman", 0.60, 50.0, 1.0, True, held=True)
    fit = fit_people(folder)
    assert fit.people_file.source is not None
    assert fit.people_file.source.participants == 3
    assert fit.people_file.poses[TASK]["waist_x"][1] < 10.0
    assert [words.partition(": ")[0] for words in fit.omitted_recordings] == _recordings("sub-004")
    assert all(
        "tracking was lost for 100.0 % of the robot's assistance time" in words
        for words in fit.omitted_recordings
    )


def _recordings(pseudonym: str) -> list[str]:
    return [f"recordings/{pseudonym}/ses-01/trial-0{number}_attempt-1.mcap" for number in (1, 2)]


def test_changed_or_truncated_recordings_are_skipped_and_listed(tmp_path: Path) -> None:
    folder = study(tmp_path / "broken", count=3)
    for path in (folder / "recordings" / "sub-002").rglob("*.mcap"):
        path.write_bytes(path.read_bytes()[:-400])
    fit = fit_people(folder)
    assert fit.people_file.source is not None
    assert fit.people_file.source.participants == 2
    assert [words.partition(" ")[0] for words in fit.omitted_recordings] == _recordings("sub-002")
    assert all(words.endswith("was changed: its checksum differs") for words in fit.omitted_recordings)
    assert "left out  recordings/sub-002" in avrgym("fit-people", folder, "--out", tmp_path / "p.toml").stdout


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_participants_are_refused(tmp_path: Path, count: int) -> None:
    folder = study(tmp_path / "few", count=count)
    with pytest.raises(StudyError, match=f"2 participants with completed trials, found {count}"):
        fit_people(folder)
    result = avrgym("fit-people", folder, "--out", tmp_path / "p.toml")
    assert (result.exit_code, len(result.stderr.splitlines())) == (1, 1)
    assert not (tmp_path / "p.toml").exists()


# The people of a file ----------------------------------------------------------------------------------------


def test_sampled_people_fill_the_ranges_of_the_file(fitted: Path, rng: np.random.Generator) -> None:
    file, distribution = read_people(fitted, TASKS), distributions.find_distribution(str(fitted), TASKS)
    pose = distribution.get_pose_distribution(TASK, TASKS[TASK].pose_distribution)
    group = distributions.sample_people(
        distribution, pose, SEATED_POSTURE, None, rng.random((4000, distributions.NUM_RANDOM_NUMBERS))
    )
    for sex, limits in (("man", file.torso_height_m.man), ("woman", file.torso_height_m.woman)):
        heights_m = group.torso_height_m[group.is_woman == (sex == "woman")]
        assert (heights_m.min(), heights_m.max()) == pytest.approx(limits, abs=1e-3)
    drawn_deg = np.degrees(group.joint_angles_rad)
    for joint in ("waist_x", "head_z", "left_elbow_x"):
        low, high = file.poses[TASK].get(joint, (-90.0, -90.0))
        column = drawn_deg[:, JOINT_INDEX[joint]]
        assert (column.min(), column.max()) == pytest.approx((low, high), abs=0.01 * (high - low) + 1e-9)


def test_tasks_without_ranges_keep_their_pose(fitted: Path) -> None:
    distribution, usual = (
        distributions.find_distribution(str(fitted), TASKS),
        TASKS["ScratchItch"].pose_distribution,
    )
    pose = distribution.get_pose_distribution("ScratchItch", usual)
    np.testing.assert_array_equal(pose.rest_angles_rad, usual.rest_angles_rad)
    np.testing.assert_array_equal(pose.max_offset_rad, usual.max_offset_rad)


def test_environments_and_evaluation_use_a_people_file(fitted: Path) -> None:
    env = gym.make(f"avrgym/{TASK}Jaco-v1", people=str(fitted))
    lows, highs = zip(
        *(read_people(fitted, TASKS).poses[TASK][joint] for joint in FITTED_JOINT_NAMES), strict=True
    )
    for seed in range(3):
        env.reset(seed=seed)
        person = env.unwrapped.episodes.get_person(0)  # pyright: ignore[reportAttributeAccessIssue]
        drawn = np.degrees([person.joint_angles_rad[JOINT_INDEX[joint]] for joint in FITTED_JOINT_NAMES])
        assert (drawn >= np.array(lows) - 1e-6).all()
        assert (drawn <= np.array(highs) + 1e-6).all()
    assert evaluate(f"avrgym/{TASK}Jaco-v1", "zero", str(fitted), 1, 0).people == str(fitted)


@pytest.mark.slow
def test_a_training_stores_its_people(fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when their file has gone, and the policy says that they were fitted."""
    training = pytest.importorskip("avrgym.learning.training", reason="training is an extra")
    from avrgym.learning.configuration import FeedforwardConfiguration

    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)
    own, out = tmp_path / "mine.toml", tmp_path / "run"
    own.write_bytes(fitted.read_bytes())
    tiny = FeedforwardConfiguration(
        environment=f"avrgym/{TASK}Jaco-v1",
        people=str(own),
        steps=400,
        num_envs=2,
        batch_size=400,
        n_epochs=1,
        threads=1,
        imitation_rounds=0,
    )
    policy = training.train(tiny, out)
    assert policy.metadata.people == "fitted: mine.toml"
    assert (out / "people.toml").read_bytes() == fitted.read_bytes()
    own.unlink()
    (out / training.CHECKPOINT_FILE).unlink()
    assert training.resume(out).metadata.people == "fitted: mine.toml"


GOOD = """cooperating = false

[torso_height_m]
man = [0.50, 0.60]
woman = [0.50, 0.60]

[poses.Feeding]
waist_x = [-5.0, 5]
"""


def test_the_page_s_example_is_a_population_file() -> None:
    text = (ROOT / "docs" / "how_to" / "fit_people.md").read_text()
    (example,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    found = parse_people(example, "example", TASKS)
    assert tuple(found.poses["Feeding"]) == ("waist_x", "head_z")
    assert found.source is not None


def test_a_handwritten_file_needs_no_source() -> None:
    assert parse_people(GOOD, "p.toml", TASKS).poses == {"Feeding": {"waist_x": (-5.0, 5.0)}}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0.50, 0.60]\n\n", "[0.60, 0.50]\n\n", "p.toml: torso_height_m.woman is .* from 0.4 to 0.75 m"),
        ("man = [0.50", "man = [0.20", "p.toml: torso_height_m.man is .* from 0.4 to 0.75 m"),
        (
            "[poses.Feeding]",
            "[poses.Feding]",
            "p.toml: poses: unknown task 'Feding'; allowed: Feeding, Drinking",
        ),
        ("waist_x", "hip_x", "p.toml: poses.Feeding: unknown joint 'hip_x'; allowed: waist_x"),
        ("[-5.0, 5]", "[-5.0, 500]", "p.toml: poses.Feeding.waist_x is .* from -30 to 75 degrees"),
        ("[-5.0, 5]", '"wide"', "p.toml: poses.Feeding.waist_x is wide"),
        ("cooperating = false", "cooperating = 3", "p.toml: cooperating: Expected `?bool"),
        ("cooperating = false", "", "p.toml: .*missing required field cooperating"),
        ("cooperating = false", "cooperating = false\ntall = 1", "unknown field tall"),
        ("cooperating = false", "cooperating = ", "p.toml: invalid TOML"),
    ],
)
def test_invalid_values_are_reported_with_their_key(old: str, new: str, words: str) -> None:
    with pytest.raises(PeopleFileError, match=words):
        parse_people(GOOD.replace(old, new), "p.toml", TASKS)


BEHAVIOUR = """
[[behaviour]]
reaction_s = [0.3, 0.02]
tremor_hz = [6, 0.0]

[[behaviour]]
reaction_s = [0.7, 0.0]
facing_share = [0.5, 0.1]
"""


def test_people_behave_like_the_participants_of_a_file(tmp_path: Path, rng: np.random.Generator) -> None:
    own = tmp_path / "people.toml"
    own.write_text(GOOD + BEHAVIOUR)
    partners = distributions.find_distribution(str(own), TASKS).partners
    assert partners is not None
    drawn = partners.sample(rng.random((4000, 2)))
    like_second = drawn.reaction_s == 0.7
    assert like_second.mean() == pytest.approx(0.5, abs=0.05)
    assert drawn.reaction_s[~like_second].mean() == pytest.approx(0.3, abs=0.005)
    assert drawn.reaction_s[~like_second].std() == pytest.approx(0.02, abs=0.005)
    assert (drawn.facing_share[like_second].std(), drawn.facing_share[~like_second].max()) == pytest.approx(
        (0.1, 0.0), abs=0.02
    )
    assert set(drawn.tremor_hz) == {5.0, 6.0}
    assert evaluate(f"avrgym/{TASK}Jaco-v1", "zero", str(own), 1, 0).people == str(own)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[0.3, 0.02]", "[0.01, 0.02]", "p.toml: behaviour 1: reaction_s is .* from 0.1 to 0.95, standard"),
        (
            "[0.5, 0.1]",
            "[0.5, -0.1]",
            "p.toml: behaviour 2: facing_share is .* standard deviation of 0 or more",
        ),
        ("facing_share", "charm", "p.toml: behaviour 2: charm: unknown parameter; allowed: reaction_s, "),
        ("[6, 0.0]", "6", "p.toml: behaviour 1: tremor_hz is 6"),
    ],
)
def test_invalid_behaviour_is_reported_with_its_key(old: str, new: str, words: str) -> None:
    with pytest.raises(PeopleFileError, match=words):
        parse_people(GOOD + BEHAVIOUR.replace(old, new), "p.toml", TASKS)


def test_commands_list_the_populations(tmp_path: Path) -> None:
    for command in ("evaluate", "train"):
        result = avrgym(command, f"avrgym/{TASK}Jaco-v1", "--people", "nobody.toml")
        assert result.exit_code == 1
        assert "unknown population 'nobody.toml'; allowed: original, revised" in result.stderr
