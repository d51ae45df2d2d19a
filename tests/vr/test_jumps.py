"""The body does not follow jumping poses: laws of single limbs, then of sessions with hostile tracking."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
import pytest

from avrgym.recording.reader import Recording
from avrgym.recording.schema import TrackingFrame
from avrgym.vr.protocol.messages import TICK_S, TrackingFrameMessage, XRPose
from avrgym.vr.protocol.webxr import is_valid_pose
from avrgym.vr.tracking.jumps import (
    JUMP_RECOVERY_S,
    RETURN_SPEED_FRACTION,
    TRACKED_BODY_PARTS,
    PoseFilter,
    compute_min_travel_time_s,
)
from avrgym.vr.tracking.tracking_frames import TrackingFeed
from helpers.vr.teleporting_hands import IMPACT_N, PATTERNS, peak_force_n, random_pose_near
from helpers.vr.visit import Visit, plan

REST = XRPose((0.0, 1.2, 0.0), (0.0, 0.0, 0.0, 1.0))
FASTEST_FRAME_S = 1.0 / 120.0


def towards(pose: XRPose, seconds: float, rng: np.random.Generator) -> XRPose:
    """A pose as far away as the fastest gets in so many seconds, or less far."""
    goal = random_pose_near(pose, rng, 1.0)
    share = min(1.0, rng.uniform(0.0, 0.999) * seconds / compute_min_travel_time_s(pose, goal))
    turn = np.array(pose.orientation) * (1 - share) + share * np.array(goal.orientation) * np.sign(
        np.dot(pose.orientation, goal.orientation)
    )
    position = np.array(pose.position) * (1 - share) + share * np.array(goal.position)
    x, y, z = np.clip(position, -9.0, 9.0).tolist()
    nearer = XRPose((x, y, z), tuple((turn / np.linalg.norm(turn)).tolist()))
    return nearer if compute_min_travel_time_s(pose, nearer) < seconds else pose


def test_what_a_person_can_do_is_followed_exactly() -> None:
    rng, limb, pose, now_s = np.random.default_rng(1), PoseFilter(), REST, 0.0
    for _ in range(5000):
        passed_s = float(rng.uniform(FASTEST_FRAME_S, 0.05))
        pose, now_s = towards(pose, passed_s, rng), now_s + passed_s
        limb.update(pose, now_s, now_s)
        assert limb.compute_filtered_pose(now_s) == pose
        assert not limb.is_deviating


def test_a_jump_is_held_and_the_limb_comes_at_leisure() -> None:
    limb, away = PoseFilter(), XRPose((0.3, 1.2, 0.0), REST.orientation)
    followed = []
    for tick in range(300):
        now_s = tick * TICK_S
        limb.update(REST if tick < 10 else away, now_s, now_s)
        followed.append(limb.compute_filtered_pose(now_s))
    steps_s = [compute_min_travel_time_s(one, other) for one, other in pairwise(followed)]
    moved = [tick for tick, step_s in enumerate(steps_s) if step_s > 0.0]
    assert moved[0] == pytest.approx(10 + JUMP_RECOVERY_S / TICK_S, abs=2)
    assert max(steps_s) == pytest.approx(RETURN_SPEED_FRACTION * TICK_S)
    assert len(moved) == pytest.approx(
        compute_min_travel_time_s(REST, away) / (RETURN_SPEED_FRACTION * TICK_S), abs=2
    )
    assert followed[-1] == away
    assert not limb.is_deviating


def test_who_teleports_at_90_hz_moves_nothing() -> None:
    """Only a pose that happens to lie where the limb can have got is believed."""
    rng, limb = np.random.default_rng(3), PoseFilter()
    limb.update(REST, 0.0, 0.0)
    assert limb.compute_filtered_pose(0.0) == REST
    for frame in range(1, 9000):
        now_s = frame / 90.0
        limb.update(random_pose_near(REST, rng, 1.0), now_s, now_s)
        assert limb.compute_filtered_pose(now_s) == REST


def test_no_sequence_of_poses_makes_a_limb_faster_than_the_fastest() -> None:
    """Random mixtures of jumps, gaps, rests and movement."""
    rng = np.random.default_rng(4)
    for _ in range(200):
        limb, pose, followed, followed_s = PoseFilter(), REST, REST, 0.0
        limb.update(REST, 0.0, 0.0)
        limb.compute_filtered_pose(0.0)
        for tick in range(1, 150):
            now_s = tick * TICK_S
            kind = rng.choice(["jump", "gap", "rest", "move"], p=[0.05, 0.2, 0.5, 0.25])
            if kind == "jump":
                pose = random_pose_near(REST, rng, 1.0)
            elif kind == "move":
                pose = towards(pose, TICK_S, rng)
            if kind != "gap":
                limb.update(pose, now_s, now_s)
            here = limb.compute_filtered_pose(now_s)
            assert is_valid_pose(here)
            if here != followed:
                assert compute_min_travel_time_s(followed, here) <= now_s - followed_s + 1e-6
            if kind != "gap":
                followed, followed_s = here, now_s


def frame(number: int, client_s: float, x_m: float) -> TrackingFrameMessage:
    head = XRPose((x_m, 1.2, 0.0), REST.orientation)
    return TrackingFrameMessage(number, 1000.0 * client_s, head, None, None, "none", "none")


def test_frames_that_the_network_held_up_lie_as_far_apart_as_they_were_captured() -> None:
    feed = TrackingFeed()
    arrivals_s = [0.0, *[0.2] * 9, *[0.21] * 9]
    captured_s = [
        feed.add(frame(number, 5.0 + number / 90.0, 0.0), now_s).captured_s
        for number, now_s in enumerate(arrivals_s)
    ]
    assert np.diff(captured_s[1:]) == pytest.approx(1.0 / 90.0)


@pytest.mark.parametrize("step_s", [0.0, 0.1, 1e9, -1e9, float("nan"), float("inf"), -float("inf")])
def test_no_clock_of_a_client_runs_ahead_of_the_present_or_stands_still(step_s: float) -> None:
    feed, before_s = TrackingFeed(), -np.inf
    for number in range(200):
        now_s = number / 90.0
        captured_s = feed.add(frame(number, number * step_s, 0.0), now_s).captured_s
        assert max(before_s, now_s - 0.2) <= captured_s <= now_s
        before_s = captured_s


# Sessions ----------------------------------------------------------------------------------------------------


@pytest.fixture
def visit(tmp_path: Path) -> Iterator[Visit]:
    visit = Visit(tmp_path, plan(free_movement_s=3.0))
    yield visit
    visit.leave()


def frames(recording: Recording) -> list[TrackingFrame]:
    return [record for _, record in recording.messages_by_topic["/tracking"]]


def test_a_hand_that_jumps_is_held_and_the_recording_says_so(visit: Visit) -> None:
    visit.go_to("free_before")
    visit.tracking = False
    visit.tick(2)
    for _ in range(20):
        tracking = visit.frame()
        assert tracking.left is not None
        x, y, z = tracking.left.position
        visit.send(msgspec.structs.replace(tracking, left=XRPose((x, y + 0.5, z), tracking.left.orientation)))
        visit.tick()
    visit.leave()
    (recording,) = visit.recordings()
    events = [(event.name, event.detail) for _, event in recording.messages_by_topic["/events"]]
    assert ("pose_held", "left") in events
    assert not {("pose_held", part) for part in TRACKED_BODY_PARTS if part != "left"} & set(events)
    assert all(each.moved_person and each.rejected_parts == ["left"] for each in frames(recording)[-20:])


@pytest.mark.slow
@pytest.mark.parametrize("attack", PATTERNS)
def test_teleporting_poses_press_no_harder_than_a_person_at_rest_and_a_slow_impact(
    tmp_path: Path, attack: str
) -> None:
    environment = "avrgym/FeedingJaco-v1"
    at_rest_n, attacked_n = (
        peak_force_n(tmp_path / name, environment, 1, name, steps=20) for name in ("rest", attack)
    )
    print(f"\n{attack}: {attacked_n:.0f} N, at rest {at_rest_n:.0f} N, a slow impact {IMPACT_N:.0f} N")
    assert attacked_n < at_rest_n + IMPACT_N
