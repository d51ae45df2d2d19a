"""The pacing layer executes the commands of participants. The policy of the robot does not need to process commands.

The policy drives the tool until the tool is at the preferred distance from mouth or arm. The robot waits there for the
command ``ready``. The layer scales the actions of the policy, and maintains the preferred distance and side. At the
command ``wait``, the layer moves the tool back; see ``commands.vocabulary``. It moves the tool with ``Retreat``, at
``retreat.RETREAT_TOOL_SPEED_M_S`` or less.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.commands.preferences import (
    DEFAULT_PREFERENCES,
    MAX_SPEED_FACTOR,
    MAX_WAITING_DISTANCE_M,
    MIN_SPEED_FACTOR,
    MIN_WAITING_DISTANCE_M,
    SPEED_FACTOR_STEP,
    WAITING_DISTANCE_STEP_M,
    TrialRules,
)
from avrgym.commands.vocabulary import COMMAND_INDEX, COMMAND_NAMES, CommandName
from avrgym.geometry import transforms
from avrgym.geometry.capsules import point_segment_distance
from avrgym.models.human import GEOMS, LEFT_ARM_BODIES, RIGHT_ARM_BODIES
from avrgym.people.cooperation import OfferedBodyPart
from avrgym.safety.per_world_state import PerWorldState
from avrgym.safety.retreat import RETREAT_TOOL_SPEED_M_S, Retreat
from avrgym.simulation.state import State
from avrgym.simulation.worlds import Simulation

PACING_MODES = ("approaching", "waiting", "backing_off", "changing_side", "continuing", "stopped")
"""Modes of the pacing layer. The policy drives the robot in the modes ``approaching`` and ``continuing``."""
APPROACHING_MODE, WAITING_MODE, BACKING_OFF_MODE, CHANGING_SIDE_MODE, CONTINUING_MODE, STOPPED_MODE = range(
    len(PACING_MODES)
)
DISTANCE_TOLERANCE_M = 0.05
"""Tolerance of the preferred distance. If the tool of a waiting robot is closer by more than this tolerance, the robot
backs off.
"""
MIN_LATERAL_OFFSET_M = 0.08
"""Minimum lateral distance between tool and mouth or arm at which the tool is on one side."""
MAX_SIDE_CHANGE_S = 5.0
"""Maximum duration of a change of side, in case the other side is out of reach."""
MAX_FACING_ANGLE_RAD = float(np.radians(30.0))
"""Maximum angle between the head's direction and the tool at which the participant faces the tool."""
COMMAND_INPUT_ENTRIES = (*COMMAND_NAMES, "age_s", "speed_factor", "distance_m", "side", "waiting")
"""Names of the entries of the controllers' input ``command``. An entry with a command's name is 1 if this is the latest
command, otherwise 0. ``age_s`` is the time since the command, up to 60 s. ``side`` is 1 for left, −1 for right, 0 for
any. ``waiting`` is 1 while the robot waits."""
MAX_COMMAND_AGE_S = 60.0
"""Maximum value of ``age_s``, the time since the latest command."""
NO_COMMAND_INPUT = np.array(
    [0.0] * len(COMMAND_NAMES) + [MAX_COMMAND_AGE_S, 1.0, DEFAULT_PREFERENCES.distance_m, 0.0, 0.0]
)
"""Value of the controllers' input ``command`` before the first command of a participant."""
_PARTS: Mapping[OfferedBodyPart, tuple[str, ...]] = {
    "mouth": ("cranium", "jaw"),
    "arm": RIGHT_ARM_BODIES,
    "left_arm": LEFT_ARM_BODIES,
    "nothing": tuple(GEOMS),
}
_SIDES = {"any": 0.0, "left": 1.0, "right": -1.0}


class PacingLayer(PerWorldState):
    """Overrides the actions in N worlds according to the participants' commands.

    Attributes:
        mode_index: indices (N,) in ``PACING_MODES``.
        speed_factor: factors (N,) of the policy's actions.
        preferred_distance_m: preferred distances (N,) between tool and mouth or arm.
        preferred_side: preferred sides (N,): 1 left, −1 right, 0 any.
        tool_distance_m: distances (N,) between tool and mouth or arm at the start of the control step.
    """

    STATE_FIELDS = (
        "mode_index", "speed_factor", "preferred_distance_m", "preferred_side", "tool_distance_m", "_lateral_m", "_own",
        "_paused_s", "_moved_s", "_side_tried", "_latest", "_age_s",
    )  # fmt: skip

    def __init__(self, simulation: Simulation, offered: OfferedBodyPart, rules: TrialRules) -> None:
        """Create the layer for all robots of a simulation. ``offered``: the body part that the task needs."""
        self._simulation, self._offered, self.trial_rules = simulation, offered, rules
        self._geoms = np.array([list(GEOMS).index(name) for name in _PARTS[offered]])
        self._step_s = simulation.scene.control_step_s
        self._waits = "ready" in rules.commands or rules.preferences.continues_without_command
        self._retreats: dict[int, Retreat] = {}
        worlds = simulation.num_worlds
        self.mode_index = np.zeros(worlds, dtype=np.intp)
        self.speed_factor, self.preferred_distance_m, self.preferred_side = (
            np.zeros(worlds) for _ in range(3)
        )
        self.tool_distance_m, self._lateral_m = np.zeros(worlds), np.zeros(worlds)
        self._own = np.zeros((worlds, len(simulation.scene.action_names)))
        self._paused_s, self._moved_s, self._age_s = (np.zeros(worlds) for _ in range(3))
        self._side_tried = np.zeros(worlds, dtype=bool)
        self._latest = np.zeros(worlds, dtype=np.intp)
        self.reset(np.arange(worlds))

    def reset(self, ids: IntArray) -> None:
        """Start episodes in worlds ``ids`` (n,), with the participants' preferences."""
        self._clear(ids)
        wishes = self.trial_rules.preferences
        self.mode_index[ids] = (
            APPROACHING_MODE if self._waits and self.trial_rules.pacing else CONTINUING_MODE
        )
        self.speed_factor[ids], self.preferred_distance_m[ids] = wishes.speed, wishes.distance_m
        self.preferred_side[ids], self._latest[ids], self._age_s[ids] = (
            _SIDES[wishes.side],
            -1,
            MAX_COMMAND_AGE_S,
        )
        for world in ids.tolist():
            self._retreats.pop(world, None)

    def prepare_retreat(self, world: int) -> None:
        """Create the retreat controller of a world in advance. Its creation takes milliseconds."""
        self._retreats[world] = Retreat(
            self._simulation,
            world,
            mouth_distance_m=np.inf,
            person_distance_m=MAX_WAITING_DISTANCE_M,
            steps=round(float(self._moved_s[world]) / self._step_s),
            step_s=self._step_s,
        )

    def apply_command(self, command: CommandName, worlds: BoolArray) -> BoolArray:
        """Apply a command in the worlds of a mask (N,). Returns the mask of the worlds in which it has an effect."""
        before = self.mode_index, self.speed_factor, self.preferred_distance_m, self.preferred_side
        worlds = worlds & (self.mode_index != STOPPED_MODE)
        self._latest = np.where(worlds, COMMAND_INDEX[command], self._latest)
        self._age_s = np.where(worlds, 0.0, self._age_s)
        if self.trial_rules.pacing or command == "stop":
            self._react(command, worlds)
        now = self.mode_index, self.speed_factor, self.preferred_distance_m, self.preferred_side
        return np.any([old != new for old, new in zip(before, now, strict=True)], axis=0)

    def _react(self, command: CommandName, worlds: BoolArray) -> None:
        waiting = self.mode_index == WAITING_MODE
        match command:
            case "ready" | "again":
                self._enter(CONTINUING_MODE, worlds)
            case "wait":
                self._enter(BACKING_OFF_MODE, worlds & ~waiting)
            case "slower" | "faster":
                change = SPEED_FACTOR_STEP if command == "faster" else -SPEED_FACTOR_STEP
                changed = np.clip(self.speed_factor + change, MIN_SPEED_FACTOR, MAX_SPEED_FACTOR)
                self.speed_factor = np.where(worlds, changed, self.speed_factor)
            case "closer":
                self._change_distance(-WAITING_DISTANCE_STEP_M, worlds)
                self._enter(APPROACHING_MODE, worlds & waiting)
            case "farther":
                self._change_distance(WAITING_DISTANCE_STEP_M, worlds)
                self._enter(BACKING_OFF_MODE, worlds & (waiting | (self.mode_index == CONTINUING_MODE)))
            case "other_side":
                present = np.where(
                    self.preferred_side == 0.0,
                    np.where(self._lateral_m > 0.0, 1.0, -1.0),
                    self.preferred_side,
                )
                self.preferred_side = np.where(worlds, -present, self.preferred_side)
                self._side_tried = self._side_tried & ~worlds
                self._enter(BACKING_OFF_MODE, worlds & (self.mode_index != APPROACHING_MODE))
            case "stop":
                self.mode_index = np.where(worlds, STOPPED_MODE, self.mode_index)

    def _change_distance(self, change_m: float, worlds: BoolArray) -> None:
        changed = np.clip(
            self.preferred_distance_m + change_m, MIN_WAITING_DISTANCE_M, MAX_WAITING_DISTANCE_M
        )
        self.preferred_distance_m = np.where(worlds, changed, self.preferred_distance_m)

    def override(self, commanded: FloatArray) -> FloatArray:
        """Returns the actions (N, A) to execute, given the policy's actions. Call this method once per control step."""
        self._age_s = np.minimum(self._age_s + self._step_s, MAX_COMMAND_AGE_S)
        if self.trial_rules.pacing:
            self._update_modes(self._simulation.get_state())
        return self.override_within_step(commanded)

    def override_within_step(self, commanded: FloatArray) -> FloatArray:
        """Returns the actions (N, A) to execute if the policy's actions change within a control step."""
        if not self.trial_rules.pacing:
            return np.where((self.mode_index == STOPPED_MODE)[:, None], 0.0, commanded)
        scaled = np.clip(self.speed_factor[:, None] * np.clip(commanded, -1.0, 1.0), -1.0, 1.0)
        return np.where(self._follows[:, None], scaled, self._own)

    def get_mode_name(self, world: int) -> str:
        """Returns the current mode of the layer in a world, one of ``PACING_MODES``."""
        return PACING_MODES[int(self.mode_index[world])]

    @property
    def waiting_mask(self) -> BoolArray:
        """Boolean mask (N,): worlds in which the robot waits at its waiting pose."""
        return self.mode_index == WAITING_MODE

    @property
    def _follows(self) -> BoolArray:
        """Boolean mask (N,): worlds in which the policy drives the robot."""
        return (self.mode_index == APPROACHING_MODE) | (self.mode_index == CONTINUING_MODE)

    def make_command_input(self) -> FloatArray:
        """Returns the input ``command`` of controllers, (N, ``len(COMMAND_INPUT_ENTRIES)``)."""
        latest = np.arange(len(COMMAND_NAMES)) == self._latest[:, None]
        rest = (
            self._age_s,
            self.speed_factor,
            self.preferred_distance_m,
            self.preferred_side,
            self.waiting_mask,
        )
        return np.column_stack([latest, *rest]).astype(float)

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restores the state of the layer from the result of ``snapshot``."""
        super().restore(snapshot)
        self._retreats.clear()

    def _update_modes(self, state: State) -> None:
        before_m = self.tool_distance_m
        self.tool_distance_m, self._lateral_m = self._distances(state)
        next_m = self.tool_distance_m + np.minimum(self.tool_distance_m - before_m, 0.0)
        self._own = np.zeros_like(self._own)
        self._arrive((self.mode_index == APPROACHING_MODE) & (next_m <= self.preferred_distance_m))
        self._enter(
            BACKING_OFF_MODE,
            self.waiting_mask & (self.tool_distance_m < self.preferred_distance_m - DISTANCE_TOLERANCE_M),
        )
        self._arrive(
            (self.mode_index == BACKING_OFF_MODE) & (self.tool_distance_m >= self.preferred_distance_m)
        )
        for world in np.flatnonzero(self.mode_index == BACKING_OFF_MODE).tolist():
            self._back_off(world)
        for world in np.flatnonzero(self.mode_index == CHANGING_SIDE_MODE).tolist():
            self._change_side(world, state)
        self._continue_by_itself(state)

    def _continue_by_itself(self, state: State) -> None:
        """Continues from the waiting pose without a command, in worlds in which the participant prefers this."""
        wishes = self.trial_rules.preferences
        self._paused_s = np.where(self.waiting_mask, self._paused_s + self._step_s, 0.0)
        if not wishes.continues_without_command:
            return
        due = self.waiting_mask & (self._paused_s > wishes.pause_s)
        if wishes.bite_timing == "with_company":
            due = due & (compute_facing_angle_rad(state) < MAX_FACING_ANGLE_RAD)
        self._enter(CONTINUING_MODE, due)

    def _enter(self, mode: int, worlds: BoolArray) -> None:
        entered = worlds & (self.mode_index != mode)
        self.mode_index = np.where(worlds, mode, self.mode_index)
        self._moved_s = np.where(entered, 0.0, self._moved_s)
        self._paused_s = np.where(entered, 0.0, self._paused_s)
        for world in np.flatnonzero(entered & (self.mode_index == BACKING_OFF_MODE)).tolist():
            if world in self._retreats:
                self._retreats[world].restart()

    def _arrive(self, worlds: BoolArray) -> None:
        """Starts the robot's wait in the worlds of a mask (N,). If the tool is on the wrong side, the robot changes the
        side first.
        """
        wrong = (
            (self.preferred_side != 0.0)
            & (self._lateral_m * self.preferred_side < MIN_LATERAL_OFFSET_M)
            & ~self._side_tried
        )
        self._enter(CHANGING_SIDE_MODE, worlds & wrong)
        self._enter(WAITING_MODE, worlds & ~wrong)

    def _back_off(self, world: int) -> None:
        action = self._retreat(world).compute_next_action()
        self._moved_s[world] += self._step_s
        if action is None:
            self._enter(WAITING_MODE, self._only(world))
        else:
            self._own[world] = action

    def _change_side(self, world: int, state: State) -> None:
        """Moves the tool to the preferred side, and away from the person if it is too close."""
        self._moved_s[world] += self._step_s
        side = self.preferred_side[world]
        if self._lateral_m[world] * side >= MIN_LATERAL_OFFSET_M or self._moved_s[world] > MAX_SIDE_CHANGE_S:
            self._side_tried[world] = True
            self._enter(WAITING_MODE, self._only(world))
            return
        missing = np.clip(
            (self.preferred_distance_m[world] - self.tool_distance_m[world]) / DISTANCE_TOLERANCE_M, 0.0, 1.0
        )
        away_w = state.tool_pad_pos_w[world] - self._reference_w(state)[world]
        direction = np.array([side, 0.0, 0.0]) + missing * away_w / max(float(np.linalg.norm(away_w)), 1e-9)
        self._own[world] = self._retreat(world).compute_action_for_velocity(
            RETREAT_TOOL_SPEED_M_S * direction / max(float(np.linalg.norm(direction)), 1e-9)
        )

    def _only(self, world: int) -> BoolArray:
        return np.arange(len(self.mode_index)) == world

    def _retreat(self, world: int) -> Retreat:
        if world not in self._retreats:
            self.prepare_retreat(world)
        return self._retreats[world]

    def _distances(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Returns the distance (N,) between tool and offered body part, and the tool's offset (N,) to the left."""
        ends_w = state.person_capsule_ends_w[:, self._geoms]
        apart = point_segment_distance(state.tool_pad_pos_w[:, None], ends_w[:, :, 0], ends_w[:, :, 1])
        tool_distance_m = (apart - state.person_radius_m[:, self._geoms]).min(axis=-1)
        return tool_distance_m, (state.tool_pad_pos_w - self._reference_w(state))[:, 0]

    def _reference_w(self, state: State) -> FloatArray:
        """Returns the position (N, 3) from which the tool's lateral offset is measured."""
        arms = {"arm": state.right_arm_pos_w, "left_arm": state.left_arm_pos_w}
        return arms[self._offered].mean(axis=1) if self._offered in arms else state.mouth_pos_w


def compute_facing_angle_rad(state: State) -> FloatArray:
    """Returns the angle (N,) between the head's forward direction and the direction from the head to the tool."""
    ahead_w = transforms.rotate(state.head_quat_w, np.array([0.0, -1.0, 0.0]))
    toward_w = state.tool_pad_pos_w - state.head_pos_w
    cosine = (ahead_w * toward_w).sum(axis=-1) / np.maximum(np.linalg.norm(toward_w, axis=-1), 1e-9)
    return np.arccos(np.clip(cosine, -1.0, 1.0))
