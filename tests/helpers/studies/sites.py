"""Studies of several sites, and killed merges."""

import os
import signal
from collections.abc import Callable, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from avrgym.study.checking.study_checks import check_study
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.storage import hash_chain
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study

Tree = dict[str, bytes]


def make_site(folder: Path, site: str = "", *, trials: tuple[int | None, ...] = (2,), url: str = "") -> Path:
    """Create a site's study with one participant for each of ``trials``; ``None`` means all trials."""
    small_study(folder)
    set_in_design(folder, 'site = ""', f'site = "{site}"')
    set_in_design(folder, 'url = ""', f'url = "{url}"')
    for count in trials:
        add_participant(folder, count)
    return folder


def add_participant(folder: Path, trials: int | None) -> str:
    """Add a participant with a name and run their first trials."""
    with StudyStore(folder) as store:
        name = f"Grace Unverwechselbar {len(store.read_participants())}"
        pseudonym = enrol_with_consent(store, simulated=False, name=name)
        run_participant(store, pseudonym, trials, simulated=False)
    return pseudonym


def set_in_design(folder: Path, before: str, after: str) -> None:
    """Replace the first such line in a site's design."""
    path = folder / "study.toml"
    text = path.read_text()
    assert f"\n{before}\n" in text
    path.write_text(text.replace(f"\n{before}\n", f"\n{after}\n", 1))


def files_in(folder: Path) -> Tree:
    """Return the content of every file in a folder, by name."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def check_errors(folder: Path) -> list[str]:
    """Return the errors that the check of a study finds."""
    with StudyStore(folder) as store:
        return [f"{each.where}: {each.message}" for each in check_study(store) if each.is_error]


def study_contents(folder: Path) -> dict[str, list[Any]]:
    """Return the rows of each participant and the bytes of their recordings."""
    with StudyStore(folder) as store:
        return {
            person.pseudonym: [
                person,
                store.read_sessions(person.pseudonym),
                store.read_trials(person.pseudonym),
                store.read_attempts(person.pseudonym),
                store.read_answers(person.pseudonym),
                [event for event in store.read_events() if event.participant == person.number],
                store.read_notes(person.pseudonym),
                {
                    each.recording: store.resolve_path(each.recording).read_bytes()
                    for each in store.read_attempts(person.pseudonym)
                },
            ]
            for person in store.read_participants()
        }


def kill_merge(folders: Sequence[Path], out: Path, after: int | float) -> bool:
    """Merge in a process that is killed after steps (int) or seconds (float). Returns whether it was killed."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["helpers.studies.sites"])
    process = context.Process(target=_merge, args=(folders, out, after if isinstance(after, int) else None))
    process.start()
    process.join(None if isinstance(after, int) else after)
    process.kill()
    process.join()
    assert process.exitcode in (0, -signal.SIGKILL)
    return process.exitcode != 0


def _merge(folders: Sequence[Path], out: Path, steps: int | None) -> None:
    if steps is not None:
        left = iter(range(steps))
        os.replace = _killing(os.replace, left)
        hash_chain.insert_row = _killing(hash_chain.insert_row, left)
        hash_chain.append_chain_entries = _killing(hash_chain.append_chain_entries, left)
    merge_studies(folders, out)


def _killing(function: Callable[..., Any], left: Any) -> Callable[..., Any]:
    """Wrap a function: it kills this process when no steps are left."""

    def counted(*given: Any, **named: Any) -> Any:
        if next(left, None) is None:
            os.kill(os.getpid(), signal.SIGKILL)
        return function(*given, **named)

    return counted
