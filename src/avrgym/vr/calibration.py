"""How tall the torso of a participant is who sits upright or lies back, from the height of their headset.

The torso leans back from the vertical as the posture says: not in the wheelchair, by 30° on the bed's backrest. So
its height, from the hips to the centre of the head, is what the head stands above the hips over the cosine of
that (paper, section III, for the wheelchair). The hips rest as high above the real seat or mattress as the model's
above the virtual one. A headset says nothing about the real backrest: where its angle is another one, the
experimenter enters the torso height.
"""

from dataclasses import dataclass
from math import cos, radians

import numpy as np

from avrgym.models import human
from avrgym.models.furniture.bed import MATTRESS_TOP_M
from avrgym.models.furniture.wheelchair import SEAT_HEIGHT_M
from avrgym.models.human import PROPORTIONS, SEATED, Posture, Sex
from avrgym.vr.messages import XRPose
from avrgym.vr.webxr import Registration, head_pose

SEAT_HEIGHT_RANGE_M = (0.30, 0.70)
MATTRESS_HEIGHT_RANGE_M = (0.05, 1.00)


@dataclass(frozen=True)
class RealFurniture:
    """What participants really sit and lie on: heights above the floor, the virtual ones unless given.

    Raises:
        ValueError: for heights that no such furniture has.
    """

    seat_height_m: float = SEAT_HEIGHT_M
    mattress_height_m: float = MATTRESS_TOP_M

    def __post_init__(self) -> None:
        _check("seat", self.seat_height_m, SEAT_HEIGHT_RANGE_M)
        _check("mattress", self.mattress_height_m, MATTRESS_HEIGHT_RANGE_M)

    def rise_m(self, posture: Posture) -> float:
        """How much higher the real seat or mattress is than the virtual one."""
        if posture is SEATED:
            return self.seat_height_m - SEAT_HEIGHT_M
        return self.mattress_height_m - MATTRESS_TOP_M


def _check(name: str, height_m: float, allowed: tuple[float, float]) -> None:
    if not allowed[0] <= height_m <= allowed[1]:
        raise ValueError(
            f"the {name} is {height_m:.2f} m high; allowed are {allowed[0]:.2f} to {allowed[1]:.2f} m"
        )


def measure_torso_height(sex: Sex, posture: Posture, head: XRPose, furniture: RealFurniture) -> float:
    """Torso height in metres from a headset at rest.

    Args:
        sex: of the model.
        posture: how the participant rests.
        head: the headset's pose above the real floor.
        furniture: what they rest on.

    Raises:
        ValueError: for a height that no adult has, naming what is allowed.
    """
    height_m = float(head_pose(Registration(np.zeros(3), 0.0), head).pos_w[2])
    hips_m = posture.hips(PROPORTIONS[sex])[2] + furniture.rise_m(posture)
    upright = cos(radians(posture.hips_deg))
    low, high = (hips_m + upright * limit for limit in human.TORSO_HEIGHT_RANGE_M)
    if not low <= height_m <= high:
        who, how = (
            ("a seated person", "sit upright") if posture is SEATED else ("a person in the bed", "lie back")
        )
        raise ValueError(
            f"the headset is {height_m:.2f} m above the floor; of {who} it must be {low:.2f} to {high:.2f} m: "
            f"{how}, and check the floor height of the headset"
        )
    return float((height_m - hips_m) / upright)
