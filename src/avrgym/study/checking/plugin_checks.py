"""Which plug-ins a study's trials were recorded with, and whether they were the same in all of them."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from avrgym.policies import controllers
from avrgym.recording.reader import RecordingError, read_configuration
from avrgym.study.checking.finding import Finding
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.system.used_plugins import UsedPlugin, stored
from avrgym.tasks.registry import ENVIRONMENTS, plugins_of

NOT_STORED = "not stored"


@dataclass(frozen=True)
class RecordedPlugin:
    """What a plug-in was in a participant's trial, or ``NOT_STORED``; ``now``: what it is."""

    called: str
    then: str
    now: str
    participant: str
    position: int
    simulated: bool


def check_plugins(store: Store) -> Iterator[Finding]:
    """Plug-ins that were not the same in all completed trials, are no longer, or were not stored."""
    return plugin_findings(_recorded(store))


def plugin_findings(recorded: Iterable[RecordedPlugin]) -> Iterator[Finding]:
    """The same of trials whose plug-ins are known; people and simulated participants apart."""
    groups = defaultdict[tuple[str, bool], list[RecordedPlugin]](list)
    for each in recorded:
        groups[each.called, each.simulated].append(each)
    for (called, _), uses in groups.items():
        yield from _differing(called, uses)


def _differing(called: str, uses: list[RecordedPlugin]) -> Iterator[Finding]:
    trials = defaultdict[str, list[RecordedPlugin]](list)
    for each in uses:
        trials[each.then].append(each)
    if len(trials) > 1:
        parts = [f"{then} in {_listed(own)}" for then, own in trials.items()]
        yield Finding(called, f"was not the same in all trials: {'; '.join(parts)}")
    elif NOT_STORED in trials:
        yield Finding(called, f"what it was is not stored in {_listed(uses)}", wrong=False)
    now = uses[0].now
    if now not in trials and trials.keys() != {NOT_STORED}:
        yield Finding(called, f"is {now} now, as in no trial; it was {' and '.join(trials)}", wrong=False)


def _listed(uses: Iterable[RecordedPlugin]) -> str:
    positions = defaultdict[str, list[int]](list)
    for each in uses:
        positions[each.participant].append(each.position)
    return ", ".join(
        f"{participant} trial{'s' * (len(own) > 1)} {' '.join(map(str, own))}"
        for participant, own in positions.items()
    )


def recorded_plugins(
    configuration: Mapping[str, Any], participant: str, position: int, *, simulated: bool
) -> Iterator[RecordedPlugin]:
    """The plug-ins of a trial, by the configuration in its recording; those of today where none are stored."""
    then = stored(configuration.get("plugins"))
    now = _present(configuration)
    for called in sorted(now if then is None else {each.called for each in then}):
        before = NOT_STORED if then is None else str(next(each for each in then if each.called == called))
        present = str(now.get(called, "no plug-in here"))
        yield RecordedPlugin(called, before, present, participant, position, simulated)


def _present(configuration: Mapping[str, Any]) -> dict[str, UsedPlugin]:
    """The plug-ins that a trial would be run with now, by what they are called."""
    environment: str = configuration.get("environment", "")
    found = list(plugins_of(environment)) if environment in ENVIRONMENTS else []
    controller = controllers.plugin_named(configuration.get("policy", ""))
    return {each.called: each for each in [*found, *([controller] if controller else [])]}


def _recorded(store: Store) -> Iterator[RecordedPlugin]:
    """Of all completed trials whose recordings can be read here."""
    for participant in store.participants():
        positions = {trial.id: trial.position for trial in store.trials(participant.pseudonym)}
        for attempt in store.attempts(participant.pseudonym):
            if attempt.state == "completed" and attempt.trial in positions:
                with suppress(OSError, RecordingError, StudyError):  # said by other checks
                    yield from recorded_plugins(
                        read_configuration(store.path(attempt.recording)),
                        participant.pseudonym,
                        positions[attempt.trial],
                        simulated=participant.simulated,
                    )
