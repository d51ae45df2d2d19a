"""Messages for clients: the description of the scene, and the poses of its bodies."""

import numpy as np

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.safety.limits import BODY_REGIONS, QUASI_STATIC_LIMIT_N
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.episodes import Episodes
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.tracking.body import make_skeleton


def find_most_loaded_region(simulation: Simulation) -> tuple[str, float]:
    """Returns the name of the body region with the highest ratio of force to allowed force, and this ratio.

    Only the person in the first world is considered. Without contact, returns ``""`` and 0.
    """
    share = simulation.compute_region_force_n()[0] / QUASI_STATIC_LIMIT_N
    most = int(share.argmax())
    return (BODY_REGIONS[most].name if share[most] else ""), float(share[most])


def make_scene_message(number: int, episodes: Episodes, registration: Registration) -> messages.Scene:
    """Returns the description of the first world's scene, see ``messages.Scene``. ``number`` is the index of the
    scene."""
    marks = episodes.task.markers
    people = episodes.people
    head_centre = human.compute_body_layout(people.is_woman, people.torso_height_m).site_pos["head_centre"][0]
    return messages.Scene(
        url=make_scene_url(number),
        bodies=list(episodes.simulation.bodies),
        head_bodies=[human.PERSON_NAME_PREFIX + "head"],
        marks=marks.num_markers if marks else 0,
        mark_radius_m=marks.radius_m if marks else 0.0,
        mark_rgb=marks.rgb if marks else (0.0, 0.0, 0.0),
        eyes=(float(head_centre[0]), float(head_centre[1]) - human.HEADSET_OFFSET_M, float(head_centre[2])),
        skeleton=make_skeleton(people.get_person(0), episodes.scene.posture),
        xr_from_world=registration.xr_from_world(),
    )


def make_scene_url(number: int) -> str:
    """Returns the path of a scene's GLB file on the server."""
    return f"/scenes/{number}.glb"


def encode_world_poses(episodes: Episodes) -> bytes:
    """Returns the poses of bodies and marks in the first world, encoded as in ``messages.WorldState``."""
    bodies, marks_w = episodes.simulation.get_body_poses(0), episodes.compute_marker_positions_w()[0]
    all_poses = np.empty((len(bodies) + len(marks_w), 7), "<f4")
    all_poses[: len(bodies)] = bodies
    all_poses[len(bodies) :, :3], all_poses[len(bodies) :, 3:] = marks_w, transforms.IDENTITY_QUATERNION
    return all_poses.tobytes()
