"""A resting hand does not move when its device changes: laws of single hands, then of sessions."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.vr.protocol.messages import Modality, TrackingFrameMessage, WorldState, XRPose
from avrgym.vr.protocol.webxr import (
    Pose,
    Registration,
    compute_hand_pose,
    compute_hand_pose_from_wrist,
    convert_wrist_to_grip,
)
from avrgym.vr.tracking.hand_device_switches import (
    CORRECTION_DECAY_PER_M,
    MAX_DEVICE_OFFSET_M,
    MAX_REST_DISPLACEMENT_M,
    MAX_SWITCH_GAP_S,
    HandDevice,
)
from avrgym.vr.tracking.jumps import MAX_LINEAR_SPEED_M_S, compute_min_travel_time_s
from helpers.vr import device_switch_examples
from helpers.vr.device_switch_examples import (
    NO_ERROR,
    SIDES,
    Error,
    Side,
    compose,
    measured_pose,
    random_error,
    random_grip,
)
from helpers.vr.visit import Visit, plan

MOST_M, MOST_DEG = 0.02, 5.0
GAPS_S = (0.0, 0.1, 0.3, 1.0)
FRAME_S = 1.0 / 72.0
HERE = Registration(np.zeros(3), 0.3)
WAYS: tuple[tuple[Modality, Modality], ...] = (("controller", "hand"), ("hand", "controller"))
NOISE_M = 0.001


def apart(one: Pose, other: Pose) -> tuple[float, float]:
    """Metres and degrees."""
    angle_rad = transforms.angle_between(transforms.normalize(one.q_w), transforms.normalize(other.q_w))
    return float(np.linalg.norm(one.pos_w - other.pos_w)), float(np.degrees(angle_rad))


def trembling(rng: np.random.Generator, grip: XRPose) -> XRPose:
    return compose(grip, rng.normal(scale=NOISE_M, size=3), transforms.IDENTITY_QUATERNION)


# Hands -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", SIDES)
def test_a_wrist_is_the_grip_of_the_same_hand(side: Side, rng: np.random.Generator) -> None:
    for _ in range(50):
        wrist = random_grip(rng)
        hand = compute_hand_pose_from_wrist(HERE, wrist, side)
        assert apart(compute_hand_pose(HERE, convert_wrist_to_grip(wrist, side)), hand) == pytest.approx(
            (0.0, 0.0), abs=1e-5
        )


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("gap_s", GAPS_S)
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("way", WAYS)
def test_a_resting_hand_stays_where_it_is(
    way: tuple[Modality, Modality], side: Side, gap_s: float, rng: np.random.Generator
) -> None:
    """Whatever two devices think of it, to and fro, for ten seconds each."""
    farthest = np.zeros(2)
    for _ in range(20):
        rest, hand, time_s = random_grip(rng), HandDevice(side), 0.0
        errors = [random_error(rng, rng.uniform(0.0, 0.06), rng.uniform(0.0, 35.0)) for _ in way]
        begins: Pose | None = None
        for turn in range(4):
            for _ in range(120):
                time_s += FRAME_S
                pose = measured_pose(trembling(rng, rest), side, way[turn % 2], errors[turn % 2])
                followed = compute_hand_pose(HERE, hand.correct_grip(pose, way[turn % 2], time_s))
                begins = begins or followed
                farthest = np.maximum(farthest, apart(followed, begins))
            time_s += gap_s
    print(f"\nat most {100 * farthest[0]:.1f} cm, {farthest[1]:.1f}°")
    assert farthest[0] < MOST_M
    assert farthest[1] < MOST_DEG


def test_a_controller_that_nothing_takes_the_place_of_is_followed_to_the_last_bit(
    rng: np.random.Generator,
) -> None:
    hand = HandDevice("right")
    for number in range(200):
        pose = random_grip(rng)
        assert hand.correct_grip(pose, "controller", number * FRAME_S) is pose


@pytest.mark.parametrize("side", SIDES)
def test_the_correction_fades_while_the_hand_moves_and_nobody_sees_it(
    side: Side, rng: np.random.Generator
) -> None:
    hand, error = HandDevice(side), random_error(rng, 0.1, 40.0)
    grip = random_grip(rng)
    hand.correct_grip(grip, "controller", 0.0)
    steps_m, lengths_m = [], []
    before: XRPose | None = None
    for number in range(1, 400):
        grip = compose(grip, np.array([0.006, 0.0, 0.0]), transforms.IDENTITY_QUATERNION)
        followed = hand.correct_grip(measured_pose(grip, side, "hand", error), "hand", number * FRAME_S)
        true = convert_wrist_to_grip(measured_pose(grip, side, "hand", error), side)
        lengths_m.append(apart(compute_hand_pose(HERE, followed), compute_hand_pose(HERE, true))[0])
        if before is not None:
            steps_m.append(float(np.linalg.norm(np.subtract(followed.position, before.position))))
        before = followed
    assert lengths_m[0] > 0.05
    assert lengths_m[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.diff(lengths_m).max() < 1e-9
    assert max(steps_m) < 0.006 + CORRECTION_DECAY_PER_M * (MAX_REST_DISPLACEMENT_M + 0.006) + 0.002


def test_who_is_elsewhere_has_moved(rng: np.random.Generator) -> None:
    """Farther than devices are apart, or after a long time: there the hand is."""
    for way_m, gap_s in ((2.0 * MAX_DEVICE_OFFSET_M, 0.1), (0.05, 1.5 * MAX_SWITCH_GAP_S)):
        hand, grip = HandDevice("right"), random_grip(rng)
        hand.correct_grip(grip, "controller", 0.0)
        wrist = measured_pose(grip, "right", "hand", random_error(rng, way_m, 10.0))
        assert hand.correct_grip(wrist, "hand", gap_s) == convert_wrist_to_grip(wrist, "right")


def test_devices_that_take_turns_add_up_to_nothing(rng: np.random.Generator) -> None:
    """After any number of switches a resting hand that its first device sees again is where that sees it."""
    hand, rest, error = HandDevice("left"), random_grip(rng), random_error(rng, 0.08, 30.0)
    for number in range(201):
        modality: Modality = "hand" if number % 2 else "controller"
        pose = measured_pose(rest, "left", modality, error if number % 2 else NO_ERROR)
        followed = hand.correct_grip(pose, modality, number * FRAME_S)
    assert apart(compute_hand_pose(HERE, followed), compute_hand_pose(HERE, rest)) == pytest.approx(
        (0.0, 0.0), abs=1e-4
    )


def test_no_switch_makes_a_hand_faster_than_the_fastest(rng: np.random.Generator) -> None:
    """Hands that move at up to 1.5 m/s while their devices change."""
    for _ in range(50):
        hand, grip, error = HandDevice("right"), random_grip(rng), random_error(rng, 0.05, 30.0)
        modality: Modality = "controller"
        before = grip
        for number in range(200):
            grip = compose(grip, rng.uniform(-0.012, 0.012, 3), transforms.IDENTITY_QUATERNION)
            if rng.uniform() < 0.1:
                modality = "hand" if modality == "controller" else "controller"
            pose = measured_pose(grip, "right", modality, error if modality == "hand" else NO_ERROR)
            followed = hand.correct_grip(pose, modality, number * FRAME_S)
            assert number == 0 or compute_min_travel_time_s(before, followed) < FRAME_S
            before = followed
    assert MAX_LINEAR_SPEED_M_S * FRAME_S > 0.1


def test_the_clients_examples_are_what_the_server_follows() -> None:
    stored = json.loads(device_switch_examples.FILE.read_text("utf-8"))
    followed = list(device_switch_examples.examples())
    assert len(stored) == len(followed)
    for one, other in zip(stored, followed, strict=True):
        assert [frame["modality"] for frame in one["frames"]] == [
            frame["modality"] for frame in other["frames"]
        ]
        for name in ("pose", "grip"):
            np.testing.assert_allclose(_numbers(one, name), _numbers(other, name), atol=1e-9)


def _numbers(example: dict[str, Any], name: str) -> np.ndarray:
    return np.array([np.concatenate(frame[name]) for frame in example["frames"]])


# Sessions ----------------------------------------------------------------------------------------------------


class Switching(Visit):
    """A participant who rests; ``devices`` gives what a hand is tracked with at a time, and how that misjudges it."""

    side: Side = "right"
    devices: Callable[[float], tuple[Modality, Error]] = staticmethod(lambda now_s: ("controller", NO_ERROR))

    def frame(self) -> TrackingFrameMessage:
        frame = super().frame()
        modality, error = self.devices(self.now_s)
        grip = getattr(frame, self.side)
        pose = None if modality == "none" else measured_pose(grip, self.side, modality, error)
        return msgspec.structs.replace(frame, **{self.side: pose, f"{self.side}_modality": modality})

    def hand(self) -> Pose:
        """Where the hand is simulated in the latest state."""
        at = self.session.bodies.index(f"{human.PERSON_NAME_PREFIX}{self.side}_hand")
        poses = np.frombuffer(self.received(WorldState)[-1].poses, "<f4").reshape(-1, 7).astype(float)
        return Pose(poses[at, :3], poses[at, 3:])


def farthest(
    folder: Path, way: tuple[Modality, Modality], side: Side, gap_s: float, errors: list[Error]
) -> np.ndarray:
    """How far the simulated hand of somebody who rests gets from where it was before the switch, cm and degrees."""
    visit = Switching(folder, replace(plan(free_movement_s=30.0), countdown_s=0.1))
    visit.side, switches_s = side, np.inf
    visit.devices = lambda now_s: (
        (way[0], errors[0]) if now_s < switches_s
        else ("none", NO_ERROR) if now_s < switches_s + gap_s
        else (way[1], errors[1])
    )  # fmt: skip
    visit.go_to("free_before")
    visit.pose_rad = visit.participant._rest_rad
    visit.tick(250)
    switches_s, before, found = visit.now_s, visit.hand(), np.zeros(2)
    for _ in range(round((gap_s + 4.0) * 100)):
        visit.tick()
        found = np.maximum(found, apart(visit.hand(), before))
    assert visit.phase == "free_before"
    visit.leave()
    return found


@pytest.mark.slow
@pytest.mark.parametrize("gap_s", [0.0, 0.3])
@pytest.mark.parametrize("way", WAYS)
def test_the_simulated_hand_stays_where_it_is(
    tmp_path: Path, way: tuple[Modality, Modality], gap_s: float, rng: np.random.Generator
) -> None:
    side = SIDES[round(10 * gap_s) % 2]
    found = farthest(tmp_path, way, side, gap_s, [random_error(rng, 0.04, 25.0) for _ in way])
    print(f"\n{side} {way} after {gap_s} s: {100 * found[0]:.2f} cm, {found[1]:.1f}°")
    assert found[0] < MOST_M
    assert found[1] < MOST_DEG


@pytest.mark.slow
@pytest.mark.parametrize("gap_s", GAPS_S)
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("way", WAYS)
def test_the_simulated_hand_stays_where_it_is_after_any_gap_and_on_both_sides(
    tmp_path: Path, way: tuple[Modality, Modality], side: Side, gap_s: float, rng: np.random.Generator
) -> None:
    for number, (way_m, angle_deg) in enumerate(((0.0, 0.0), (0.03, 10.0), (0.1, 40.0))):
        errors = [NO_ERROR, random_error(rng, way_m, angle_deg)]
        found = farthest(tmp_path / str(number), way, side, gap_s, errors)
        print(f"\n{side} {way} after {gap_s} s: {100 * found[0]:.2f} cm, {found[1]:.1f}°")
        assert found[0] < MOST_M
        assert found[1] < MOST_DEG
