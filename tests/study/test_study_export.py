"""Exports are opened by the usual tools of their formats."""

import csv
import importlib.util
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from avrgym.learning.lerobot_dataset import FeatureStatistics
from avrgym.robots.registry import find_robot
from avrgym.study.export import EXPORT_FORMATS, export_study
from avrgym.study.export.table_files import escape_formula, write_csv
from avrgym.study.storage.attempts import begin_attempt, end_incomplete_attempt
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import TASKS
from helpers.studies.small_studies import (
    OBSERVATION,
    STEPS,
    TORSO_HEIGHT_M,
    enrol_with_consent,
    record,
    run_participant,
    small_study,
)
from helpers.system.paths import ROOT

NAME = "Ada Unverwechselbar"
SCENES = ("FeedingJaco", "FeedingPR2")


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudyStore]:
    """A simulated participant with all trials and a person with some."""
    with StudyStore(small_study(tmp_path_factory.mktemp("study"))) as opened:
        run_participant(opened, enrol_with_consent(opened))
        person = enrol_with_consent(opened, simulated=False, name=NAME, contact="ada@example.org")
        run_participant(opened, person, trials=3, simulated=False)
        session = open_session(opened, person)
        trial = opened.read_remaining_trials(person)[0]
        attempt = begin_attempt(opened, session.id, trial.position)
        record(opened, attempt, trial, simulated=False)
        end_incomplete_attempt(opened, attempt.id, "stopped")
        yield opened


@pytest.fixture(scope="module")
def exports(store: StudyStore, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Exports in all formats, each in a folder."""
    folder = tmp_path_factory.mktemp("exports")
    for name in EXPORT_FORMATS:
        assert export_study(store, name, folder / name) == len(
            [p for p in (folder / name).rglob("*") if p.is_file()]
        )
    return {name: folder / name for name in EXPORT_FORMATS}


def table(path: Path) -> Any:  # a pandas data frame, whose types no checker follows
    return pd.read_csv(
        path, sep="\t" if path.suffix == ".tsv" else ",", na_values="n/a", keep_default_na=True
    )


# All formats


@pytest.mark.parametrize("name", EXPORT_FORMATS)
def test_export_is_pseudonymised(exports: dict[str, Path], name: str) -> None:
    files = [path.read_bytes() for path in exports[name].rglob("*") if path.is_file()]
    assert not any(secret in data for data in files for secret in (NAME.encode(), b"ada@example.org"))
    assert any(b"pseudonymised, not anonymous" in data for data in files)


@pytest.mark.parametrize("name", EXPORT_FORMATS)
def test_export_does_not_overwrite(
    store: StudyStore, exports: dict[str, Path], name: str, tmp_path: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in exports[name].rglob("*")}
    with pytest.raises(StudyError, match="is not empty; choose another folder"):
        export_study(store, name, exports[name])
    assert {path: path.stat().st_mtime_ns for path in exports[name].rglob("*")} == before
    export_study(store, name, tmp_path)


def test_failed_export_leaves_no_files(
    store: StudyStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(StudyStore, "read_trials", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export_study(store, "csv", tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_unknown_format_is_rejected(store: StudyStore, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="unknown format 'xlsx'; allowed: csv, bids, hdf5, lerobot, minari"):
        export_study(store, "xlsx", tmp_path / "out")


# CSV


def test_tables_have_all_rows(exports: dict[str, Path]) -> None:
    folder = exports["csv"]
    participants = table(folder / "participants.csv")
    assert participants["state"].tolist() == ["completed", "allocated"]
    trials, attempts = table(folder / "trials.csv"), table(folder / "attempts.csv")
    assert (len(trials), trials["state"].eq("completed").sum(), trials["practice"].sum()) == (10, 8, 2)
    assert (len(attempts), attempts["state"].eq("stopped").sum()) == (9, 1)
    answers = table(folder / "answers.csv")
    assert len(answers) == 4 * 4 + 2 * 4
    assert set(answers["item"]) == {"L1", "L2", "L3", "L4"}
    assert answers["value"].between(1, answers["points"]).all()
    steps = table(folder / "control_steps.csv")
    assert len(steps) == 8 * STEPS
    assert np.allclose(steps["reward"], -0.5)
    assert np.allclose(steps["term_distance_m"], 0.5)
    assert np.allclose(steps["action_7"], 0.5)


@pytest.mark.parametrize("name", ["participants", "trials", "attempts", "answers", "control_steps"])
def test_all_rows_contain_whether_simulated(exports: dict[str, Path], name: str) -> None:
    rows = table(exports["csv"] / f"{name}.csv")
    assert set(rows.loc[rows["simulated"], "participant"]) == {"sub-001"}
    assert set(rows.loc[~rows["simulated"], "participant"]) == {"sub-002"}


def test_codebook_describes_all_columns(exports: dict[str, Path]) -> None:
    codebook = table(exports["csv"] / "codebook.csv")
    explained = codebook.groupby("table", sort=False)["column"].apply(list).to_dict()
    tables = {path.stem: list(table(path).columns) for path in exports["csv"].glob("*.csv")}
    tables.pop("codebook")
    assert explained == tables
    assert codebook["meaning"].str.endswith(".").all()
    assert set(codebook["type"]) == {"text", "whole number", "number", "truth", "time"}
    united = codebook[codebook["column"].str.endswith(("_s", "_m", "_n", "_years"))]
    assert united["unit"].notna().all()
    assert codebook.loc[codebook["type"] == "number", "unit"].notna().all()


def test_table_values_match_the_codebook(exports: dict[str, Path]) -> None:
    """Tables contain only listed values, and only optional columns have empty cells."""
    codebook = table(exports["csv"] / "codebook.csv")
    for _, row in codebook.iterrows():
        held = table(exports["csv"] / f"{row['table']}.csv")[row["column"]]
        if row["type"] in ("text", "truth") and isinstance(row["allowed"], str) and "," in row["allowed"]:
            allowed = row["allowed"].lower().split(", ")
            assert set(held.dropna().astype(str).str.lower()) <= set(allowed) or "and so on" in row["allowed"]
        if not isinstance(row["empty"], str):
            assert held.notna().all(), (row["table"], row["column"])


def test_item_table_contains_texts(store: StudyStore, exports: dict[str, Path]) -> None:
    rows = table(exports["csv"] / "items.csv")
    for item, row in zip(store.design.items_by_id.values(), rows.itertuples(), strict=True):
        assert (row.item, row.text, row.points, row.low, row.high) == (
            item.id, item.text, item.points, item.low, item.high,
        )  # fmt: skip
        assert (row.questionnaire, row.when) == ("likert", "after_trial")


def test_torso_heights_match_recordings(store: StudyStore, exports: dict[str, Path]) -> None:
    attempts = table(exports["csv"] / "attempts.csv")
    completed = attempts["state"] == "completed"
    assert attempts.loc[completed, "torso_height_m"].eq(TORSO_HEIGHT_M).all()
    assert attempts.loc[~completed, "torso_height_m"].isna().all()
    assert table(exports["csv"] / "participants.csv")["torso_height_m"].eq(TORSO_HEIGHT_M).all()


@pytest.mark.parametrize("text", ["=1+1", "+A1", "-2+3", "@SUM(A1)", "\t=1", "\r=1", "\n=1"])
def test_spreadsheets_do_not_run_texts_as_formulas(tmp_path: Path, text: str) -> None:
    write_csv(tmp_path / "a.csv", [{"text": text, "number": -1.5, "truth": True, "nothing": None}])
    with open(tmp_path / "a.csv", encoding="utf-8-sig", newline="") as file:
        (_, row) = csv.reader(file)
    assert row == ["'" + text, "-1.5", "true", ""]
    assert escape_formula("plain - text") == "plain - text"


# BIDS


def test_bids_runs_have_a_column_for_each_channel(exports: dict[str, Path]) -> None:
    runs = sorted(exports["bids"].glob("sub-*/ses-*/motion/*_motion.tsv"))
    assert len(runs) == 8
    assert runs[0].name == "sub-001_ses-01_task-Feeding_tracksys-headset_run-01_motion.tsv"
    for run in runs:
        stem = str(run).removesuffix("_motion.tsv")
        channels = table(Path(f"{stem}_channels.tsv"))
        assert list(channels.columns[:5]) == ["name", "component", "type", "tracked_point", "units"]
        motion: Any = pd.read_csv(run, sep="\t", header=None, na_values="n/a")
        assert motion.shape == (STEPS, len(channels))
        assert motion[0].tolist() == pytest.approx([0.0, 0.1, 0.2])
        followed = channels["type"] == "MISC"
        assert motion[channels.index[followed]].isin([0.0, 1.0]).all(axis=None)
        left = channels.index[(channels["tracked_point"] == "left_hand") & ~followed]
        assert motion[left].isna().all(axis=1).tolist() == [False, True, False]
        sidecar = json.loads(Path(f"{stem}_motion.json").read_text())
        assert sidecar["TaskName"] == "Feeding"
        assert sidecar["SamplingFrequency"] == pytest.approx(10.0)
        kinds = channels["type"].value_counts()
        assert all(sidecar[f"{kind}ChannelCount"] == count for kind, count in kinds.items())
        assert sidecar["Simulated"] == ("sub-001" in run.name)


@pytest.mark.slow
def test_bids_validator_finds_no_error(exports: dict[str, Path]) -> None:
    validator = Path(sys.executable).with_name("bids-validator-deno")
    if not validator.exists():
        pytest.skip("the validator of BIDS is not installed (`pip install avrgym[dev]` brings it)")
    command = [validator, exports["bids"], "--format", "json"]
    result = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    issues = result["issues"]["issues"]
    assert [issue for issue in issues if issue["severity"] == "error"] == []
    assert result["summary"]["tasks"] == ["Feeding"]
    assert len(result["summary"]["subjects"]) == 2


def test_bids_contains_streams_of_other_devices(exports: dict[str, Path]) -> None:
    folder = exports["bids"] / "sub-001" / "ses-01" / "motion"
    name = "sub-001_ses-01_task-Feeding_tracksys-headset_run-01"
    heart, gaze = (
        (
            json.loads((folder / f"{name}_recording-{stream}_physio.json").read_text()),
            pd.read_csv(
                folder / f"{name}_recording-{stream}_physio.tsv.gz", sep="\t", header=None, na_values="n/a"
            ),
        )
        for stream in ("heart", "gaze")
    )
    assert (heart[0]["PhysioType"], heart[0]["SamplingFrequency"], heart[0]["Columns"]) == (
        "generic", 100.0, ["timestamp", "ecg"],
    )  # fmt: skip
    assert heart[0]["StartTime"] == pytest.approx(0.0)
    assert np.diff(heart[1][0]) == pytest.approx(0.01)
    assert heart[0]["ecg"]["Units"] == "microvolts"
    assert gaze[0]["PhysioType"] == "eyetrack"
    assert gaze[0]["Columns"] == ["timestamp", "x_coordinate", "y_coordinate", "confidence"]
    assert gaze[1].iloc[0].tolist() == pytest.approx([0.01, 0.25, 0.75, 0.5])
    assert np.isnan(gaze[1].iloc[2, 1])
    events = table(folder / f"{name}_events.tsv")
    assert events.loc[events["trial_type"] == "marks", ["onset", "detail"]].to_numpy().tolist() == [
        [0.1, "pressed"]
    ]


def test_pybids_and_mne_bids_open_an_export(exports: dict[str, Path]) -> None:
    """mne-bids reads no motion data; it expects ``tracksys`` at another place than BIDS."""
    bids = pytest.importorskip("bids", reason="`pip install pybids` brings what reads the export")
    layout = bids.BIDSLayout(exports["bids"], validate=True)
    assert (layout.get_subjects(), layout.get_tasks()) == (["001", "002"], ["Feeding"])
    assert len(layout.get(suffix="motion", extension=".tsv")) == 8
    (heart,) = layout.get(subject="001", run=1, suffix="physio", recording="heart", extension=".tsv.gz")
    assert heart.get_metadata()["SamplingFrequency"] == 100.0
    mne_bids = pytest.importorskip("mne_bids", reason="`pip install mne-bids` brings what reads the export")
    for key, values in {"subject": ["001", "002"], "session": ["01"], "task": ["Feeding"]}.items():
        assert mne_bids.get_entity_vals(exports["bids"], key) == values


def test_bids_tables_list_runs_and_conditions(exports: dict[str, Path]) -> None:
    folder = exports["bids"]
    participants = table(folder / "participants.tsv")
    assert participants["participant_id"].tolist() == ["sub-001", "sub-002"]
    assert participants["simulated"].tolist() == [True, False]
    for scans in folder.glob("sub-*/ses-*/*_scans.tsv"):
        rows = table(scans)
        assert all((scans.parent / name).is_file() for name in rows["filename"])
        assert rows["acq_time"].str.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z").all()
    assert json.loads((folder / "dataset_description.json").read_text())["BIDSVersion"] == "1.11.1"


def test_bids_answers_have_a_row_for_each_participant(exports: dict[str, Path]) -> None:
    answers = table(exports["bids"] / "phenotype" / "likert.tsv").set_index("participant_id")
    assert answers.loc["sub-001", "Feeding_PR2_original_L1"] == 3
    assert answers.loc["sub-001"].notna().sum() == 1 + 16
    assert answers.loc["sub-002"].notna().sum() == 1 + 8
    described = json.loads((exports["bids"] / "phenotype" / "likert.json").read_text())
    assert set(described) == set(answers.columns)
    levels = described["Feeding_PR2_original_L1"]["Levels"]
    assert list(levels) == [str(value) for value in range(1, 8)]
    assert (levels["1"], levels["7"]) == ("strongly disagree", "strongly agree")


# robomimic


def test_hdf5_has_the_structure_of_robomimic(exports: dict[str, Path]) -> None:
    files = sorted(exports["hdf5"].glob("*.hdf5"))
    assert {path.stem for path in files} == set(SCENES)
    for path in files:
        with h5py.File(path) as file:
            data: Any = file["data"]
            masks: Any = file["mask"]
            made_by = "old_gym"
            assert json.loads(data.attrs["env_args"])["env_name"] == f"{made_by}:avrgym/{path.stem}-v1"
            assert sorted(data) == [f"demo_{number}" for number in range(len(data))]
            for demo in data.values():
                assert demo["actions"].shape == (STEPS, 7)
                assert demo["obs/observation"][:].tolist() == [OBSERVATION] * STEPS
                assert demo["obs/flat"] == demo["obs/observation"]
                assert demo["next_obs/observation"].shape == demo["obs/observation"].shape
                assert demo["rewards"].shape == (STEPS,)
                assert demo["dones"][:].tolist() == [False] * (STEPS - 1) + [True]
                assert demo.attrs["num_samples"] == STEPS
                assert demo.attrs["simulated"] == (demo.attrs["participant"] == "sub-001")
            assert data.attrs["total"] == STEPS * len(data)
            filters = {name: {demo.decode() for demo in mask} for name, mask in masks.items()}
            for one, other in (
                ("simulated", "people"),
                ("practice", "not_practice"),
                ("policy_original", "policy_revised"),
            ):
                assert filters[one] | filters[other] == set(data)
                assert not filters[one] & filters[other]
            assert filters["practice"] == {name for name, demo in data.items() if demo.attrs["practice"]}
            assert filters["success"] == set(data)
            assert "failure" not in filters


def test_robomimic_creates_the_environment_of_an_export(exports: dict[str, Path]) -> None:
    for package in ("gym", "robomimic"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed (`pip install robomimic gym==0.26.2` brings both)")
    program = """
import json, sys
import h5py
from robomimic.utils.env_utils import create_env_from_metadata
environment = create_env_from_metadata(json.loads(h5py.File(sys.argv[1])["data"].attrs["env_args"]))
observation = environment.reset()["flat"]
after, reward, done, _ = environment.step([0.0] * environment.action_dimension)
print("SAW", observation.shape, after["flat"].shape, float(reward) < 0, done, environment.is_success())
"""
    command = [sys.executable, "-W", "ignore", "-c", program, exports["hdf5"] / "FeedingJaco.hdf5"]
    examples = {**os.environ, "PYTHONPATH": str(ROOT / "examples")}
    result = subprocess.run(command, capture_output=True, text=True, check=False, env=examples)
    assert "SAW (25,) (25,) True False {'task': False}" in result.stdout, result.stderr


# Minari


def test_minari_opens_an_export(exports: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    minari = pytest.importorskip("minari", reason="`pip install minari` brings what reads the export")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(exports["minari"]))
    for scene in SCENES:
        dataset = minari.load_dataset(f"avrgym/{scene}/study-v0")
        assert dataset.env_spec.id == f"avrgym/{scene}-v1"
        assert dataset.total_steps == STEPS * dataset.total_episodes
        for episode in dataset.iterate_episodes():
            assert episode.observations.tolist() == [OBSERVATION] * (STEPS + 1)
            assert episode.actions.shape == (STEPS, 7)
            assert episode.truncations.tolist() == [False] * (STEPS - 1) + [True]
            assert not episode.terminations.any()
            assert episode.infos["success"].tolist()[-1]


# LeRobot


@pytest.mark.parametrize("scene", SCENES)
def test_lerobot_metadata_describes_the_dataset(exports: dict[str, Path], scene: str) -> None:
    folder = exports["lerobot"] / scene
    info = json.loads((folder / "meta" / "info.json").read_text())
    frames: Any = pd.read_parquet(folder / info["data_path"].format(chunk_index=0, file_index=0))
    assert info["codebase_version"] == "v3.0"
    assert set(frames.columns) == set(info["features"])
    assert len(frames) == info["total_frames"] == STEPS * info["total_episodes"]
    for name, feature in info["features"].items():
        assert np.atleast_1d(frames[name].iloc[0]).shape == tuple(feature["shape"])
    assert info["features"]["action"]["names"] == list(
        TASKS["Feeding"].make_scene(find_robot(scene[7:])).arm.joints
    )
    schema = pq.read_schema(folder / "data" / "chunk-000" / "file-000.parquet")
    assert str(schema.field("action").type) == "fixed_size_list<element: float>[7]"
    episodes: Any = pd.read_parquet(folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    for _, episode in episodes.iterrows():
        own = frames.iloc[episode["dataset_from_index"] : episode["dataset_to_index"]]
        assert set(own["episode_index"]) == {episode["episode_index"]}
        assert own["frame_index"].tolist() == list(range(episode["length"]))
        assert own["simulated"].eq(episode["study/participant"] == "sub-001").all()
    tasks: Any = pd.read_parquet(folder / "meta" / "tasks.parquet")
    assert tasks.index.name == "task"
    assert tasks.loc[episodes["tasks"].iloc[0][0], "task_index"] == 0
    stats = json.loads((folder / "meta" / "stats.json").read_text())
    assert set(stats) == set(info["features"])
    assert stats["action"]["mean"] == pytest.approx([0.5] * 7)


STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
"""Those of LeRobot's format v3.0."""


@pytest.mark.parametrize("scene", SCENES)
def test_lerobot_statistics_contain_quantiles_of_all_features(exports: dict[str, Path], scene: str) -> None:
    """Quantiles of all frames in stats.json, and of each episode in its own file."""
    folder = exports["lerobot"] / scene
    frames: Any = pd.read_parquet(folder / "data" / "chunk-000" / "file-000.parquet")
    episodes: Any = pd.read_parquet(folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    whole = json.loads((folder / "meta" / "stats.json").read_text())
    assert set(whole) == set(frames.columns)
    for feature, found in whole.items():
        assert set(found) == STATISTICS
        check_quantiles(frames[feature], found)
        for _, episode in episodes.iterrows():
            own = frames.iloc[episode["dataset_from_index"] : episode["dataset_to_index"]]
            check_quantiles(own[feature], {name: episode[f"stats/{feature}/{name}"] for name in STATISTICS})


def check_quantiles(column: Any, found: dict[str, Any]) -> None:
    values = np.array([np.atleast_1d(value) for value in column], np.float64)
    for name in sorted(STATISTICS):
        if name.startswith("q"):
            expected = np.quantile(values, int(name[1:]) / 100.0, axis=0)
            np.testing.assert_allclose(found[name], expected, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("shape", [(1,), (7,), (200,), (1, 3), (200, 7)])
def test_lerobot_quantiles_match_numpy(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(5).normal(size=shape).astype(np.float32)
    found = FeatureStatistics(values).to_dict()
    check_quantiles(values, found)
    ordered = [found[name] for name in ("min", "q01", "q10", "q50", "q90", "q99", "max")]
    assert (np.diff(ordered, axis=0) >= 0.0).all()
    assert found["count"] == [len(values)]
