"""Commands of ``avrgym study`` about the plan and deviations from the plan."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.progress import show_progress_bar
from avrgym.cli.terminal import (
    JobsOption,
    JsonFileOption,
    check_json_file,
    print_line,
    print_table,
    report_errors,
    write_json,
)

if TYPE_CHECKING:
    from avrgym.study.checking.finding import ExcludedTrialFinding, Finding
    from avrgym.study.storage.store import StudyStore

StudyFolderArgument = Annotated[Path, typer.Argument(help="The study's folder.", metavar="DIR")]
DEFAULT_EFFECT_SIZES = (0.5, 1.0, 1.5)
"""Default effect sizes of the command ``power``, in points of a seven-point scale."""


def freeze(
    folder: StudyFolderArgument,
    template: Annotated[
        bool, typer.Option("--template", help="Write a template of plan.toml. The plan is not frozen.")
    ] = False,
    form: Annotated[
        str | None,
        typer.Option("--export", help="Write the plan as the fields of a registry: osf or aspredicted."),
    ] = None,
    timestamp: Annotated[
        Path | None,
        typer.Option(
            "--timestamp",
            help="Store a time stamp (RFC 3161) of the frozen plan.",
            metavar="FILE.tsr",
        ),
    ] = None,
    registered: Annotated[
        str | None,
        typer.Option(
            "--registered", help="Store the address of a registration of the frozen plan.", metavar="URL"
        ),
    ] = None,
    registered_on: Annotated[
        datetime | None,
        typer.Option(
            "--registered-on", help="The day of the registration; default: today.", formats=["%Y-%m-%d"]
        ),
    ] = None,
) -> None:
    """Freeze the plan before the first participant.

    If there is no plan.toml, the command writes a template. If another station has frozen the plan, that plan is
    adopted.
    """
    from avrgym.analysis.plan import list_available_tests
    from avrgym.study.plan.analysis_plan import PLAN_FILE
    from avrgym.study.plan.frozen_plan import FROZEN_PLAN_FILE, adopt_frozen_plan, can_adopt_frozen_plan
    from avrgym.study.plan.frozen_plan import freeze_analysis_plan as freeze_analysis_plan
    from avrgym.study.plan.preregistration import write_preregistration
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        if form is not None:
            print_line(f"fields    {write_preregistration(store, list_available_tests(store.design), form)}")
        elif timestamp is not None or registered is not None:
            _store_evidence(store, timestamp, registered, registered_on)
            log_command(store, "store evidence of plan")
        elif can_adopt_frozen_plan(store) and not template:
            print_line(
                f"adopted   {store.folder / FROZEN_PLAN_FILE}, frozen at {adopt_frozen_plan(store).frozen_at} at "
                f"another "
                "station"
            )
            log_command(store, "adopt plan")
        elif template or not (store.folder / PLAN_FILE).exists():
            print_line(f"plan      {_write_template(store)}: edit it, then freeze it")
        else:
            record = freeze_analysis_plan(store, list_available_tests(store.design))
            log_command(store, "freeze plan")
            print_line(f"frozen    {store.folder / FROZEN_PLAN_FILE} at {record.frozen_at}")
            _print_deposit(store.folder / FROZEN_PLAN_FILE)


def _print_deposit(record: Path) -> None:
    """Print instructions for a proof of the plan's date: a registration or a time stamp."""
    from avrgym.study.plan.frozen_plan import compute_sha256

    print_line(f"SHA-256   {compute_sha256(record.read_bytes())}")
    print_line(
        "deposit   put this SHA-256 into a registration (osf.io, aspredicted.org), or have it time-stamped: "
        f"openssl ts -query -data {record} -sha256 -cert -out plan.tsq, send plan.tsq to an authority (RFC 3161); then "
        f"avrgym study freeze {record.parent} --registered URL, or --timestamp FILE.tsr"
    )


def _store_evidence(
    store: "StudyStore", timestamp: Path | None, registered: str | None, registered_on: datetime | None
) -> None:
    from avrgym.study.plan.date_evidence import store_registration, store_time_stamp
    from avrgym.study.plan.frozen_plan import FROZEN_PLAN_FILE
    from avrgym.study.storage.state_transitions import StudyError

    record = store.folder / FROZEN_PLAN_FILE
    if not record.exists():
        raise StudyError(
            f"{store.folder} has no frozen plan; `avrgym study freeze {store.folder}` creates one"
        )
    if timestamp is not None:
        stamp = store_time_stamp(store.folder, timestamp.read_bytes(), record.read_bytes())
        known = "knows" if stamp.is_trusted else "does not know"
        print_line(
            f"stamped   at {stamp.issued_at.isoformat()} by {stamp.authority}; this computer {known} its root "
            f"certificate"
        )
    if registered is not None:
        store_registration(store.folder, registered, (registered_on or datetime.now()).date())
        print_line(f"claimed   registration at {registered}; the report names it as your claim")


def _write_template(store: "StudyStore") -> Path:
    from avrgym.analysis.plan import list_available_tests, suggest_hypotheses
    from avrgym.study.plan.frozen_plan import check_plan_can_be_frozen
    from avrgym.study.plan.plan_template import write_plan_template

    check_plan_can_be_frozen(store)
    return write_plan_template(
        store.folder, store.design, list_available_tests(store.design), suggest_hypotheses(store.design)
    )


def power(
    study: Annotated[Path, typer.Argument(help="The study's folder, or a study.toml.", metavar="DIR|FILE")],
    effects: Annotated[
        list[float] | None,
        typer.Option("--effect", help="Effect in points of a seven-point scale; can be repeated."),
    ] = None,
    sizes: Annotated[
        list[int] | None,
        typer.Option("--participants", help="Number of completed participants; can be repeated.", min=1),
    ] = None,
    participant_sd: Annotated[
        float, typer.Option(help="Standard deviation between participants, in points.")
    ] = 0.8,
    policy_sd: Annotated[
        float, typer.Option(help="Standard deviation of the policy effect between participants, in points.")
    ] = 0.5,
    task_sd: Annotated[float, typer.Option(help="Standard deviation between tasks, in points.")] = 0.5,
    noise_sd: Annotated[float, typer.Option(help="Residual standard deviation, in points.")] = 1.0,
    drift: Annotated[float, typer.Option(help="Increase of ratings during a session, in points.")] = 0.5,
    dropout: Annotated[
        float, typer.Option(help="Share (0 to 1) of participants who withdraw and are replaced.")
    ] = 0.1,
    simulations: Annotated[
        int,
        typer.Option(help="Number of simulated studies for each effect and number of participants.", min=1),
    ] = 500,
    seed: Annotated[int, typer.Option(help="Random seed. The same seed gives the same results.", min=0)] = 0,
    jobs: JobsOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Simulate the power of the study's tests.

    The power is estimated for several effect sizes and several numbers of participants.
    """
    from avrgym.analysis.power.power_simulation import choose_default_sample_sizes, simulate_power
    from avrgym.analysis.power.simulated_studies import PowerAssumptions
    from avrgym.analysis.power.summary import make_power_summary, make_power_table_rows
    from avrgym.study.design.design import DESIGN_FILE, read_design
    from avrgym.system.parallel_calls import count_available_cores

    with report_errors():
        check_json_file(json_file)
        design = read_design(study / DESIGN_FILE if study.is_dir() else study)
        assumptions = PowerAssumptions(participant_sd, policy_sd, task_sd, noise_sd, drift, dropout)
        wanted = (
            tuple(sorted({*sizes, design.participants})) if sizes else choose_default_sample_sizes(design)
        )
        with show_progress_bar("simulating studies", unit="studies") as bar:
            rows = simulate_power(
                design,
                assumptions,
                sorted(set(effects or DEFAULT_EFFECT_SIZES)),
                wanted,
                simulations,
                seed,
                jobs or count_available_cores(),
                bar.update,
            )
        found = make_power_summary(design, assumptions, rows, seed)
        write_json(json_file, found)
    print_table(make_power_table_rows(rows))
    for sentence in found["words"]:
        print_line(sentence)


def read_plan_deviations(
    store: "StudyStore", left_out: "Sequence[ExcludedTrialFinding]" = ()
) -> "tuple[str | None, list[Finding]]":
    """Returns the time at which the plan was frozen (``None`` without a frozen plan), and the deviations from the
    plan."""
    from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence

    frozen = read_frozen_plan_evidence(store)
    if frozen is None:
        return None, []
    from avrgym.analysis.plan import list_optional_tests, list_required_tests
    from avrgym.study.plan.plan_deviations import find_deviations
    from avrgym.study.storage.item_versions import AnsweredItems

    design = AnsweredItems(store).design
    return frozen.existed_since_text, find_deviations(
        store, frozen, list_required_tests(design), left_out, list_optional_tests(design)
    )


def check_study_and_plan(store: "StudyStore") -> "list[Finding]":
    """Returns the findings of all checks and all deviations from the plan, without duplicates."""
    from avrgym.study.checking.finding import ExcludedTrialFinding
    from avrgym.study.checking.study_checks import check_study

    found = check_study(store)
    _, deviating = read_plan_deviations(
        store, [each for each in found if isinstance(each, ExcludedTrialFinding)]
    )
    return [
        *(each for each in found if each not in deviating),
        *(replace(each, message=f"deviates from the plan: {each.message}") for each in deviating),
    ]


def quality(folder: StudyFolderArgument, json_file: JsonFileOption = None) -> None:
    """Show answer quality and violated rules.

    The exclusion rules are [[exclusion.rules]] of the frozen plan.
    """
    from avrgym.study.plan.exclusion_rules import compute_answer_quality, find_rule_violations
    from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with StudyStore(folder) as store:
            frozen = read_frozen_plan_evidence(store)
            rules = (
                ()
                if frozen is None or frozen.frozen_plan is None
                else frozen.frozen_plan.parse_plan().exclusion.rules
            )
            found = find_rule_violations(store, rules)
            rows: list[dict[str, Any]] = [
                asdict(compute_answer_quality(store, each.pseudonym))
                | {"violations": [every.reason for every in found if every.participant == each.pseudonym]}
                for each in store.read_participants()
            ]
            log_command(store, "view answer quality")
        write_json(json_file, rows)
    if rows:
        print_table([row | {"violations": "; ".join(row["violations"])} for row in rows])
    else:
        print_line("the study has no participants")
