"""Whether a recording is what its own beginning, commands and movements lead to, bit by bit.

MuJoCo takes sines and the like from the C library, whose last bits differ between processors and libraries, and
contacts make such a difference grow. So where bits differ, every tick is also stepped from the recorded state before
it: there, rounding alone makes less than 10⁻¹¹, and anything else shows at once.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.elementary import fingerprint_of_c_library
from avrgym.recording.configuration import Versions
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Control
from avrgym.replay.playback import ComparedState, ComparedStep, Playback, changed_plugins
from avrgym.vr.session.attempt import versions

_State = mujoco.mjtState
STATE_QUANTITIES: Mapping[str, _State] = {
    name.removeprefix("mjSTATE_").lower(): part
    for name, part in _State.__members__.items()
    if int(part) & int(_State.mjSTATE_INTEGRATION) and int(part).bit_count() == 1
}
"""Parts of a state by the simulator's names for them; SI units."""


ROUNDING = 1e-9
"""What rounding alone cannot make of a number of ordinary size in one tick."""


@dataclass(frozen=True)
class Difference:
    """A quantity that came out otherwise: how often, since when, and by how much at most (SI units).

    ``largest_share``: by how much at most as a share of the recorded number, or of 1 where that is larger.
    """

    quantity: str
    times: int
    first_time_s: float
    largest: float
    largest_share: float


@dataclass(frozen=True)
class Verification:
    """What stepping a recording compared gave.

    ``states`` and ``steps`` count what was compared, ``identical_*`` what agreed in every bit; ``until_s`` is the time
    of the last state. ``tick_error`` is the largest share by which a number differs where each tick begins with the
    recorded state. ``complete``: the recording holds its whole trial. ``same_versions``: it was made with the versions
    of AVR Gym and MuJoCo that run now, so that nothing but rounding may differ; ``same_rounding``: nor that, because
    the C library rounded as it does here. ``plugin_differences``: which plug-ins are not what they were then.
    """

    states: int
    identical_states: int
    steps: int
    identical_steps: int
    until_s: float
    tick_error: float
    complete: bool
    recorded_with: Versions
    same_versions: bool
    same_rounding: bool
    plugin_differences: list[str]
    differences: list[Difference]

    @property
    def identical(self) -> bool:
        """Whether everything agreed in every bit."""
        return not self.differences

    @property
    def agrees(self) -> bool:
        """Whether nothing but rounding differs."""
        return self.tick_error <= ROUNDING


def verify(recording: Recording, progress: Callable[[], None] = lambda: None) -> Verification:
    """Step a recording compared from its first state and compare whatever it holds.

    Args:
        recording: of one attempt at a trial, whole or not.
        progress: told after each state.

    Raises:
        ReplayError: when it cannot be stepped.
    """
    playback, ledger = Playback(recording), _Ledger()
    states: list[bool] = []
    steps: list[bool] = []
    until_s = 0.0
    for compared in playback.run():
        if isinstance(compared, ComparedState):
            states.append(ledger.compare_state(compared, playback.episodes.simulation.model))
            until_s = compared.time_s
            progress()
        else:
            steps.append(ledger.compare_step(compared))
    recorded_with = recording.configuration.versions
    return Verification(
        states=len(states),
        identical_states=sum(states),
        steps=len(steps),
        identical_steps=sum(steps),
        until_s=until_s,
        tick_error=_tick_error(recording) if ledger.differences else 0.0,
        complete=recording.complete,
        recorded_with=recorded_with,
        same_versions=recorded_with == versions(),
        same_rounding=recording.configuration.c_library == fingerprint_of_c_library(),
        plugin_differences=changed_plugins(recording),
        differences=list(ledger.differences.values()),
    )


def _tick_error(recording: Recording) -> float:
    playback, ledger = Playback(recording), _Ledger()
    for compared in playback.run(follow=True):
        if isinstance(compared, ComparedState):
            ledger.compare_state(compared, playback.episodes.simulation.model)
        else:
            ledger.compare_step(compared)
    return max((difference.largest_share for difference in ledger.differences.values()), default=0.0)


class _Ledger:
    """The differences so far, by quantity."""

    def __init__(self) -> None:
        self.differences: dict[str, Difference] = {}

    def compare_state(self, compared: ComparedState, model: mujoco.MjModel) -> bool:
        """Whether the state is the recorded one; note by how much its parts differ."""
        if not compared.identical:
            for name, part in STATE_QUANTITIES.items():
                self._compare(
                    name,
                    compared.time_s,
                    *(_part(model, s, part) for s in (compared.recorded, compared.recomputed)),
                )
        return compared.identical

    def compare_step(self, compared: ComparedStep) -> bool:
        """Whether the control step is the recorded one; note what of it differs."""
        recorded, stepped = _figures(compared.recorded), _figures(compared.recomputed)
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
        before = self.differences.get(quantity, Difference(quantity, 0, time_s, 0.0, 0.0))
        self.differences[quantity] = Difference(
            quantity,
            before.times + 1,
            before.first_time_s,
            max(before.largest, largest),
            max(before.largest_share, share),
        )
        return False


def _distance(recorded: FloatArray, stepped: FloatArray) -> tuple[float, float]:
    """The largest difference, and the largest as a share; infinite where shapes differ or a number is missing."""
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
    """What a control step gave, each an array, by name."""
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
