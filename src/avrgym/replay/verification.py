"""Verifies a recording: recomputes it from its initial state, commands and body targets, and compares all bits of
states and control steps.

The C library's elementary functions round differently on other processors. Contacts amplify these differences. If bits
differ, every tick (10 ms) is therefore also recomputed from the previous recorded state. Rounding then causes only very
small differences, see ``MAX_ROUNDING_DIFFERENCE``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.elementary import compute_c_library_fingerprint
from avrgym.recording.configuration import Versions
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Control
from avrgym.replay.playback import ComparedState, ComparedStep, Playback, find_changed_plugins
from avrgym.vr.session.attempt import read_package_versions

_State = mujoco.mjtState
STATE_QUANTITIES: Mapping[str, _State] = {
    name.removeprefix("mjSTATE_").lower(): part
    for name, part in _State.__members__.items()
    if int(part) & int(_State.mjSTATE_INTEGRATION) and int(part).bit_count() == 1
}
"""Parts of MuJoCo's integration state, such as ``qpos``, by name. Values are in SI units."""


MAX_ROUNDING_DIFFERENCE = 1e-9
"""Maximum relative difference after one tick that rounding can explain."""


@dataclass(frozen=True)
class QuantityDifference:
    """Differences between the recorded and the recomputed values of one quantity.

    Attributes:
        quantity: name of the quantity, such as ``qpos`` or ``reward``.
        times: number of states or steps with a difference.
        first_time_s: time of the first difference.
        largest: the largest difference, in SI units.
        largest_share: the largest difference, divided by the recorded value or by 1, whichever is larger.
    """

    quantity: str
    times: int
    first_time_s: float
    largest: float
    largest_share: float


@dataclass(frozen=True)
class Verification:
    """Result of the verification of a recording.

    Attributes:
        num_states: number of compared states.
        num_identical_states: number of states without differences.
        num_steps: number of compared control steps.
        num_identical_steps: number of control steps without differences.
        end_time_s: time of the last compared state, in seconds from the start of the trial.
        max_tick_error: largest relative difference after one tick from a recorded state.
        is_complete: whether the recording contains the whole trial.
        recorded_versions: versions of AVR Gym and MuJoCo that made the recording.
        has_same_versions: whether these versions are installed now.
        has_same_rounding: whether the C library rounds as it did during the recording.
        plugin_differences: plug-ins that have changed since the recording.
        differences: the differences, one object for each quantity.
    """

    num_states: int
    num_identical_states: int
    num_steps: int
    num_identical_steps: int
    end_time_s: float
    max_tick_error: float
    is_complete: bool
    recorded_versions: Versions
    has_same_versions: bool
    has_same_rounding: bool
    plugin_differences: list[str]
    differences: list[QuantityDifference]

    @property
    def is_identical(self) -> bool:
        """Whether all states and control steps are bit-identical."""
        return not self.differences

    @property
    def agrees_within_rounding(self) -> bool:
        """Whether different rounding of the C library can explain all differences."""
        return self.max_tick_error <= MAX_ROUNDING_DIFFERENCE


def verify_recording(recording: Recording, progress: Callable[[], None] = lambda: None) -> Verification:
    """Recomputes a recording from its first state. Returns a comparison of all states and control steps.

    Args:
        recording: the recording of one attempt, complete or not.
        progress: called after each state.

    Raises:
        ReplayError: if the recording cannot be recomputed.
    """
    playback, found = Playback(recording), _Differences()
    states: list[bool] = []
    steps: list[bool] = []
    until_s = 0.0
    for compared in playback.recompute():
        if isinstance(compared, ComparedState):
            states.append(found.compare_state(compared, playback.episodes.simulation.model))
            until_s = compared.time_s
            progress()
        else:
            steps.append(found.compare_step(compared))
    recorded_with = recording.configuration.versions
    return Verification(
        num_states=len(states),
        num_identical_states=sum(states),
        num_steps=len(steps),
        num_identical_steps=sum(steps),
        end_time_s=until_s,
        max_tick_error=_tick_error(recording) if found.differences else 0.0,
        is_complete=recording.is_complete,
        recorded_versions=recorded_with,
        has_same_versions=recorded_with == read_package_versions(),
        has_same_rounding=recording.configuration.c_library == compute_c_library_fingerprint(),
        plugin_differences=find_changed_plugins(recording),
        differences=list(found.differences.values()),
    )


def _tick_error(recording: Recording) -> float:
    playback, found = Playback(recording), _Differences()
    for compared in playback.recompute(follow=True):
        if isinstance(compared, ComparedState):
            found.compare_state(compared, playback.episodes.simulation.model)
        else:
            found.compare_step(compared)
    return max((difference.largest_share for difference in found.differences.values()), default=0.0)


class _Differences:
    """Collects the differences between recorded and recomputed values, by quantity."""

    def __init__(self) -> None:
        self.differences: dict[str, QuantityDifference] = {}

    def compare_state(self, compared: ComparedState, model: mujoco.MjModel) -> bool:
        """Stores the differences of a state. Returns whether recorded and recomputed state are identical."""
        if not compared.is_identical:
            for name, part in STATE_QUANTITIES.items():
                self._compare(
                    name,
                    compared.time_s,
                    *(_part(model, s, part) for s in (compared.recorded_state, compared.recomputed_state)),
                )
        return compared.is_identical

    def compare_step(self, compared: ComparedStep) -> bool:
        """Stores the differences of a control step. Returns whether recorded and recomputed step are identical."""
        recorded, stepped = _figures(compared.recorded_step), _figures(compared.recomputed_step)
        absent = np.array([np.nan])
        same = [
            self._compare(name, compared.time_s, recorded.get(name, absent), stepped.get(name, absent))
            for name in recorded | stepped
        ]
        return all(same)

    def _compare(self, quantity: str, time_s: float, recorded: FloatArray, stepped: FloatArray) -> bool:
        if recorded.tobytes() == stepped.tobytes():
            return True
        largest, share = _distance(recorded, stepped)
        before = self.differences.get(quantity, QuantityDifference(quantity, 0, time_s, 0.0, 0.0))
        self.differences[quantity] = QuantityDifference(
            quantity,
            before.times + 1,
            before.first_time_s,
            max(before.largest, largest),
            max(before.largest_share, share),
        )
        return False


def _distance(recorded: FloatArray, stepped: FloatArray) -> tuple[float, float]:
    """Returns the largest absolute and relative difference. Both are infinite if the arrays differ in shape or in the
    positions of NaN.
    """
    if recorded.shape != stepped.shape:
        return np.inf, np.inf
    apart = np.where(np.isnan(recorded) & np.isnan(stepped), 0.0, np.abs(recorded - stepped))
    apart = np.where(np.isfinite(apart), apart, np.inf)
    return float(apart.max()), float((apart / np.fmax(1.0, np.abs(recorded))).max())


def _part(model: mujoco.MjModel, state: FloatArray, part: _State) -> FloatArray:
    found = np.empty(mujoco.mj_stateSize(model, part))
    mujoco.mj_extractState(model, state, _State.mjSTATE_INTEGRATION, found, part)
    return found


def _figures(step: Control) -> dict[str, FloatArray]:
    """Returns the results of a control step as arrays, by name."""
    terms = {f"term {name}": value for name, value in step.reward_terms.items()}
    values = {
        "observation": step.observation,
        "action": step.action,
        "reward": step.reward,
        "success": step.success,
        "distance_m": step.distance_m,
        "force_on_person_n": step.force_on_person_n,
    }
    return {name: np.array(value, float) for name, value in (values | terms).items()}
