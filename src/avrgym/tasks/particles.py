"""Events of particles: food on a spoon, water in a cup."""

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import capsules
from avrgym.geometry.arrays import find_indices_to_compute, get_namespace
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State

TOUCH_MARGIN_M = 0.002
FLOOR_HEIGHT_M = 0.03
"""Height in metres below which particles have reached the floor."""


def find_particles_on_person(state: State, radius_m: float, candidates: BoolArray) -> BoolArray:
    """Returns the mask (N, K) of those ``candidates`` (N, K) that touch the person.

    A particle touches the person within 2 mm of a capsule's surface. The distance is not computed for particles that
    are nearer to the tool than the person is.
    """
    margin = radius_m + TOUCH_MARGIN_M
    reach = norm(state.particle_pos_w - state.tool_pos_w[:, None]) + margin
    xp = get_namespace(reach)
    near = candidates & (reach > xp.min(_gaps(state, state.tool_pos_w), axis=-1)[:, None])
    world, particle = find_indices_to_compute(near)
    gaps = _gaps(state, state.particle_pos_w[world, particle], world)
    touching = xp.zeros_like(candidates)
    touching[world, particle] = (gaps < margin).any(axis=-1)
    return touching & near


def _gaps(state: State, point_w: FloatArray, world: IntArray | slice = slice(None)) -> FloatArray:
    """Returns the distances (n, G) in metres of points (n, 3) from the person's capsules in the worlds ``world``."""
    segment_w = state.person_capsule_ends_w[world]
    distance = capsules.point_segment_distance(point_w[:, None], segment_w[:, :, 0], segment_w[:, :, 1])
    return distance - state.person_radius_m[world]


def count_events(events: BoolArray) -> FloatArray:
    """Returns the number (N,) of particles with an event (N, K)."""
    return 1.0 * events.sum(axis=-1)


def check_particle_count(state: State, events: BoolArray) -> None:
    """Check that the task state and the tool have the same number of particles.

    Raises:
        ValueError: if the numbers differ. The message contains both.
    """
    carried = state.particle_pos_w.shape[1]
    if events.shape[1] != carried:
        raise ValueError(
            f"the tool carries {carried} particles, but the task state has {events.shape[1]}; "
            f"set init_state=partial(init_state, particles={carried}) in the task"
        )
