"""Simulated participants: they emit the tracking frames that a headset would, and answer the questionnaire.

They serve dry runs, demonstrations and tests. Whatever they leave behind is marked as simulated.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.models import human
from avrgym.models.human import Person, Sex
from avrgym.vr.messages import Tracking, XRPose
from avrgym.vr.webxr import Pose, Registration, grip_from_hand, headset_from_head

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Traits:
    """How a simulated participant is built and behaves.

    ``sway_m`` and ``sway_hz`` describe the slow movement of the head; ``lean_deg`` how far they bend forward at
    rest; ``agreement`` (0 to 1) how far their answers follow what they saw; the rest of an answer is chance.
    """

    sex: Sex
    torso_height_m: float
    sway_deg: float
    sway_hz: float
    lean_deg: float
    arm_deg: float
    agreement: float


def draw_traits(sex: Sex, seed: int) -> Traits:
    """Traits of a participant of the paper's range of torso heights, 0.51 to 0.58 m."""
    random = np.random.default_rng(seed)
    return Traits(
        sex=sex,
        torso_height_m=float(random.uniform(0.51, 0.58)),
        sway_deg=float(random.uniform(0.3, 1.0)),
        sway_hz=float(random.uniform(0.1, 0.3)),
        lean_deg=float(random.uniform(-2.0, 5.0)),
        arm_deg=float(random.uniform(-8.0, 8.0)),
        agreement=0.8,
    )


class SimulatedParticipant:
    """A seated participant in a room of their own, whose origin and direction differ from the simulation's."""

    def __init__(self, traits: Traits, seed: int) -> None:
        random = np.random.default_rng([seed, 1])
        self.traits = traits
        self._random = random
        self._room = Registration(
            np.array([*random.uniform(-0.3, 0.3, 2), 0.0]), float(random.uniform(-np.pi, np.pi))
        )
        self._phase = random.uniform(0.0, 2.0 * np.pi, 3)
        self._sequence = -1
        self._model = human.person_model(Person(traits.sex, traits.torso_height_m), moving=True)
        self._data = mujoco.MjData(self._model)

    def frame(self, time_s: float, *, moving: bool) -> Tracking:
        """The tracking frame at a time: upright and still, or swaying a little when ``moving``."""
        return self.frame_of(self._joint_angles(time_s, moving), time_s)

    def frame_of(self, joint_angles_rad: Array, time_s: float) -> Tracking:
        """The tracking frame of a pose, joint angles (20,)."""
        self._data.qpos[:] = joint_angles_rad
        mujoco.mj_kinematics(self._model, self._data)
        self._sequence += 1
        return Tracking(
            sequence=self._sequence,
            client_time_ms=1000.0 * time_s,
            head=headset_from_head(self._room, self._pose("head_centre", "head")),
            left=self._grip("left"),
            right=self._grip("right"),
            modality="controllers",
        )

    def answer(self, success: bool, points: int) -> int:
        """A rating: high after a success and low after a failure, with some chance."""
        agreed = (points - 1 if success else 2) + self._random.integers(-1, 2)
        chance = self._random.integers(1, points + 1)
        follows = self._random.random() < self.traits.agreement
        return int(np.clip(agreed, 1, points)) if follows else int(chance)

    def _joint_angles(self, time_s: float, moving: bool) -> Array:
        if not moving:
            return human.SEATED_RAD
        traits = self.traits
        wave = traits.sway_deg * np.sin(
            2.0 * np.pi * traits.sway_hz * time_s * np.array([1.0, 0.7, 0.5]) + self._phase
        )
        lean = traits.lean_deg * min(1.0, time_s / 2.0)
        return human.joint_angles(
            waist_x=lean + wave[0],
            waist_y=0.5 * wave[1],
            head_x=-lean,
            head_z=2.0 * wave[2],
            right_shoulder_x=-10.0 + traits.arm_deg + wave[1],
            left_shoulder_x=-10.0 + traits.arm_deg - wave[1],
        )

    def _grip(self, side: str) -> XRPose:
        return grip_from_hand(self._room, self._pose(f"{side}_hand_centre", f"{side}_hand"))

    def _pose(self, site: str, body: str) -> Pose:
        return Pose(
            self._data.site(human.PREFIX + site).xpos.copy(),
            transforms.normalize(self._data.body(human.PREFIX + body).xquat),
        )
