"""Exports contain images that are rendered from recorded states."""

import io
import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_array_equal
from PIL import Image

from avrgym.models.cameras import MAX_IMAGE_DEPTH_M, CameraSpec
from avrgym.recording.reader import Recording, read_recording
from avrgym.recording.recorded_world import rebuild_world, render_recorded_images
from avrgym.study.export import export_study
from avrgym.study.storage.attempts import begin_attempt, complete_attempt
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.camera_images import find_rendering_error
from avrgym.tasks.registry import find_task_and_scene
from helpers.studies.small_studies import METRICS, enrol_with_consent, small_study
from helpers.vr.visit import Visit, plan

FEEDING, STEPS = "avrgym/FeedingJaco-v1", 3
CAMERA = "wrist:80x64:rgb+depth+segmentation"
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_rendering_error() is not None, reason="no graphics library renders here"),
]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a trial of three control steps."""
    visit = Visit(tmp_path_factory.mktemp("visit"), plan(environments=[FEEDING], trial_steps=STEPS))
    visit.calibrate()
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    (recorded,) = visit.session.recordings
    return recorded


@pytest.fixture(scope="module")
def recording(path: Path) -> Recording:
    return read_recording(path)


@pytest.fixture(scope="module")
def store(path: Path, tmp_path_factory: pytest.TempPathFactory) -> StudyStore:
    """A study with this recording as its first trial."""
    opened = StudyStore(small_study(tmp_path_factory.mktemp("study")))
    session = open_session(opened, enrol_with_consent(opened))
    (trial, *_) = [each for each in opened.read_trials("sub-001") if each.environment == FEEDING]
    attempt = begin_attempt(opened, session.id, trial.position)
    opened.resolve_path(attempt.recording).parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(path, opened.resolve_path(attempt.recording))
    complete_attempt(opened, attempt.id, METRICS)
    return opened


def test_images_show_the_state_before_each_control_step(recording: Recording):
    camera = CameraSpec("wrist", 80, 64, ("depth",))
    frames = [*render_recorded_images(recording, [camera])]
    steps = [control for _, control in recording.messages_by_topic["/control"]]
    assert len(frames) == len(steps) == STEPS
    task, scene = find_task_and_scene(FEEDING)
    names = [entry.name for entry in task.make_observation_spec(scene).entries]
    end = task.make_observation_spec(scene).entry_end_indices[names.index("arm_angles_rad")]
    episodes = rebuild_world(recording.configuration)
    states = [record.state for _, record in recording.messages_by_topic["/physics"]]
    for frame, control in zip(frames, steps, strict=True):
        for state in states:
            episodes.simulation.set_integration_state(np.array(state))
            angles = episodes.simulation.get_joint_positions()[0]
            if angles.tobytes() == np.array(control.observation[end - len(angles) : end]).tobytes():
                (image,) = episodes.render_images([camera])["wrist_depth"]
                assert_array_equal(frame["wrist_depth"], image)
                break
        else:
            raise AssertionError("no state has these angles")
    episodes.close_renderer()


def test_robomimic_and_lerobot_contain_the_images(tmp_path: Path, store: StudyStore, recording: Recording):
    expected = [
        *render_recorded_images(recording, [CameraSpec("wrist", 80, 64, ("rgb", "depth", "segmentation"))])
    ]
    for data_format in ("hdf5", "lerobot"):
        export_study(store, data_format, tmp_path / data_format, cameras=[CAMERA])
    with h5py.File(tmp_path / "hdf5" / "FeedingJaco.hdf5") as file:
        for name in expected[0]:
            found = np.asarray(file[f"data/demo_0/obs/{name}"])
            assert_array_equal(found, [frame[name] for frame in expected])
            assert_array_equal(file[f"data/demo_0/next_obs/{name}"][0], found[1])
    folder = tmp_path / "lerobot" / "FeedingJaco"
    features = json.loads((folder / "meta" / "info.json").read_text())["features"]
    assert features["observation.images.wrist_rgb"]["dtype"] == "image"
    assert features["observation.images.wrist_depth"] == {
        "dtype": "float32",
        "shape": [64, 80],
        "names": None,
    }
    table = pq.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    for row, frame in zip(table.to_pylist(), expected, strict=True):
        picture = Image.open(io.BytesIO(row["observation.images.wrist_rgb"]["bytes"]))
        assert_array_equal(np.asarray(picture), frame["wrist_rgb"])
        assert_array_equal(np.float32(row["observation.images.wrist_depth"]), frame["wrist_depth"])
    statistics = json.loads((folder / "meta" / "stats.json").read_text())
    assert np.shape(statistics["observation.images.wrist_rgb"]["mean"]) == (3, 1, 1)
    assert statistics["observation.images.wrist_depth"]["max"] == [[[MAX_IMAGE_DEPTH_M]]]


def test_cameras_that_cannot_be_exported_are_refused(tmp_path: Path, store: StudyStore):
    with pytest.raises(StudyError, match="csv cannot contain images; allowed: hdf5, lerobot"):
        export_study(store, "csv", tmp_path / "csv", cameras=["wrist"])
    with pytest.raises(StudyError, match="unknown camera 'eye' of robot Jaco; allowed: wrist, scene"):
        export_study(store, "hdf5", tmp_path / "hdf5", cameras=["eye"])
    assert not (tmp_path / "hdf5").exists()
