"""Controllers that react to the present and plan nothing, so that a policy without task_state can learn from them.

They are worse than the oracles, which choose the arm's pose and the tool's way for each person: a teacher moves the
tool straight on, by a rule that changes evenly from state to state.
"""

from collections.abc import Callable, Mapping
from functools import partial

from avrgym.tasks.episodes import Episodes
from avrgym.teachers.reactive import Array, Reactive
from avrgym.teachers.rules import feed, give_drink
from avrgym.teachers.scratching import scratch
from avrgym.teachers.wiping import wipe

TEACHERS: Mapping[str, Callable[[Episodes], Callable[[Array], Array]]] = {
    "Feeding": partial(Reactive, aim=feed),
    "Drinking": partial(Reactive, aim=give_drink),
    "ScratchItch": partial(Reactive, aim=scratch),
    "BedBathing": partial(Reactive, aim=wipe),
}
"""By task: made when episodes have begun, then called with the observation (N, O) of every control step."""
