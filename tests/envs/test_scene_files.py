"""Exported scenes for other programs: the same world at the start of an episode."""

import json
from importlib import import_module
from pathlib import Path

import mujoco
import numpy as np
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.envs.scene_files import INITIAL_STATE_FILE, MJB_FILE, MJCF_FILE, USD_FILE, write_scene, write_usd
from avrgym.models import human
from avrgym.tasks.episodes import Episodes

STEPS = 100
SIX_DIGITS_M = 1e-5
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
SCENES = {"avrgym/FeedingPR2-v1": "none", "avrgym/BedBathingJaco-v1": "tremor"}
CHAIR, BED = SCENES


def reset_episodes(environment: str, impairment: str = "none") -> Episodes:
    episodes = Episodes(environment, 1, people="revised", impairment=impairment, num_threads=1)
    episodes.reset(np.array([0]), [np.random.default_rng(3)])
    return episodes


def at_start(model: mujoco.MjModel, folder: Path) -> mujoco.MjData:
    data = mujoco.MjData(model)
    state = json.loads((folder / INITIAL_STATE_FILE).read_text())["integration_state"]
    mujoco.mj_setState(model, data, np.array(state), STATE)
    mujoco.mj_forward(model, data)
    return data


@pytest.fixture(scope="module", params=SCENES)
def written(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Episodes, Path]:
    """A scene at its start, and the folder it is written into."""
    episodes = reset_episodes(request.param, SCENES[request.param])
    folder = tmp_path_factory.mktemp("scene") / "out"
    write_scene(episodes, folder)
    return episodes, folder


def test_the_mjcf_has_the_same_kinematics_and_begins_by_its_key(written: tuple[Episodes, Path]) -> None:
    _, folder = written
    binary = mujoco.MjModel.from_binary_path(str(folder / MJB_FILE))
    model = mujoco.MjModel.from_xml_path(str(folder / MJCF_FILE))
    data, expected = mujoco.MjData(model), at_start(binary, folder)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    mujoco.mj_kinematics(model, data)
    names = [binary.body(number).name for number in range(binary.nbody)]
    assert [model.body(number).name for number in range(model.nbody)] == names
    np.testing.assert_allclose(data.xpos, expected.xpos, atol=SIX_DIGITS_M)
    np.testing.assert_allclose(data.xmat, expected.xmat, atol=SIX_DIGITS_M)
    np.testing.assert_allclose(model.body_mass, binary.body_mass, rtol=SIX_DIGITS_M)
    for geom in human.GEOMS:
        name = human.PERSON_NAME_PREFIX + geom
        np.testing.assert_allclose(model.geom(name).size, binary.geom(name).size, atol=SIX_DIGITS_M)


def test_the_mjcf_shows_person_and_robot_and_says_what_it_lacks(written: tuple[Episodes, Path]) -> None:
    episodes, folder = written
    model = mujoco.MjModel.from_xml_path(str(folder / MJCF_FILE))
    assert model.nskin > 5
    assert model.ntex >= 2
    assert model.nmesh > 10
    binary = mujoco.MjModel.from_binary_path(str(folder / MJB_FILE))
    hips = binary.body("person/hips").id
    assert (binary.body_invweight0[hips, 0] > model.body_invweight0[hips, 0]).all()
    assert json.loads((folder / INITIAL_STATE_FILE).read_text())["environment"] == episodes.environment_id


def test_the_mjb_steps_to_the_same_bits(written: tuple[Episodes, Path]) -> None:
    """Episodes step on from where they were written: the other tests look at files alone."""
    episodes, folder = written
    model = mujoco.MjModel.from_binary_path(str(folder / MJB_FILE))
    data = at_start(model, folder)
    for _ in range(STEPS):
        episodes.simulation.step(1)
        mujoco.mj_step(model, data)
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    np.testing.assert_array_equal(state, episodes.simulation.get_integration_state())


@pytest.mark.slow
def test_usd_shows_the_scene_where_it_stands(tmp_path: Path) -> None:
    Usd = pytest.importorskip("pxr.Usd", reason="`pip install avrgym[usd]` brings what reads USD")
    UsdGeom = import_module("pxr.UsdGeom")
    episodes = reset_episodes(BED)
    write_usd(episodes, tmp_path / USD_FILE)
    stage = Usd.Stage.Open(str(tmp_path / USD_FILE))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    boxes = UsdGeom.BBoxCache(Usd.TimeCode(1), ["default"])
    of = {prim.GetName(): prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)}
    assert len(of) > 50
    (face,) = (prim for name, prim in of.items() if "person_face" in name)
    head = mujoco.MjData(episodes.simulation.model)
    head.qpos[:] = episodes.simulation.get_qpos(0)
    placed = episodes.simulation.batch.get_model(0)
    mujoco.mj_kinematics(placed, head)
    centre = head.body("person/head").xpos
    box = boxes.ComputeWorldBound(face).ComputeAlignedRange()
    assert np.abs(np.array(box.GetMidpoint()) - centre).max() < 0.1


def test_the_command_overwrites_nothing_and_names_what_is_missing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = CliRunner().invoke
    said = run(app, ["export", "scene", CHAIR, str(tmp_path)])
    assert (said.exit_code, "already exists; choose a new folder" in said.output) == (1, True)
    monkeypatch.setattr("avrgym.cli.export.find_spec", lambda _: None)
    said = run(app, ["export", "scene", CHAIR, str(tmp_path / "new"), "--usd"])
    assert (said.exit_code, "pip install avrgym[usd]" in said.output) == (1, True)
    assert not (tmp_path / "new").exists()
    said = run(app, ["export", "scene", CHAIR, str(tmp_path / "new")])
    assert said.exit_code == 0
    assert sorted(file.name for file in (tmp_path / "new").glob("scene.*")) == [MJB_FILE, MJCF_FILE]
