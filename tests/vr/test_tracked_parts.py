"""A trial counts only while every part of the body that its task needs is tracked: laws over all tasks."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import pytest

from avrgym.models.body_names import TRACKED_BODY_PART_LABELS, TRACKED_BODY_PARTS, TrackedBodyPart
from avrgym.models.human import SEATED_POSE_RAD
from avrgym.people.distributions import POPULATION_DISTRIBUTIONS
from avrgym.people.population_names import IMPAIRMENTS, ImpairmentName
from avrgym.recording.reader import Recording
from avrgym.study.checking.tracking_loss import compute_tracking_loss_fraction, describe_excess_tracking_loss
from avrgym.study.design.design import parse_design, read_default_design_text
from avrgym.tasks import constants
from avrgym.tasks.registry import TASKS
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from avrgym.vr.protocol.messages import (
    TICK_S,
    Modality,
    ParticipantReady,
    PhaseDescription,
    SessionStatus,
    TrackingFrameMessage,
    WorldState,
    XRPose,
)
from avrgym.vr.session import events as read_session_events
from avrgym.vr.tracking.pose_freshness import STALE_POSE_AGE_S, MeasurementTimes
from helpers.vr.visit import FRAME_EVERY_TICKS, Visit, plan

ROBOT = "Jaco"
NAMES = constants.PACKAGED_TASKS
NEEDED = [(name, part) for name in NAMES for part in TASKS[name].tracked_body_parts]
NEEDLESS = [
    (name, part)
    for name in NAMES
    for part in TRACKED_BODY_PARTS
    if part not in TASKS[name].tracked_body_parts
]
FRAME_S = 1.0 / 90.0

Spoil = Callable[[TrackingFrameMessage, TrackingFrameMessage], TrackingFrameMessage]


def missing(*parts: TrackedBodyPart) -> Spoil:
    """Nothing is known of these parts."""
    return lambda frame, first: msgspec.structs.replace(frame, **dict.fromkeys(parts))


def frozen(*parts: TrackedBodyPart) -> Spoil:
    """The device repeats the pose that these parts had first."""
    return lambda frame, first: msgspec.structs.replace(
        frame, **{part: getattr(first, part) for part in parts}
    )


SPOILS: dict[str, Callable[..., Spoil]] = {"missing": missing, "frozen": frozen}


class Spoiled(Visit):
    """A participant whose frames are ``spoiled`` where that is set."""

    spoil: Spoil | None = None
    _first: TrackingFrameMessage | None = None

    def frame(self) -> TrackingFrameMessage:
        frame = super().frame()
        if self.spoil is None:
            self._first = None
            return frame
        self._first = self._first or frame
        return self.spoil(frame, self._first)

    def happened(self, kind: type) -> list[str]:
        """The parts that events of a kind name."""
        return [cast(Any, each).part for each in self.observed if isinstance(each, kind)]


def visiting(folder: Path, task: str, *, steps: int = 40, free_movement_s: float = 0.1) -> Spoiled:
    environment = f"avrgym/{task}{ROBOT}-v1"
    visit = Spoiled(
        folder, plan(environments=[environment], trial_steps=steps, free_movement_s=free_movement_s)
    )
    visit.participant.adopt_posture(environment)
    return visit


def ended(recording: Recording) -> str:
    assert recording.outcome is not None
    return recording.outcome.result


def told(recording: Recording) -> list[tuple[str, str]]:
    return [(event.name, event.detail) for _, event in recording.messages_by_topic["/events"]]


# Sessions ----------------------------------------------------------------------------------------------------


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("kind", SPOILS)
@pytest.mark.parametrize(("task", "part"), NEEDED)
def test_no_trial_counts_in_which_a_needed_part_is_not_tracked(
    tmp_path: Path, task: str, part: TrackedBodyPart, kind: str
) -> None:
    visit = visiting(tmp_path, task)
    visit.go_to("trial")
    visit.spoil = SPOILS[kind](part)
    began_s = visit.now_s
    while visit.phase == "trial" and visit.now_s < began_s + 3.0:
        visit.tick()
        if visit.now_s > began_s + STALE_POSE_AGE_S + 0.25:
            status = visit.received(SessionStatus)[-1]
            assert (status.needed_parts, status.untracked_parts) == (
                list(TASKS[task].tracked_body_parts),
                lost(kind, part),
            )
    assert visit.phase == "paused"
    assert visit.now_s - began_s == pytest.approx(1.0, abs=FRAME_EVERY_TICKS * TICK_S + 2 * TICK_S)
    assert visit.session.attempt is None
    assert part in visit.happened(read_session_events.TrackingLost)
    assert visit.happened(read_session_events.TrackingTimedOut) == [part]
    assert TRACKED_BODY_PART_LABELS[part] in visit.problems[-1]
    text = visit.received(PhaseDescription)[-1].text
    assert ("tracking was lost" if part == "head" else TRACKED_BODY_PART_LABELS[part]) in text.lower()
    (recording,) = visit.recordings()
    assert ended(recording) == "interrupted"
    assert ("tracking_lost", part) in told(recording)
    last = [frame for _, frame in recording.messages_by_topic["/tracking"]][-1]
    assert last.rejected or (part in last.rejected_parts and part in last.untracked_parts)
    assert (compute_tracking_loss_fraction(recording) or 0.0) > 0.7

    visit.send(ParticipantReady())
    visit.tick(100)
    assert (visit.phase, len(visit.session.recordings)) == ("paused", 1)
    visit.spoil = None
    visit.tick(10)
    visit.send(ParticipantReady())
    visit.run_until("questionnaire")
    assert part in visit.happened(read_session_events.TrackingFound)
    visit.answer(4, 4, 4, 4)
    assert [ended(each) for each in visit.recordings()] == ["interrupted", "completed"]


def lost(kind: str, part: TrackedBodyPart) -> list[TrackedBodyPart]:
    """A frame without a head says nothing of the hands either."""
    return list(TRACKED_BODY_PARTS) if (kind, part) == ("missing", "head") else [part]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("kind", SPOILS)
@pytest.mark.parametrize(("task", "part"), NEEDLESS)
def test_a_part_that_the_task_does_not_need_ends_nothing(
    tmp_path: Path, task: str, part: TrackedBodyPart, kind: str
) -> None:
    visit = visiting(tmp_path, task, steps=15)
    visit.spoil = SPOILS[kind](part)
    visit.go_to("questionnaire")
    assert visit.received(SessionStatus)[-1].untracked_parts == [part]
    assert part in visit.received(WorldState)[-1].deviating_parts
    visit.answer(4, 4, 4, 4)
    (recording,) = visit.recordings()
    assert ended(recording) == "completed"
    assert compute_tracking_loss_fraction(recording) == pytest.approx(0.0, abs=1e-9)
    frames = [frame for _, frame in recording.messages_by_topic["/tracking"] if frame.moved_person]
    assert all(frame.untracked_parts == [part] for frame in frames)
    assert not visit.happened(read_session_events.TrackingLost)


@pytest.mark.parametrize("kind", SPOILS)
def test_no_trial_begins_before_its_needed_parts_are_tracked(tmp_path: Path, kind: str) -> None:
    visit = visiting(tmp_path, "ScratchItch")
    visit.spoil = SPOILS[kind]("left", "right")
    visit.confirms = False
    visit.calibrate()
    visit.run_until("check")
    visit.tick(100)
    visit.send(ParticipantReady())
    assert visit.phase == "paused"
    assert "right hand is not tracked" in visit.received(PhaseDescription)[-1].text
    assert not visit.session.recordings
    visit.spoil = None
    visit.tick(10)
    visit.send(ParticipantReady())
    visit.run_until("trial")


def test_the_countdown_waits_for_a_needed_hand(tmp_path: Path) -> None:
    visit = visiting(tmp_path, "ScratchItch", free_movement_s=0.3)
    visit.go_to("free_before")
    visit.spoil = missing("right")
    visit.tick(70)
    assert visit.phase == "countdown"
    visit.spoil = None
    visit.tick(5)
    assert visit.phase == "trial"


@pytest.mark.slow
def test_a_hand_that_is_lost_for_a_while_counts_as_held_by_its_part(tmp_path: Path) -> None:
    visit = visiting(tmp_path, "ScratchItch", steps=40)
    visit.go_to("trial")
    visit.tick(50)
    visit.spoil = missing("right")
    visit.tick(80)
    visit.spoil = None
    visit.run_until("questionnaire")
    visit.answer(4, 4, 4, 4)
    (recording,) = visit.recordings()
    assert ended(recording) == "completed"
    assert compute_tracking_loss_fraction(recording) == pytest.approx(
        (0.8 - STALE_POSE_AGE_S) / 4.0, abs=0.03
    )
    assert compute_tracking_loss_fraction(recording, "left") == pytest.approx(0.0, abs=1e-9)
    why = describe_excess_tracking_loss(recording, parse_design(read_default_design_text()))
    print(f"\n{why}")
    assert why is not None
    assert "left hand 0.0 %, right hand 1" in why


def test_a_stream_that_repeats_itself_is_nobodys(tmp_path: Path) -> None:
    """The device sleeps, and its browser goes on counting frames."""
    asleep = visiting(tmp_path, "Feeding")
    asleep.go_to("trial")
    asleep.spoil = frozen(*TRACKED_BODY_PARTS)
    asleep.tick(120)
    assert asleep.phase == "paused"
    assert asleep.happened(read_session_events.TrackingTimedOut) == ["head"]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("task", NAMES)
def test_whoever_takes_part_with_a_mouse_and_keeps_still_is_tracked(tmp_path: Path, task: str) -> None:
    visit = visiting(tmp_path, task, steps=15)
    still = frozen(*TRACKED_BODY_PARTS)
    visit.spoil = lambda frame, first: msgspec.structs.replace(
        still(frame, first), left_modality="mouse", right_modality="mouse"
    )
    visit.go_to("questionnaire")
    visit.answer(4, 4, 4, 4)
    (recording,) = visit.recordings()
    assert (ended(recording), compute_tracking_loss_fraction(recording)) == (
        "completed",
        pytest.approx(0.0, abs=1e-9),
    )


# Parts -------------------------------------------------------------------------------------------------------


def pose(x_m: float) -> XRPose:
    return XRPose((x_m, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))


def frame(number: int, kept: Mapping[str, XRPose | None], by_mouse: str = "") -> TrackingFrameMessage:
    poses = {part: pose(1e-9 * number) for part in TRACKED_BODY_PARTS} | dict(kept)
    modality: list[Modality] = ["mouse" if side == by_mouse else "controller" for side in ("left", "right")]
    return TrackingFrameMessage(number, 0.0, poses["head"], poses["left"], poses["right"], *modality)


def seen(frames: int, make: Callable[[int], TrackingFrameMessage]) -> tuple[TrackedBodyPart, ...]:
    """Which parts are stale after so many frames."""
    freshness = MeasurementTimes()
    for number in range(frames):
        freshness.update(make(number), number * FRAME_S)
    return freshness.find_stale_parts((frames - 1) * FRAME_S)


STALE_FRAMES = round(STALE_POSE_AGE_S / FRAME_S) + 2


@pytest.mark.parametrize("part", TRACKED_BODY_PARTS)
@pytest.mark.parametrize("kept", [None, pose(0.5)])
def test_a_part_is_stale_after_0_2_s_without_a_new_pose(part: TrackedBodyPart, kept: XRPose | None) -> None:
    def make(number: int) -> TrackingFrameMessage:
        return frame(number, {part: kept} if number else {})

    assert seen(STALE_FRAMES - 2, make) == ()
    assert seen(STALE_FRAMES + 1, make) == (part,)


def test_poses_that_come_more_seldom_than_frames_are_fresh() -> None:
    """Hands seen at 15 Hz by a headset of 90 Hz."""
    assert seen(200, lambda number: frame(number, {"right": pose(1e-9 * (number // 6))})) == ()


@pytest.mark.parametrize("hand", ["left", "right"])
def test_a_mouse_that_rests_is_fresh(hand: str) -> None:
    kept = {"head": pose(0.0), hand: pose(0.3)}
    assert seen(200, lambda number: frame(number, kept, by_mouse=hand)) == ()


def test_before_the_first_frame_no_part_is_stale_and_none_is_tracked() -> None:
    freshness = MeasurementTimes()
    assert freshness.find_stale_parts(10.0) == ()
    assert freshness.compute_pose_age_s("head", 10.0) == np.inf


@pytest.mark.parametrize("people", ["original", "participants"])
@pytest.mark.parametrize("impairment", IMPAIRMENTS)
@pytest.mark.fast_cases(5)
def test_no_simulated_participant_repeats_a_pose(people: str, impairment: ImpairmentName) -> None:
    someone = SimulatedParticipant(
        sample_participant_traits("man", 3, POPULATION_DISTRIBUTIONS[people], impairment), 3
    )
    frames = [someone.make_tracking_frame(0.02 * n, moving=n >= 50) for n in range(100)]
    frames += [someone.make_tracking_frame_from_angles(SEATED_POSE_RAD, 3.0 + 0.02 * n) for n in range(50)]
    for part in TRACKED_BODY_PARTS:
        assert all(getattr(a, part) != getattr(b, part) for a, b in pairwise(frames))


# Records -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("parts", [(), ("right",), ("head", "nose"), ("left", "right")])
def test_a_task_needs_the_head_and_nothing_else_than_arms(parts: tuple[str, ...]) -> None:
    with pytest.raises(
        ValueError,
        match=r"task Feeding: the field `tracked_body_parts` is .* allowed: 'head', and 'left' or 'right'",
    ):
        replace(TASKS["Feeding"], tracked_body_parts=parts)  # type: ignore[arg-type]


def test_a_task_needs_the_head_and_the_arm_that_it_serves() -> None:
    """People offer the right arm. In dressing they keep still, and the sleeve goes over the left arm."""
    for name in NAMES:
        if TASKS[name].offered_body_part == "arm":
            arms: tuple[str, ...] = ("right",)
        else:
            arms = ("left",) if name == "Dressing" else ()
        assert TASKS[name].tracked_body_parts == ("head", *arms)


@pytest.mark.slow
def test_a_recording_tells_which_parts_its_task_needs(tmp_path: Path) -> None:
    visit = visiting(tmp_path, "ScratchItch")
    visit.go_to("free_before")
    visit.leave()
    assert visit.recordings()[0].configuration.needed_parts == ("head", "right")
