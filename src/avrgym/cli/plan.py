"""The commands of ``avrgym study`` that are about its plan, and what others tell of it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.cli.terminal import plain_errors, say

if TYPE_CHECKING:
    from avrgym.study.checking.finding import Finding
    from avrgym.study.storage.store import Store

Folder = Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")]


def freeze(
    folder: Folder,
    template: Annotated[
        bool, typer.Option("--template", help="Write plan.toml to fill in, and freeze nothing.")
    ] = False,
    form: Annotated[
        str | None,
        typer.Option("--export", help="Write the plan as the fields of a registry: osf or aspredicted."),
    ] = None,
) -> None:
    """Freeze the study's plan before the first participant; without a plan, write one to fill in."""
    from avrgym.analysis.statistics.offered import offered_tests
    from avrgym.study.plan.freezing import FROZEN
    from avrgym.study.plan.freezing import freeze as freeze_plan
    from avrgym.study.plan.plan import FILE
    from avrgym.study.plan.preregistration import write_preregistration
    from avrgym.study.storage.store import Store

    with plain_errors(), Store(folder) as store:
        if form is not None:
            say(f"fields    {write_preregistration(store, offered_tests(store.design), form)}")
        elif template or not (store.folder / FILE).exists():
            say(f"plan      {_write_template(store)}: change what you like, then freeze it")
        else:
            record = freeze_plan(store, offered_tests(store.design))
            say(f"frozen    {store.folder / FROZEN} at {record.frozen_at}")


def _write_template(store: "Store") -> Path:
    from avrgym.analysis.statistics.offered import offered_tests, suggested_hypotheses
    from avrgym.study.plan.freezing import check_untouched
    from avrgym.study.plan.template import write_template

    check_untouched(store)
    return write_template(
        store.folder, store.design, offered_tests(store.design), suggested_hypotheses(store.design)
    )


def plan_of(store: "Store", left_out: "Sequence[Finding]" = ()) -> "tuple[str | None, list[Finding]]":
    """When a study's plan was frozen, if it was, and in what the study deviates from it."""
    from avrgym.study.plan.freezing import read_frozen

    frozen = read_frozen(store)
    if frozen is None:
        return None, []
    from avrgym.analysis.statistics.offered import offered_tests
    from avrgym.study.plan.deviations import deviations

    return frozen.at, deviations(store, frozen, offered_tests(store.design), left_out)


def plan_findings(store: "Store") -> "list[Finding]":
    """In what a study deviates from its frozen plan, as findings of a check: recordings are read."""
    from avrgym.study.plan.deviations import left_out_trials
    from avrgym.study.plan.freezing import read_frozen

    if read_frozen(store) is None:
        return []
    _, found = plan_of(store, left_out_trials(store))
    return [replace(each, what=f"deviates from the plan: {each.what}") for each in found]
