"""Colours of the GLB are those of MuJoCo, for every robot, tool and piece of furniture."""

from collections import Counter

import mujoco
import numpy as np
import pytest

from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.colours import compute_geom_colours, compute_skin_colours, convert_srgb_to_linear
from avrgym.vr.scene.body_surfaces import make_body_surfaces
from avrgym.vr.scene.geom_meshes import make_geom_mesh
from avrgym.vr.scene.scene_export import export_glb, group_geoms_by_body
from avrgym.vr.scene.skins import read_skins
from helpers.browser.glb import GlbFile
from helpers.robots.example_robots import ALL_ROBOTS, scene_of, scenes_of

RED, BLUE, HALF_GREEN = (0.9, 0.1, 0.1, 1.0), (0.1, 0.2, 0.8, 1.0), (0.1, 0.7, 0.2, 0.5)
MADE = """
<mujoco>
  <asset>
    <material name="blue" rgba="0.1 0.2 0.8 1"/>
    <texture name="squares" type="2d" builtin="checker" rgb1="1 1 1" rgb2="0 0 0" width="32" height="32"/>
    <material name="squared" texture="squares" rgba="0.4 0.8 0.4 1"/>
  </asset>
  <default><geom type="box" size=".1 .1 .1" group="2" contype="0" conaffinity="0"/></default>
  <worldbody>
    <body name="plain"><geom/></body>
    <body name="own"><geom rgba="0.9 0.1 0.1 1"/></body>
    <body name="material"><geom material="blue"/></body>
    <body name="both"><geom material="blue" rgba="0.9 0.1 0.1 1"/></body>
    <body name="clear"><geom rgba="0.1 0.7 0.2 0.5"/></body>
    <body name="nothing"><geom rgba="0.1 0.7 0.2 0"/></body>
    <body name="squared"><geom material="squared"/></body>
  </worldbody>
</mujoco>
"""


def drawn_by_mujoco(model: mujoco.MjModel) -> dict[int, np.ndarray]:
    """The colours (4,) with which MuJoCo's renderer draws visible geoms, by the geom."""
    data, option = mujoco.MjData(model), mujoco.MjvOption()
    mujoco.mj_forward(model, data)
    option.geomgroup[:], option.sitegroup[:] = 0, 0
    option.geomgroup[VISUAL_GROUP] = 1
    scene = mujoco.MjvScene(model, maxgeom=10_000)
    mujoco.mjv_updateScene(model, data, option, None, mujoco.MjvCamera(), mujoco.mjtCatBit.mjCAT_ALL, scene)
    geoms = scene.geoms[: scene.ngeom]
    return {geom.objid: geom.rgba.copy() for geom in geoms if geom.objtype == mujoco.mjtObj.mjOBJ_GEOM}


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_each_geom_has_the_colour_that_mujoco_draws(name: str) -> None:
    for model in scenes_of(name):
        ours, drawn = compute_geom_colours(model), drawn_by_mujoco(model)
        assert drawn
        np.testing.assert_allclose([ours[geom] for geom in drawn], list(drawn.values()), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_each_part_of_the_file_has_the_colours_of_its_geoms(name: str) -> None:
    """So many triangles in each colour at each body."""
    for model in scenes_of(name):
        drawn, wanted = drawn_by_mujoco(model), {}
        for carrier, geoms in group_geoms_by_body(model).items():
            colours = wanted.setdefault(model.body(carrier).name, Counter())
            for geom in geoms:
                colours[stored(drawn[geom])] += len(make_geom_mesh(model, geom).faces)
        found = colours_of(GlbFile(export_glb(model)))
        assert {body: wanted[body] for body in found} == found
        assert len(found) > 3


def colours_of(glb: GlbFile) -> dict[str, Counter[tuple[int, ...]]]:
    """How many triangles in which colour each body has; of bodies that look alike one is named."""
    found: dict[str, Counter[tuple[int, ...]]] = {}
    for node in glb["nodes"]:
        extras = node.get("extras", {})
        bodies = [extras["body"]] if "body" in extras else extras.get("bodies", [])[:1]
        meshes = [glb["nodes"][child]["mesh"] for child in node.get("children", [])]
        meshes += [node["mesh"]] if "bodies" in extras else []
        for body in bodies if meshes else ():
            found[body] = Counter()
            for mesh in meshes:
                (primitive,) = glb["meshes"][mesh]["primitives"]
                colours = glb.numbers(primitive["attributes"]["COLOR_0"])
                for corner in glb.numbers(primitive["indices"])[::3, 0]:
                    found[body][tuple(np.round(255 * colours[corner]).astype(int).tolist())] += 1
    return found


def stored(rgba: np.ndarray) -> tuple[int, ...]:
    """A colour as the file has it: linear, of a byte each."""
    return tuple(np.round(255 * convert_srgb_to_linear(rgba[:3].astype(float))).astype(int).tolist())


def test_a_geoms_own_colour_counts_and_else_its_materials() -> None:
    model = mujoco.MjModel.from_xml_string(MADE)
    glb = GlbFile(export_glb(model))
    colours = {body: next(iter(found)) for body, found in colours_of(glb).items()}
    squared = 0.5 * np.array([0.4, 0.8, 0.4, 2.0])
    wanted = {
        "plain": (0.5, 0.5, 0.5, 1.0),
        "own": RED,
        "material": BLUE,
        "both": RED,
        "clear": HALF_GREEN,
        "squared": squared,
    }
    assert colours == {body: stored(np.array(rgba)) for body, rgba in wanted.items()}
    surfaces = {body: found[0].rgba[0] for body, found in make_body_surfaces(model).items()}
    assert list(surfaces) == list(wanted)
    np.testing.assert_allclose(list(surfaces.values()), list(wanted.values()), atol=1e-6)


def test_transparent_geoms_are_blended_and_materials_are_sound() -> None:
    glb = GlbFile(export_glb(mujoco.MjModel.from_xml_string(MADE)))
    for material in glb["materials"]:
        surface = material["pbrMetallicRoughness"]
        alpha = surface.get("baseColorFactor", [1.0])[-1]
        assert (material.get("alphaMode") == "BLEND") == (alpha == 0.5)
        assert 0.0 <= surface["metallicFactor"] <= 1.0
        assert 0.0 <= surface["roughnessFactor"] <= 1.0
    assert sum("alphaMode" in material for material in glb["materials"]) == 1


def test_a_skin_without_a_material_has_its_own_colour() -> None:
    model = scene_of("PR2", "Feeding")
    assert model is not None
    np.testing.assert_allclose(compute_skin_colours(model), model.mat_rgba[model.skin_matid], atol=1e-6)
    model.skin_matid[0], model.skin_rgba[0] = -1, RED
    np.testing.assert_allclose(compute_skin_colours(model)[0], RED, atol=1e-6)
    assert next(skin.rgba[0].tolist() for skin in read_skins(model)) == pytest.approx(RED)
