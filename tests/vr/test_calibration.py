"""Laws of calibration: torso height from a headset, and registration of seat and head."""

from typing import Any

import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models.furniture.real_furniture import (
    FURNITURE_MEASURE_RANGES,
    HIPS_TO_BACKREST_DISTANCE_M,
    FurniturePoint,
    RealFurniture,
    change_furniture,
    measure_furniture,
)
from avrgym.models.human import BODY_DIMENSIONS, RECLINED_POSTURE, SEATED_POSTURE, SEXES, Person, Posture, Sex
from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose
from avrgym.vr.protocol.webxr import (
    Pose,
    Registration,
    compute_head_pose,
    compute_registration,
    convert_head_to_headset,
)
from avrgym.vr.tracking.body import (
    BodyPose,
    BodySolver,
    compute_hips_frame,
    compute_resting_head_centre,
    solve_torso_angles,
)
from avrgym.vr.tracking.calibration import measure_torso_height
from avrgym.vr.tracking.tracking_frames import TrackingFeed
from avrgym.vr.tracking.tracking_state import TrackingState

POSTURES = (SEATED_POSTURE, RECLINED_POSTURE)
ROOM = Registration(np.array([0.4, -0.2, 0.0]), 2.0)
VIRTUAL = RealFurniture()


def headset(person: Person, posture: Posture, height_offset_m: float = 0.0) -> XRPose:
    """The headset of somebody who rests on furniture higher than ours by ``height_offset_m``, in a room of their
    own."""
    _, axes_w = compute_hips_frame(person, posture)
    centre_w = compute_resting_head_centre(person, posture) + np.array([0.0, 0.0, height_offset_m])
    return convert_head_to_headset(ROOM, Pose(centre_w, transforms.from_matrix(axes_w)))


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("height_offset_m", [-0.1, 0.0, 0.07])
def test_the_measure_is_the_torso_height_whatever_they_rest_on(
    sex: Sex, posture: Posture, height_offset_m: float
) -> None:
    real = RealFurniture(
        seat_height_m=VIRTUAL.seat_height_m + height_offset_m,
        mattress_height_m=VIRTUAL.mattress_height_m + height_offset_m,
    )
    for height_m in (0.45, 0.54, 0.70):
        head = headset(Person(sex, height_m), posture, height_offset_m)
        assert measure_torso_height(sex, posture, head, real) == pytest.approx(height_m)


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize(
    ("tilt_deg", "headrest_m", "back_deg"), [(0, 0, 70), (15, 0.05, 75), (30, 0.1, 60), (-5, 0, 90)]
)
def test_tilt_and_headrest_do_not_change_the_torso_height(
    posture: Posture, tilt_deg: float, headrest_m: float, back_deg: float
) -> None:
    """The head's height in a real wheelchair is computed from its parts: seat, tilt, backrest and headrest."""
    real = RealFurniture(
        seat_back_deg=back_deg, mattress_back_deg=back_deg, seat_tilt_deg=tilt_deg, headrest_m=headrest_m
    )
    back, tilt = np.radians(back_deg), np.radians(tilt_deg)
    for height_m in (0.48, 0.57):
        hips_m = posture.compute_hips_origin(BODY_DIMENSIONS["woman"])[2]
        hips_m += (
            (HIPS_TO_BACKREST_DISTANCE_M - real.seat_depth_m) * np.sin(tilt)
            if posture.is_seated
            else -posture.height_offset_m
        )
        along = np.array([-np.cos(back), np.sin(back)])
        forward = np.array([along[1], -along[0]])
        centre_m = hips_m + (height_m * along + headrest_m * forward)[1]
        head = headset(Person("woman", height_m), posture, 0.0)
        raised_m = centre_m - float(compute_head_pose(Registration(np.zeros(3), 0.0), head).pos_w[2])
        head = headset(Person("woman", height_m), posture, raised_m)
        assert measure_torso_height("woman", posture, head, real) == pytest.approx(height_m)


def test_a_headrest_puts_the_seat_behind_the_head() -> None:
    """The virtual seat stays at the real one: the resting head is in front of its usual place, also after a change of
    the body."""
    person, tracking = Person("woman", 0.56), TrackingState()
    for real in (VIRTUAL, RealFurniture(headrest_m=0.08, seat_back_deg=80.0)):
        tracking.determine_registration(headset(person, SEATED_POSTURE), person, SEATED_POSTURE, real)
        for body in (person, Person("woman", 0.5)):
            tracking.update_location(body)
            assert tracking.registration is not None
            head_w = compute_head_pose(tracking.registration, headset(person, SEATED_POSTURE)).pos_w
            forward_m = real.headrest_m * np.sin(np.radians(80.0))
            expected = compute_resting_head_centre(body, SEATED_POSTURE) - [0.0, forward_m, 0.0]
            np.testing.assert_allclose(head_w, expected, atol=1e-9)


@pytest.mark.parametrize("seated", [True, False])
def test_points_measure_seat_and_mattress(seated: bool) -> None:
    """Points that are computed from a wheelchair in any direction give its measures back."""
    real = RealFurniture(
        seat_height_m=0.52, seat_depth_m=0.45, seat_tilt_deg=12.0, seat_back_deg=72.0,
        mattress_height_m=0.61, mattress_back_deg=35.0,
    )  # fmt: skip
    for turn in (0.3, 2.5):
        backward = np.array([np.cos(turn), 0.0, np.sin(turn)])
        tilt, back = np.radians(real.seat_tilt_deg), np.radians(real.seat_back_deg if seated else 35.0)
        front = np.array([0.4, 0.52 if seated else 0.61, -0.2])
        rear = front + 0.45 * (np.cos(tilt) * backward - [0.0, np.sin(tilt) if seated else 0.0, 0.0])
        top = rear + 0.6 * (np.cos(back) * backward + [0.0, np.sin(back), 0.0])
        points: dict[FurniturePoint, Any] = {"front": front, "rear": rear, "top": top}
        forward = [0.0, np.cos(back), 0.0] - np.sin(back) * backward
        for headrest_m in (0.06, -0.02, None):
            if headrest_m is None:
                del points["headrest"]
            else:
                points["headrest"] = top + 0.1 * (top - rear) + headrest_m * forward
            with_headrest = measure_furniture(VIRTUAL, points, seated=seated).headrest_m
            assert with_headrest == pytest.approx(max(headrest_m or 0.0, 0.0))
        measured = measure_furniture(VIRTUAL, points, seated=seated)
        expected = change_furniture(
            VIRTUAL,
            **{
                name: getattr(real, name)
                for name in FURNITURE_MEASURE_RANGES
                if name.startswith("seat") is seated
            },
        )
        for name in FURNITURE_MEASURE_RANGES:
            wanted = getattr(VIRTUAL if name == "headrest_m" else expected, name)
            assert getattr(measured, name) == pytest.approx(wanted), name


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("height_offset_m", [-0.1, 0.0, 0.07])
def test_registering_somebody_at_rest_gives_no_angles(posture: Posture, height_offset_m: float) -> None:
    person = Person("man", 0.57)
    head = headset(person, posture, height_offset_m)
    registration = compute_registration(head, compute_resting_head_centre(person, posture))
    np.testing.assert_allclose(
        solve_torso_angles(person, compute_head_pose(registration, head), posture), 0.0, atol=1e-6
    )
    assert registration.origin_w[2] == pytest.approx(-height_offset_m)


@pytest.mark.parametrize("posture", POSTURES)
def test_a_torso_height_that_was_entered_fits_the_same_headset(posture: Posture) -> None:
    """The experimenter corrects the measure: the person changes, the head stays where it is."""
    measured, corrected = Person("woman", 0.57), Person("woman", 0.53)
    head = headset(measured, posture)
    pose = compute_head_pose(
        compute_registration(head, compute_resting_head_centre(corrected, posture)), head
    )
    angles = BodySolver(corrected, posture).solve(BodyPose(pose, None, None), corrected.joint_angles_rad)
    np.testing.assert_allclose(angles[:6], 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("posture", "words"), [(SEATED_POSTURE, "seated person"), (RECLINED_POSTURE, "person in the bed")]
)
def test_heights_that_nobody_has_are_refused(posture: Posture, words: str) -> None:
    for height_m in (0.3, 0.95, 1.5, 1.8):
        head = XRPose((0.0, height_m, 0.0), (0.0, 0.0, 0.0, 1.0))
        with pytest.raises(
            ValueError, match=rf"{height_m:.2f} m above the floor; for a {words} .* 1\.\d\d m"
        ):
            measure_torso_height("woman", posture, head, VIRTUAL)


def test_furniture_that_nobody_sits_on_is_refused() -> None:
    with pytest.raises(ValueError, match=r"seat_height_m is 1\.2; allowed: 0\.3 to 0\.7"):
        RealFurniture(seat_height_m=1.2)
    with pytest.raises(ValueError, match="mattress_height_m is nan"):
        RealFurniture(mattress_height_m=float("nan"))
    with pytest.raises(ValueError, match="seat_back_deg is 20; allowed: 45 to 100"):
        change_furniture(VIRTUAL, seat_back_deg=20.0, seat_depth_m=None)


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("backrest_deg", [50.0, 70.0, 90.0])
def test_who_leans_on_a_real_back_is_as_tall_as_before(posture: Posture, backrest_deg: float) -> None:
    real = RealFurniture(seat_height_m=0.45, seat_back_deg=backrest_deg, mattress_back_deg=backrest_deg)
    person = Person("woman", 0.57)
    head = headset(person, posture, real.compute_head_height_offset_m(posture, person.torso_height_m))
    assert measure_torso_height("woman", posture, head, real) == pytest.approx(0.57)


def feed_of(*heads: XRPose) -> TrackingFeed:
    feed = TrackingFeed()
    for i, head in enumerate(heads):
        feed.add(TrackingFrameMessage(i, 10.0 * i, head, None, None, "none", "none"), 0.01 * i)
    return feed


def test_the_headset_at_rest_is_the_one_of_median_height() -> None:
    heights = (1.20, 1.21, 1.215, 1.205, 1.22, 1.2, 1.21)
    heads = [XRPose((0.0, height, 0.0), (0.0, 0.0, 0.0, 1.0)) for height in heights]
    assert feed_of(*heads).find_steady_headset_pose(0.1).position[1] == 1.21


def test_who_looks_at_the_ceiling_faces_nowhere() -> None:
    sine, cosine = np.sin(np.radians(40.0)), np.cos(np.radians(40.0))
    up = XRPose((0.0, 1.2, 0.0), (float(sine), 0.0, 0.0, float(cosine)))
    with pytest.raises(ValueError, match="too steeply"):
        feed_of(*[up] * 6).find_steady_headset_pose(0.1)
