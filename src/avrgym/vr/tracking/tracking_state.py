"""Tracking from entering VR until leaving it: frames, pose of the participant's floor, and target pose of the body."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.body_names import PERSON_ARM_SIDES, TRACKED_BODY_PARTS, Side, TrackedBodyPart
from avrgym.models.furniture.real_furniture import DEFAULT_FURNITURE, RealFurniture
from avrgym.models.human import SEATED_POSTURE, Person, Posture
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S, XRPose
from avrgym.vr.protocol.webxr import Registration, compute_head_pose, compute_registration
from avrgym.vr.tracking.body import BodyPose, compute_resting_head_centre
from avrgym.vr.tracking.hand_device_switches import HandDevices
from avrgym.vr.tracking.jumps import PoseFilters
from avrgym.vr.tracking.sliding import HEAD_SAMPLE_INTERVAL_TICKS, SeatMotion, SlidingMonitor
from avrgym.vr.tracking.tracking_frames import ReceivedFrame, TrackingFeed, compute_body_pose


@dataclass(frozen=True)
class TrackingUpdate:
    """Tracking in one tick: frames that arrived, the newest frame, and changes.

    ``arrived_frames``: the frames that arrived since the previous tick. ``newest_frame``: the newest usable frame;
    ``None`` before the first frame, and while this frame is stale. ``is_stale``: whether the newest frame is stale.
    ``deviating_parts``: parts of the body that are not at their tracked poses after a jump. ``untracked_parts``: all
    parts with stale poses. ``untracked_needed_parts``: the parts among them that the task needs.
    ``previous_deviating_parts`` and ``previous_untracked_needed_parts``: the values of the previous tick.
    ``target_pose``: the target pose of the body; ``None`` if the body does not follow.
    """

    arrived_frames: Sequence[ReceivedFrame]
    newest_frame: ReceivedFrame | None = None
    is_stale: bool = False
    deviating_parts: tuple[TrackedBodyPart, ...] = ()
    previous_deviating_parts: tuple[TrackedBodyPart, ...] = ()
    untracked_parts: tuple[TrackedBodyPart, ...] = ()
    untracked_needed_parts: tuple[TrackedBodyPart, ...] = ()
    previous_untracked_needed_parts: tuple[TrackedBodyPart, ...] = ()
    target_pose: BodyPose | None = None


class TrackingState:
    """The tracking of a participant, from entering VR until leaving it.

    ``registration``: the pose of the participant's floor in the world, if known. ``untracked_parts``: parts of the body
    with stale poses in the latest tick. ``untracked_needed_parts``: the parts among them that the task needs.
    """

    def __init__(self) -> None:
        self.registration: Registration | None = None
        self._followed: ReceivedFrame | None = None
        self._tracked: messages.TrackingFrameMessage | None = None
        self._hands, self._limbs = HandDevices(), PoseFilters()
        self.untracked_parts: tuple[TrackedBodyPart, ...] = ()
        self.untracked_needed_parts: tuple[TrackedBodyPart, ...] = ()
        self._feed = TrackingFeed()
        self._pose: BodyPose | None = None
        self._resting: XRPose | None = None
        self._ignored: frozenset[Side] = frozenset()
        self._posture, self._forward_m = SEATED_POSTURE, 0.0
        self._sliding: SlidingMonitor | None = None
        self._ticks = 0
        self._glide: SeatMotion | None = None

    def add_frame(self, tracking: messages.TrackingFrameMessage, now_s: float) -> ReceivedFrame:
        """Add a frame that arrives now. Returns the frame with its times, and whether it is usable."""
        return self._feed.add(tracking, now_s)

    def pop_arrived_frames(self) -> list[ReceivedFrame]:
        """Returns the frames that arrived since the last call, and clears them."""
        return self._feed.pop_arrived_frames()

    def compute_newest_frame_age_s(self, now_s: float) -> float | None:
        """Returns the age of the newest usable frame in seconds; ``None`` before the first usable frame."""
        newest = self._feed.newest_frame
        return None if newest is None else now_s - newest.received_s

    def compute_part_pose_age_s(self, part: TrackedBodyPart, now_s: float) -> float:
        """Returns the time in seconds since a part's latest measurement; infinite without a measurement."""
        return self._feed.measurement_times.compute_pose_age_s(part, now_s)

    @property
    def applied_sequence_number(self) -> int:
        """The sequence number of the newest tracking frame that moved the body; −1 before the first."""
        return -1 if self._followed is None else self._followed.tracking.sequence

    @property
    def deviating_parts(self) -> tuple[TrackedBodyPart, ...]:
        """The parts of the body that are not at their tracked poses."""
        if self._followed is None or self.registration is None:
            return TRACKED_BODY_PARTS
        deviating = {*self._limbs.deviating_parts, *self.untracked_parts, *self._ignored}
        return tuple(part for part in TRACKED_BODY_PARTS if part in deviating)

    @property
    def hand_modalities(self) -> tuple[messages.Modality, messages.Modality]:
        """The tracking devices of left and right hand in the newest usable frame."""
        newest = self._feed.newest_frame
        return (
            ("none", "none")
            if newest is None
            else (newest.tracking.left_modality, newest.tracking.right_modality)
        )

    def determine_registration(
        self, head: XRPose, person: Person, posture: Posture, furniture: RealFurniture = DEFAULT_FURNITURE
    ) -> None:
        """Determine the registration from the headset's pose of a participant who rests on the seat or bed.

        If the real ``furniture`` has a headrest, the head is in front of its usual place on the virtual seat.
        """
        self._resting, self._posture = head, posture
        self._forward_m = furniture.compute_head_forward_offset_m(posture)
        self.update_location(person)

    def update_location(self, person: Person) -> None:
        """Adapt the registration to a person with another torso height. The seat does not move in the real room."""
        if self._resting is not None:
            centre_w = compute_resting_head_centre(person, self._posture) - [0.0, self._forward_m, 0.0]
            self.registration = compute_registration(self._resting, centre_w)
            self._sliding = SlidingMonitor(person, self._posture)
            self._pose = self._glide = None

    def reset_location(self) -> None:
        """Delete the participant's position and direction. The next usable frame determines them."""
        self.registration = self._pose = self._resting = self._sliding = self._glide = None

    def find_steady_headset_pose(self, now_s: float) -> XRPose:
        """Returns the headset's pose at rest; see ``TrackingFeed.find_steady_headset_pose``."""
        return self._feed.find_steady_headset_pose(now_s)

    def find_controller_position(self, now_s: float) -> tuple[float, float, float] | None:
        """Returns the position of a tracked controller in metres in ``local-floor``; ``None`` if no controller is
        tracked.

        If both controllers are tracked, the right controller is used.
        """
        newest = self._feed.newest_frame
        if newest is None or self._feed.is_stale(now_s):
            return None
        frame = newest.tracking
        hands = ((frame.right, frame.right_modality), (frame.left, frame.left_modality))
        return next((pose.position for pose, held in hands if pose and held == "controller"), None)

    def update(
        self, needed: Collection[TrackedBodyPart], now_s: float, profile: InputProfile = DEFAULT_INPUT_PROFILE
    ) -> TrackingUpdate:
        """Returns the tracking of this tick, with the body's target pose if the newest frame is fresh.

        ``needed``: parts of the body that the task needs. The pose omits the hands of resting and absent arms. It also
        omits stale hands of arms that the input ``profile`` does not use.
        """
        newest, silent = self._feed.newest_frame, self._feed.is_stale(now_s)
        arrived, deviating_parts_before, lost_before = (
            self._feed.pop_arrived_frames(),
            self._limbs.deviating_parts,
            self.untracked_needed_parts,
        )
        self.untracked_parts = self._feed.measurement_times.find_stale_parts(now_s)
        self.untracked_needed_parts = tuple(part for part in self.untracked_parts if part in needed)
        self._ignore(profile)
        if newest is not None and not silent and self.registration is not None:
            pose = self._pose_from(self.registration, newest, now_s)
        else:
            pose = None
        return TrackingUpdate(
            arrived,
            None if silent else newest,
            silent,
            self._limbs.deviating_parts,
            deviating_parts_before,
            self.untracked_parts,
            self.untracked_needed_parts,
            lost_before,
            pose,
        )

    # Sliding on the seat -------------------------------------------------------------------------------------------

    @property
    def world_motion(self) -> messages.WorldMotion | None:
        """Target pose and remaining time of the world's motion in the participant's room.

        ``None`` while the world does not move.
        """
        if self._glide is None or self.registration is None:
            return None
        there = replace(self.registration, origin_w=self.registration.origin_w + self._glide.shift_w)
        return messages.WorldMotion(there.xr_from_world(), self._glide.duration_s)

    def move_seat(self, joint_angles_rad: FloatArray) -> SeatMotion | None:
        """After a participant has slid, move the seat by the distance for one tick. Call it once per tick, after
        ``update``.

        ``joint_angles_rad`` (20,) are the body's targets. Returns the motion in the tick in which it starts.
        """
        if self._glide is not None:
            self._go_on(self._glide)
            return None
        self._ticks += 1
        if (
            self._ticks % HEAD_SAMPLE_INTERVAL_TICKS
            or self._sliding is None
            or self._followed is None
            or self._resting is None
        ):
            return None
        if "head" in self.deviating_parts:
            self._sliding.reset()
            return None
        assert self.registration is not None
        assert self._followed.tracking.head is not None
        head = compute_head_pose(self.registration, self._followed.tracking.head)
        self._glide = self._sliding.update(head, joint_angles_rad)
        return self._glide

    def _go_on(self, glide: SeatMotion) -> None:
        """Move the participant's floor by the distance for one tick, and reduce the remaining shift."""
        assert self.registration is not None
        assert self._resting is not None
        share = min(TICK_S / glide.duration_s, 1.0)
        step_w = share * glide.shift_w
        step_xr = transforms.rotate(transforms.conjugate(self.registration.q_w), -step_w)
        x, y, z = (np.array(self._resting.position) + step_xr).tolist()
        self._resting = XRPose((x, y, z), self._resting.orientation)
        self.registration = replace(self.registration, origin_w=self.registration.origin_w + step_w)
        self._pose = None
        left_s = glide.duration_s - TICK_S
        self._glide = SeatMotion(glide.shift_w - step_w, left_s) if share < 1.0 else None

    def _pose_from(self, registration: Registration, newest: ReceivedFrame, now_s: float) -> BodyPose:
        """Returns the target pose of the body. Without a new frame, deviating parts continue to their tracked poses."""
        if newest is not self._followed:
            self._followed = newest
            self._tracked = self._hands.correct_frame(newest.tracking, newest.captured_s)
            self._limbs.update(self._tracked, newest.captured_s, now_s)
            self._pose = None
        if self._pose is None or self._limbs.deviating_parts:
            assert self._tracked is not None
            tracked = self._limbs.compute_filtered_frame(self._tracked, now_s)
            if self._ignored:
                tracked = msgspec.structs.replace(tracked, **dict.fromkeys(self._ignored))
            self._pose = compute_body_pose(registration, tracked)
        return self._pose

    def _ignore(self, profile: InputProfile) -> None:
        """Store the arms with ignored tracking. ``profile`` does not use them, and they rest, are absent or
        untracked."""
        never: set[Side] = {*profile.resting_arms, *profile.absent_arms}
        unused = frozenset(PERSON_ARM_SIDES).difference(profile.tracked_arms)
        ignored = unused.intersection(never.union(self.untracked_parts))
        if ignored != self._ignored:
            self._ignored, self._pose = ignored, None
