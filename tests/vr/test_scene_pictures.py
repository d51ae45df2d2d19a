"""The browser shows what ``rgb_array`` shows: one picture of each scene by three.js and by MuJoCo."""

import mujoco
import numpy as np
import pytest
from playwright.sync_api import Browser

from avrgym.vr.scene.scene_export import export_glb
from helpers.browser.glb import GlbFile
from helpers.browser.glb_pictures import camera_at, open_page, render_mujoco, render_three
from helpers.robots.example_robots import ALL_ROBOTS, robot_model, scenes_of

LEAST_OVERLAP = 0.99
"""Of the two silhouettes: what both cover, of what one covers."""
MOST_OFF, OTHERWISE = 24, 0.02
"""The largest difference of colours, in levels of 255, and the share of pixels, at edges, with larger ones."""


def assert_looks_alike(browser: Browser, model: mujoco.MjModel, camera: mujoco.MjvCamera) -> None:
    data = export_glb(model)
    copies = [
        node["extras"]["bodies"] for node in GlbFile(data)["nodes"] if "bodies" in node.get("extras", {})
    ]
    left_out = {model.body(body).id for bodies in copies for body in bodies}
    page = open_page(browser.new_page())
    drawn, wanted = render_three(page, data, model, camera), render_mujoco(model, camera, left_out)
    page.close()
    both = drawn.covered & wanted.covered
    assert both.sum() > LEAST_OVERLAP * (drawn.covered | wanted.covered).sum() > 0
    off = np.abs(drawn.colours - wanted.colours)[both].max(axis=1)
    assert (off > MOST_OFF).mean() < OTHERWISE


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_a_scene_looks_as_mujoco_draws_it(name: str, browser: Browser) -> None:
    """With robot, tool, furniture and person, of every task, from the front left and from behind on the right."""
    for model in scenes_of(name):
        for azimuth in (115.0, 300.0):
            assert_looks_alike(browser, model, camera_at(np.array([-0.2, -0.2, 0.7]), 2.4, azimuth, -15.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", ALL_ROBOTS)
def test_a_robot_looks_as_mujoco_draws_it(name: str, browser: Browser) -> None:
    """From near."""
    model = robot_model(name)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    low, high = data.geom_xpos.min(axis=0), data.geom_xpos.max(axis=0)
    distance = float(np.linalg.norm(high - low)) + 0.3
    assert_looks_alike(browser, model, camera_at(0.5 * (low + high), distance, 130.0, -20.0))
