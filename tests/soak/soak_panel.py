"""The panel in VR is covered by nothing, in every environment, as the depth buffer has it: `make soak`."""

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

pytestmark = pytest.mark.usefixtures("unhurried")

PAINT = """(covered) => {
    for (const scene of scenes) scene.traverse((each) => {
        const shown = each.visible && each.geometry?.type === "PlaneGeometry";
        if (shown && each.material.map?.isCanvasTexture) window.panel = each;
    });
    Object.assign(panel.material, { map: null, depthTest: covered, transparent: true, needsUpdate: true });
    panel.material.color.setRGB(1, 0, 1);
    panel.renderOrder = 1000;
}"""
"""Make the panel one colour that nothing else has, drawn last: where other things cover it, or through them."""
LEAST_SHARE_OF_PICTURE = 0.02


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_nothing_covers_the_questions(environment: str, tmp_path: Path) -> None:
    """After a trial, while the robot stands where it has retreated to."""
    trial = TrialPlan(environment, "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 0.5, simulated=True, trial_steps=200)
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
    assert whole > LEAST_SHARE_OF_PICTURE * 640 * 360
    assert seen == whole


def painted(journey: Journey, covered: bool) -> int:
    """How many pixels of both eyes' pictures show the panel."""
    headset = journey.headset
    headset.page.evaluate(PAINT, covered)
    headset.wait_for_frames(3)
    picture = np.asarray(Image.open(io.BytesIO(headset.page.screenshot())).convert("RGB"))
    Image.fromarray(picture).save(journey.folder / f"panel-{covered}.png")
    return int((picture == (255, 0, 255)).all(axis=-1).sum())
