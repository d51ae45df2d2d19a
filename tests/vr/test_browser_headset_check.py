"""The check of the headset in a real browser: displays, answers and results."""

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.texts.interface_texts import ENGLISH_TEXTS
from avrgym.vr.headset_check import format_faults, make_result_message
from avrgym.vr.latency import LATENCY_STAGES
from avrgym.vr.session import events
from avrgym.vr.session.phases.headset_phases import MAX_SHOWN_FAULTS
from avrgym.vr.session.plan import HeadsetCheckPlan
from helpers.browser.journey import Journey, wait_until
from helpers.vr.visit import constant_policies, plan

pytestmark = pytest.mark.usefixtures("relaxed_limits")


@pytest.mark.slow
def test_the_headset_check_reports_problems(tmp_path: Path) -> None:
    """No frame rate is asserted: the emulated headset draws in software."""
    checked = replace(
        plan(),
        headset_check=HeadsetCheckPlan(rest_duration_s=1.5, stretch_duration_s=0.5, motion_duration_s=1.5),
    )
    with ExitStack() as opened:
        journey = Journey(tmp_path, checked, constant_policies(checked), opened)
        headset, session = journey.headset, journey.session
        headset.set_poses(journey.participant.make_tracking_frame(0.0, moving=False))
        headset.enter_vr()
        wait_until(lambda: session.phase_name == "headset")
        while session.phase_name == "headset":
            headset.wait_for_frames(5)
            headset.pull_trigger("right")
        journey.wait_for_phase("headset_stop")
        headset.press_menu("left")
        for item, value in (("haptics", 2), ("sound", 1)):
            journey.wait_for_buttons(item)
            headset.select_answer(value)
        journey.wait_for_phase("headset")
        (check,) = [each.check for each in journey.observed if isinstance(each, events.HeadsetChecked)]
        told = ENGLISH_TEXTS.format_for_page(make_result_message(check, MAX_SHOWN_FAULTS))
        headset.page.get_by_text(told).first.wait_for(state="attached")
        headset.save_screenshot(tmp_path / "result.png")
    assert "The buzz was not felt" in format_faults(check)
    assert check.emulated
    assert "Chrome" in check.device
    assert check.profiles
    assert check.num_frames > 0
    assert set(check.latency_ms) == {"total_ms", *LATENCY_STAGES}
    assert check.head.jitter_mm == pytest.approx(0.0, abs=0.01)
    assert (check.left.modality, check.right.modality) == ("controller", "controller")
    assert (check.vibration_felt, check.sound_heard, check.stop_method) == (False, True, "button")
