"""Nothing covers the VR panel in any environment, by the depth buffer: `make soak`."""

import io
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from helpers.browser.journey import WATCH_SCENES, Journey, draw_triangles

pytestmark = pytest.mark.usefixtures("relaxed_limits")

PAINT = """(covered) => {
    for (const scene of scenes) scene.traverse((each) => {
        const shown = each.visible && each.geometry?.type === "PlaneGeometry";
        if (shown && each.material.map?.isCanvasTexture) window.panel = each;
    });
    Object.assign(panel.material, { map: null, depthTest: covered, transparent: true, needsUpdate: true });
    panel.material.color.setRGB(1, 0, 1);
    panel.renderOrder = 1000;
}"""
"""Paint the panel in a unique colour and draw it last, with or without the depth test."""
MIN_IMAGE_SHARE = 0.02


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_nothing_covers_the_questions(environment: str, tmp_path: Path) -> None:
    """After a trial, with the robot at its retreat position."""
    trial = TrialPlan(environment, "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 0.5, is_simulated=True, trial_steps=200)
    with ExitStack() as opened:
        journey = Journey(
            tmp_path, plan, load_policies(plan), opened, script=WATCH_SCENES, width=640, height=360
        )
        journey.enter()
        journey.calibrate()
        journey.wait_for_buttons(LIKERT_ITEMS[0].id)
        draw_triangles(journey.headset)
        seen, whole = (painted(journey, covered) for covered in (True, False))
    print(f"\n{environment}: {seen} of the panel's {whole} pixels are seen")
    assert whole > MIN_IMAGE_SHARE * 640 * 360
    assert seen == whole


def painted(journey: Journey, covered: bool) -> int:
    """Count the pixels of the panel in the images of both eyes."""
    headset = journey.headset
    headset.page.evaluate(PAINT, covered)
    headset.wait_for_frames(3)
    picture = np.asarray(Image.open(io.BytesIO(headset.page.screenshot())).convert("RGB"))
    Image.fromarray(picture).save(journey.folder / f"panel-{covered}.png")
    return int((picture == (255, 0, 255)).all(axis=-1).sum())
