"""The simulated person: a man and a woman, scaled by torso height, static or moving.

The model frame is the world's: x to the person's left, y to the back, z up. One layout function computes body and geom
frames of any number of people. The compiled model of one person and the model fields of all worlds use this function.
"""

from avrgym.models.body_names import SEXES, Sex
from avrgym.models.human.anthropometry import MAN, PROPORTIONS, TORSO_HEIGHT_RANGE_M, WOMAN
from avrgym.models.human.frames import (
    BODIES,
    BODY_FROM_DEVICE_AXES,
    CRANIUM_RADIUS,
    GEOMS,
    HEADSET_OFFSET_M,
    MOUTH_RISE,
    RECLINED,
    RIGHT_ARM,
    SEATED,
    SITE_BODY,
    Posture,
    bind_frames,
    body_frames,
    body_rotation,
    body_rotations,
    layout,
    layout_of,
    mass_shares,
)
from avrgym.models.human.joints import (
    JOINT_INDEX,
    JOINTS,
    LOWER_RAD,
    SEATED_RAD,
    TORQUE_N_M,
    UPPER_RAD,
    Y_AXIS,
    Z_AXIS,
    joint_angles,
)
from avrgym.models.human.model import PREFIX, add_person, person_model, use_speed_targets
from avrgym.models.human.person import SKIN_TONES, People, Person, as_person

__all__ = [
    "BODIES",
    "BODY_FROM_DEVICE_AXES",
    "CRANIUM_RADIUS",
    "GEOMS",
    "HEADSET_OFFSET_M",
    "JOINTS",
    "JOINT_INDEX",
    "LOWER_RAD",
    "MAN",
    "MOUTH_RISE",
    "PREFIX",
    "PROPORTIONS",
    "RECLINED",
    "RIGHT_ARM",
    "SEATED",
    "SEATED_RAD",
    "SEXES",
    "SITE_BODY",
    "SKIN_TONES",
    "TORQUE_N_M",
    "TORSO_HEIGHT_RANGE_M",
    "UPPER_RAD",
    "WOMAN",
    "Y_AXIS",
    "Z_AXIS",
    "People",
    "Person",
    "Posture",
    "Sex",
    "add_person",
    "as_person",
    "bind_frames",
    "body_frames",
    "body_rotation",
    "body_rotations",
    "joint_angles",
    "layout",
    "layout_of",
    "mass_shares",
    "person_model",
    "use_speed_targets",
]
