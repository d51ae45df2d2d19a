"""Check that all trials of a study were recorded with the same plug-ins."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from avrgym.policies.registry import find_used_controller_plugin
from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import RecordingError, read_header
from avrgym.study.checking.finding import Finding
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.used_plugins import UsedPlugin
from avrgym.tasks.registry import ENVIRONMENTS, find_plugins


@dataclass(frozen=True)
class RecordedPlugin:
    """A plug-in of one trial.

    ``plugin_label``: type and name of the plug-in. ``recorded_version``: plug-in and version in the recording.
    ``installed_version``: the installed plug-in and version. ``participant``: pseudonym. ``trial_position``: position
    of the trial.
    """

    plugin_label: str
    recorded_version: str
    installed_version: str
    participant: str
    trial_position: int
    is_simulated: bool


def check_plugins(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about plug-ins that differ between completed trials, or from the installed plug-ins."""
    return compare_recorded_plugins(_recorded(store))


def compare_recorded_plugins(recorded: Iterable[RecordedPlugin]) -> Iterator[Finding]:
    """Yields findings about plug-ins that differ between trials, or from the installed plug-ins.

    Trials of people and of simulated participants are compared separately.
    """
    groups = defaultdict[tuple[str, bool], list[RecordedPlugin]](list)
    for each in recorded:
        groups[each.plugin_label, each.is_simulated].append(each)
    for (label, _), trials in groups.items():
        yield from _findings_of_plugin(label, trials)


def _findings_of_plugin(label: str, trials: list[RecordedPlugin]) -> Iterator[Finding]:
    by_content = defaultdict[str, list[RecordedPlugin]](list)
    for each in trials:
        by_content[each.recorded_version].append(each)
    if len(by_content) > 1:
        parts = [f"{content} in {_trials_text(own)}" for content, own in by_content.items()]
        yield Finding(label, f"was not the same in all trials: {'; '.join(parts)}")
    present = trials[0].installed_version
    if present not in by_content:
        recorded = " and ".join(by_content)
        yield Finding(
            label, f"is installed as {present}, which no trial used; trials used {recorded}", is_error=False
        )


def _trials_text(trials: Iterable[RecordedPlugin]) -> str:
    positions = defaultdict[str, list[int]](list)
    for each in trials:
        positions[each.participant].append(each.trial_position)
    return ", ".join(
        f"{participant} trial{'s' * (len(own) > 1)} {' '.join(map(str, own))}"
        for participant, own in positions.items()
    )


def list_recorded_plugins(
    configuration: TrialConfiguration, participant: str, position: int, *, simulated: bool
) -> Iterator[RecordedPlugin]:
    """Yields the plug-ins in the recorded configuration of a trial."""
    now = _present(configuration)
    for plugin in sorted(configuration.plugins, key=lambda plugin: plugin.label):
        present = str(now.get(plugin.label, "no plug-in here"))
        yield RecordedPlugin(plugin.label, str(plugin), present, participant, position, simulated)


def _present(configuration: TrialConfiguration) -> dict[str, UsedPlugin]:
    """Returns the installed plug-ins for the trial's environment and policy, by label."""
    environment = configuration.environment
    found = list(find_plugins(environment)) if environment in ENVIRONMENTS else []
    controller = find_used_controller_plugin(configuration.policy)
    return {each.label: each for each in [*found, *([controller] if controller else [])]}


def _recorded(store: StudyStore) -> Iterator[RecordedPlugin]:
    """Yields the plug-ins of all completed trials with a readable recording."""
    for participant in store.read_participants():
        positions = {trial.id: trial.position for trial in store.read_trials(participant.pseudonym)}
        for attempt in store.read_attempts(participant.pseudonym):
            if attempt.state == "completed" and attempt.trial in positions:
                with suppress(OSError, RecordingError, StudyError):  # another check reports it
                    yield from list_recorded_plugins(
                        read_header(store.resolve_path(attempt.recording)).configuration,
                        participant.pseudonym,
                        positions[attempt.trial],
                        simulated=participant.simulated,
                    )
