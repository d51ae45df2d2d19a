"""How tall the torso of a participant is who sits upright or lies back, from the height of their headset.

The torso leans back as the real back does that it rests against. So its height, from the hips to the centre of the
head, is what the head stands above the hips over the sine of the back's angle (paper, section III, for an upright
back). The hips rest as high above the real seat or mattress as the model's above the virtual one.
"""

from math import radians, sin

import numpy as np

from avrgym.models import human
from avrgym.models.furniture.real import RealFurniture
from avrgym.models.human import PROPORTIONS, SEATED, Posture, Sex
from avrgym.texts.texts import Said, SaidError
from avrgym.vr.protocol.messages import XRPose
from avrgym.vr.protocol.webxr import Registration, head_pose


def measure_torso_height(sex: Sex, posture: Posture, head: XRPose, furniture: RealFurniture) -> float:
    """Torso height in metres from a headset at rest.

    Args:
        sex: of the model.
        posture: how the participant rests.
        head: the headset's pose above the real floor.
        furniture: what they rest on.

    Raises:
        SaidError: for a height that no adult has, naming what is allowed.
    """
    height_m = float(head_pose(Registration(np.zeros(3), 0.0), head).pos_w[2])
    hips_m = posture.hips(PROPORTIONS[sex])[2] + furniture.rise_m(posture)
    upright = sin(radians(furniture.back_deg(posture)))
    low, high = (hips_m + upright * limit for limit in human.TORSO_HEIGHT_RANGE_M)
    if not low <= height_m <= high:
        key, rests_m = (
            ("wrong_height_seated", furniture.seat_height_m)
            if posture is SEATED
            else ("wrong_height_lying", furniture.mattress_height_m)
        )
        heights = {"height_m": height_m, "low_m": low, "high_m": high}
        values = {name: f"{metres:.2f}" for name, metres in heights.items()}
        raise SaidError(Said(key, values | {"rests_cm": f"{100.0 * rests_m:.0f}"}))
    return float((height_m - hips_m) / upright)
