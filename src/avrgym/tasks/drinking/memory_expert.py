"""Giving drink patiently: an expert who remembers, for policies that remember.

People seldom hold still. Who faces the cup moves the mouth whenever the cup moves, so that a cup that goes after every
movement never comes to rest: this one goes slowly when it is near, but for making room for who leans to it. It pours
only into a mouth that rests, and stops as soon as the mouth moves. The less water is left the farther a cup has to be
tilted before it pours: up to there the tilt is quick, so that also short rests are of use. Who looks away, to others or
about, is waited for before the place where the face comes back to, unless they have looked there from the beginning.
Who turns from the side that the cup is on would turn to and fro if it followed across the face: it stays on its side,
turned about its axis so that it pours over the part of its rim that is at the lips. It comes to everybody somewhat
turned: so the hand that holds it is lower, where the arm reaches farther.
"""

from dataclasses import replace

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models.cup import RIM_RADIUS_M
from avrgym.models.human import GEOMS
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.simulation.worlds import State
from avrgym.tasks.drinking import expert
from avrgym.tasks.drinking.expert import Way
from avrgym.tasks.drinking.reward import in_cup
from avrgym.tasks.experts.feedback import (
    FASTEST_M_S,
    SPEED_PER_M,
    TURN_RAD_S,
    FeedbackPlanner,
    funnel_standoff_m,
)
from avrgym.tasks.experts.head_clearance import face_direction
from avrgym.tasks.particles import count
from avrgym.tasks.task import RunningEpisodes

SLOWEST_M_S, RETREAT_M_S = 0.02, 0.10
"""How fast a cup goes at least that comes to the lips, and that makes room for them."""
NEAR_M, LEFT_M = 0.03, 0.05
"""From how near the lips water is poured, and from how far it is poured no more."""
RESTING_M_S = 0.05
"""A mouth that is slower rests."""
POURS_RAD, PER_PARTICLE_RAD = np.radians([89.5, 0.145])
"""At what tilt the last water comes to the rim, and how much earlier it does for each particle in the cup: measured as
cups poured at 0.1 rad/s, within a degree at any filling."""
CALM_RAD = float(np.radians(4.0))
"""So far below that tilt nothing is spilled by movement."""
APPROACH_PER_S, POUR_RAD_S = 3.0, 0.03
"""How fast, of what is missing to that tilt, it is approached, and how fast a cup is tilted that pours."""
AWAY_RAD, FAR_AWAY_RAD, EXPECTED_RAD = np.radians([25.0, 33.0, 8.0])
"""From where on a face looks away; where it is awaited goes from there to the last as it turns to the second."""
TURNED_RAD = float(np.radians(8.0))
"""Who has turned the face by less since the beginning does not look away."""
ROOM_M = 0.001
"""How much too far in a cup may be before it makes room."""
WAITING_M = 0.01
"""How much farther from the face a cup waits."""
TURNED_M, MOST_TURNED_M = 0.025, 0.042
"""How far the cup's reference point is left of where it pours as a rule, and to either side at most: turned about its
axis by so much, the cup comes to mouths that arms from the right could not bring it to straight."""
BESIDE_M, MOST_ASIDE_M = 0.01, 0.04
"""How far on its side of the head's middle a cup stays, and how far beside the lips it stays for that at most."""
TURNED_SHARE = 0.7
"""What share of that is made up for by turning the cup farther."""
LOOKING_RAD = float(np.radians(8.0))
"""How far to the left faces are turned that look at such a cup."""

_RIGHT, _LEFT = (list(GEOMS).index(f"{side}_shoulder") for side in ("right", "left"))


class MemoryExpert:
    """Brings the cup to each of N mouths, waits, and pours where it may."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Begin where people and arms are."""
        self._episodes, self._planner = episodes, FeedbackPlanner(episodes)
        state = episodes.state()
        self._mouth_w, self._first_turn_rad = state.mouth_pos_w, _turn_rad(state)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Actions (N, J)."""
        planner, state = self._planner, self._episodes.state()
        planner.relax()
        rests = norm(state.mouth_pos_w - self._mouth_w) < RESTING_M_S * CONTROL_STEP_S
        self._mouth_w = state.mouth_pos_w
        turn_rad = _turn_rad(state)
        away = (np.abs(turn_rad) > AWAY_RAD) & (np.abs(turn_rad - self._first_turn_rad) >= TURNED_RAD)
        awaited = _turned(state, np.where(away, _expected_rad(turn_rad) - turn_rad, 0.0))
        return self._bring(awaited, rests, away)

    def _bring(self, state: State, rests: BoolArray, away: BoolArray) -> FloatArray:
        planner, way = self._planner, _way(np.full(len(rests), TURNED_M))
        tilt = expert.carried_tilt_rad(planner.q_w)
        at_lips_w, _ = expert.at_mouth(state, way, tilt)
        left = _to_the_left(state)
        aside_m = _aside_m(state, left, planner.pos_w, at_lips_w)
        turned_m = np.clip(TURNED_M + TURNED_SHARE * aside_m, -MOST_TURNED_M, MOST_TURNED_M)
        way = _way(turned_m)
        at_lips_w, _ = expert.at_mouth(state, way, tilt)
        aside = (TURNED_M + aside_m - turned_m)[:, None] * left
        offset = at_lips_w + aside - planner.pos_w
        pours_rad = POURS_RAD - PER_PARTICLE_RAD * count(in_cup(state))
        tilt = _next_tilt_rad(tilt, pours_rad, norm(offset), rests, away)
        goal_w, q_w = expert.at_mouth(state, way, np.minimum(tilt, expert.EMPTY_RAD))
        into = transforms.rotate(expert.yaw_q_w(state, way), expert.FORWARD)
        back_m = funnel_standoff_m(offset, into, 0.01, expert.AWAY_M) + np.where(away, WAITING_M, 0.0)
        goal_w = goal_w + aside - back_m[:, None] * into
        too_far = ((goal_w - planner.pos_w) * into).sum(axis=-1) < -ROOM_M
        slowest = np.where(too_far, RETREAT_M_S, SLOWEST_M_S)
        speed = np.clip(SPEED_PER_M * norm(offset), slowest, FASTEST_M_S)
        return planner.action_toward(goal_w, q_w, speed, TURN_RAD_S)


def _way(left_m: FloatArray) -> Way:
    """How cups come that pour over the part of their rim which puts them so far (N,) left of the lips."""
    return Way(np.zeros_like(left_m), -elementary.arcsin(left_m / RIM_RADIUS_M))


def _next_tilt_rad(
    tilt: FloatArray, pours_rad: FloatArray, distance_m: FloatArray, rests: BoolArray, away: BoolArray
) -> FloatArray:
    """The tilt (N,) that is aimed at, of cups with a tilt, with one at which they pour, and so far from the lips."""
    calm_rad = pours_rad - CALM_RAD
    pours = (distance_m < NEAR_M) & ~away & (rests | (tilt < calm_rad))
    on = tilt + CONTROL_STEP_S * np.clip(APPROACH_PER_S * (pours_rad - tilt), POUR_RAD_S, TURN_RAD_S)
    ready = np.minimum(tilt + CONTROL_STEP_S * TURN_RAD_S, expert.FULL_RAD)
    stops = (tilt > calm_rad) & (away | ~rests | (distance_m > LEFT_M))
    waits = np.where(tilt < expert.FULL_RAD, ready, np.where(stops, expert.FULL_RAD, tilt))
    return np.where(pours, on, np.where(distance_m > expert.AWAY_M, expert.TIPPED_RAD, waits))


def _to_the_left(state: State) -> FloatArray:
    """The direction (N, 3) from the right shoulder to the left."""
    shoulders_w = state.person_segment_w[:, [_RIGHT, _LEFT]].mean(axis=2)
    return transforms.normalize(shoulders_w[:, 1] - shoulders_w[:, 0])


def _turn_rad(state: State) -> FloatArray:
    """How far (N,) faces are turned to the left of where those are turned that look at the cup."""
    into, left = face_direction(state), _to_the_left(state)
    turn_rad = elementary.arctan2(
        -(into * left).sum(axis=-1), (into * transforms.cross(expert.UP, left)).sum(axis=-1)
    )
    return turn_rad - LOOKING_RAD


def _expected_rad(turn_rad: FloatArray) -> FloatArray:
    """Where faces (N,) that look away are awaited."""
    share = (np.abs(turn_rad) - AWAY_RAD) / (FAR_AWAY_RAD - AWAY_RAD)
    return np.sign(turn_rad) * np.maximum(AWAY_RAD - share * (AWAY_RAD - EXPECTED_RAD), EXPECTED_RAD)


def _turned(state: State, angle_rad: FloatArray) -> State:
    """The state with heads turned about the vertical by angles (N,)."""
    turn = transforms.from_axis_angle(expert.UP, angle_rad)
    mouth_w = state.head_pos_w + transforms.rotate(turn, state.mouth_pos_w - state.head_pos_w)
    return replace(state, mouth_pos_w=mouth_w, head_q_w=transforms.multiply(turn, state.head_q_w))


def _aside_m(state: State, left: FloatArray, tool_w: FloatArray, at_lips_w: FloatArray) -> FloatArray:
    """How far (N,) left of the lips cups go to stay on their side of the head's middle, where that is not too far.

    What is more than ``MOST_ASIDE_M`` is too far: the farther, the less is kept, and nothing from half as far again on.
    """
    tool_m, lips_m = (((pos_w - state.head_pos_w) * left).sum(axis=-1) for pos_w in (tool_w, at_lips_w))
    side = np.where(tool_m > 0.0, 1.0, -1.0)
    missing_m = np.maximum(BESIDE_M - side * lips_m, 0.0)
    return side * np.maximum(np.minimum(missing_m, 3.0 * MOST_ASIDE_M - 2.0 * missing_m), 0.0)
