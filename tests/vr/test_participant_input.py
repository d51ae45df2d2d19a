"""Sessions with input profiles: resting arms, changes during a trial, and selections by the experimenter."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from avrgym.recording.input_profile import InputProfile
from avrgym.tasks.registry import TASKS
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    InputProfileMessage,
    OfferedTargets,
    ParticipantTargets,
    SelectionTarget,
    TargetSelected,
    TargetSelectionRequest,
    TrackingFrameMessage,
)
from avrgym.vr.session import events
from avrgym.vr.session.plan import HeadsetCheckPlan
from avrgym.vr.tracking.body import ARM_JOINT_INDICES
from helpers.vr.visit import Visit, plan

SCRATCH = "avrgym/ScratchItchJaco-v1"


class Armless(Visit):
    """A participant whose arms are not tracked while ``untracked``."""

    untracked = True

    def frame(self) -> TrackingFrameMessage:
        frame = super().frame()
        return msgspec.structs.replace(frame, left=None, right=None) if self.untracked else frame


def visiting(folder: Path, profile: InputProfile, **changes) -> Armless:
    return Armless(
        folder, replace(plan(environments=[SCRATCH], trial_steps=20), input_profile=profile, **changes)
    )


def test_untracked_arms_rest_without_events_where_the_profile_needs_none(tmp_path: Path) -> None:
    """The task needs the right arm. It is tracked for a while, then returns to its rest pose."""
    profile = InputProfile("head")
    visit = visiting(tmp_path, profile)
    visit.untracked = False
    visit.go_to("trial")
    visit.untracked = True
    visit.run_until("questionnaire")
    lost = (events.TrackingLost, events.TrackingTimedOut)
    assert not [each for each in visit.observed if isinstance(each, lost)]
    visit.tick(400)
    joints = ARM_JOINT_INDICES["left"] + ARM_JOINT_INDICES["right"]
    rest = TASKS["ScratchItch"].pose_distribution.rest_angles_rad
    np.testing.assert_allclose(visit.session.world.joint_targets_rad[joints], rest[joints], atol=1e-9)
    (recording,) = visit.recordings()
    assert recording.configuration.input_profile == profile
    assert not {"tracking_lost", "pose_held"} & {
        event.name for _, event in recording.messages_by_topic["/events"]
    }


@pytest.mark.slow
def test_the_profile_may_change_during_a_trial(tmp_path: Path) -> None:
    visit = visiting(tmp_path, InputProfile())
    visit.untracked = False
    visit.go_to("trial")
    profile = InputProfile("one-switch", scan_s=2.0, absent_arms=("left",))
    visit.session.change_input_profile(profile, visit.now_s)
    assert (
        visit.received(InputProfileMessage)[-1].method,
        visit.received(InputProfileMessage)[-1].stops,
    ) == ("one-switch", ("switch",))
    visit.untracked = True
    visit.run_until("questionnaire")
    changed = [each.profile for each in visit.observed if isinstance(each, events.InputChanged)]
    assert changed == [profile]
    (recording,) = visit.recordings()
    assert recording.configuration.input_profile == InputProfile()
    assert ("input_changed", profile.describe()) in [
        (event.name, event.detail) for _, event in recording.messages_by_topic["/events"]
    ]


def test_the_experimenter_selects_only_for_a_participant_with_that_profile(tmp_path: Path) -> None:
    visit = visiting(tmp_path, InputProfile("experimenter"))
    offer = OfferedTargets(3, [SelectionTarget(-4, "Go on")])
    visit.send(offer, TargetSelectionRequest(3, -4))
    assert visit.received(ParticipantTargets) == [ParticipantTargets(3, offer.targets)]
    assert visit.received(TargetSelected) == [TargetSelected(3, -4)]
    visit.session.send_initial_state(visit.receive, "experimenter", visit.now_s)
    assert len(visit.received(ParticipantTargets)) == 2
    visit.session.change_input_profile(InputProfile("head"), visit.now_s)
    visit.send(TargetSelectionRequest(3, -4))
    assert len(visit.received(TargetSelected)) == 1
    assert visit.problems[-1].startswith("the participant selects with head")


@pytest.mark.slow
def test_a_stop_by_the_experimenter_is_the_stop_of_some_profiles(tmp_path: Path) -> None:
    check = HeadsetCheckPlan(rest_duration_s=0.1, stretch_duration_s=0.1, motion_duration_s=0.1)
    for profile, phase in (
        (InputProfile("head"), "headset_stop"),
        (InputProfile("experimenter"), "headset_check"),
    ):
        visit = visiting(tmp_path / phase, profile, headset_check=check)
        visit.send(messages.VrEntered())
        visit.tick(10)
        visit.send(messages.ParticipantReady())
        visit.run_until("headset_stop")
        visit.send(messages.ExperimenterCommand("stop"))
        assert visit.phase == phase
