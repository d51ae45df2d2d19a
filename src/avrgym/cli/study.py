"""The program ``avrgym study``."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.experimenters import add_experimenter, experimenters, revoke_experimenter
from avrgym.cli.invitations import invitations, invite
from avrgym.cli.options import ALLOWED_PEOPLE_TEXT, ClusterOption, ImpairmentOption, connect_cluster
from avrgym.cli.participant_names import encrypt_names, names, print_name_encryption, unlock_identity_file
from avrgym.cli.participant_records import (
    adverse_events,
    change_input,
    data_protection,
    functioning,
    own_furniture,
    participant_data,
    preferences,
    record_adverse_event,
    respondent,
    retention,
)
from avrgym.cli.plan import (
    StudyFolderArgument,
    check_study_and_plan,
    freeze,
    power,
    quality,
    read_plan_deviations,
)
from avrgym.cli.progress import CONTINUE_HINT, show_progress_bar
from avrgym.cli.sites import merge, print_order_counts
from avrgym.cli.terminal import (
    JobsOption,
    JsonFileOption,
    check_json_file,
    confirm,
    print_line,
    print_table,
    print_warning,
    report_errors,
    write_json,
)
from avrgym.commands.input_methods import INPUT_METHODS
from avrgym.commands.respondents import CONSENT_ROLES, PARTICIPANT_RESPONDENT
from avrgym.models.body_names import SEXES

if TYPE_CHECKING:
    from avrgym.study.checking.study_summary import ParticipantSummary
    from avrgym.study.storage.database_rows import Participant
    from avrgym.study.storage.store import StudyStore

app = typer.Typer(no_args_is_help=True, help="Run a study, from its design to the export of its data.")
IDENTITY_FILE_HELP = "Stored only in private/identities.json, encrypted."
PseudonymArgument = Annotated[str, typer.Argument(help="A pseudonym such as sub-001.")]


@app.command()
def new(folder: StudyFolderArgument) -> None:
    """Write a new study.toml with the paper's protocol.

    Edit the file before the first participant is enrolled. Its comments explain each field.
    """
    from avrgym.study.storage.store import create_study

    with report_errors():
        path = create_study(folder)
    print_line(f"design    {path}")


app.command()(power)
app.command()(freeze)
app.command()(quality)
app.command()(merge)
app.command()(names)
app.command()(encrypt_names)
app.command()(record_adverse_event)
app.command()(adverse_events)
app.command()(retention)
app.command()(participant_data)
app.command()(data_protection)
app.command()(functioning)
app.command()(preferences)
app.command("furniture")(own_furniture)
app.command()(respondent)
app.command("input")(change_input)
app.command()(invite)
app.command()(invitations)
app.command()(add_experimenter)
app.command()(experimenters)
app.command()(revoke_experimenter)


@app.command()
def status(folder: StudyFolderArgument, json_file: JsonFileOption = None) -> None:
    """Show the progress of a study.

    It lists participants, their trials, the number of participants in each order, and deviations from the plan.
    """
    from avrgym.study.checking.study_summary import summarise_study
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with StudyStore(folder) as store:
            summary = summarise_study(store)
            frozen_at, deviations = read_plan_deviations(store)
        plan = {"plan_frozen_at": frozen_at, "deviations": [asdict(each) for each in deviations]}
        write_json(json_file, asdict(summary) | plan)
    print_line(f"{summary.title}")
    print_line(
        f"{summary.completed} of {summary.planned} participants completed, {summary.withdrawn} withdrew, "
        f"{summary.excluded} excluded, {summary.deleted} deleted; {summary.simulated} are simulated"
        + (f"; consent or withdrawal of {summary.unknown} is unknown" if summary.unknown else "")
    )
    print_line(f"participants per order  {', '.join(map(str, summary.filled))}")
    print_order_counts(summary)
    if summary.participants:
        print_table([_row(participant) for participant in summary.participants])
    if frozen_at is not None:
        print_line(f"plan frozen at {frozen_at}, deviations: {len(deviations)}")
    for each in deviations:
        print_line(f"deviation  {each.where}: {each.message}")


def _row(participant: "ParticipantSummary") -> dict[str, Any]:
    """Returns a participant's row of the status table. Trial orders are numbered from 1."""
    row = {{"cell": "order"}.get(name, name): value for name, value in asdict(participant).items()}
    return row | {"order": None if participant.cell is None else participant.cell + 1}


@app.command("enrol")
def enrol_participant(
    folder: StudyFolderArgument,
    body: Annotated[str, typer.Option(help=f"The body model: {' or '.join(SEXES)}.")],
    age: Annotated[int | None, typer.Option(help="Age in years.")] = None,
    language: Annotated[str, typer.Option(help="A language of study.toml; default: the first.")] = "",
    name: Annotated[str, typer.Option(help=IDENTITY_FILE_HELP)] = "",
    contact: Annotated[str, typer.Option(help=IDENTITY_FILE_HELP)] = "",
    site: Annotated[str, typer.Option(help="The site; default: that of study.toml.")] = "",
    confirm_duplicate: Annotated[
        bool,
        typer.Option(
            "--confirm-duplicate",
            help="Enrol the person although another participant has the same name or contact.",
        ),
    ] = False,
    method: Annotated[
        str,
        typer.Option(
            "--input", help=f"The input method: {', '.join(INPUT_METHODS)}. `study input` sets the details."
        ),
    ] = "",
) -> None:
    """Enrol a participant under a new pseudonym.

    Each person takes part only once. The command therefore rejects the name or contact of another participant.
    """
    from avrgym.study.people.input_profiles import make_input_profile
    from avrgym.study.people.participants import enrol_participant as take_in
    from avrgym.study.storage import identity_file
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        if body not in SEXES:
            raise ValueError(f"unknown body model {body!r}; allowed: {', '.join(SEXES)}")
        first = not identity_file.find_identity_file_path(folder).exists()
        if name or contact:
            unlock_identity_file(folder)
        pseudonym = take_in(
            store,
            body,
            age_years=age,
            language=language,
            name=name,
            contact=contact,
            site=site,
            confirm_duplicate=confirm_duplicate,
            input_profile=make_input_profile({"method": method}) if method else None,
        )
        log_command(store, "enrol", pseudonym)
    print_line(f"enrolled  {pseudonym}")
    if first:
        print_name_encryption(folder)


@app.command()
def consent(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    by: Annotated[
        str, typer.Option("--by", help=f"The role of the consent: {', '.join(CONSENT_ROLES)}.")
    ] = "participant",
) -> None:
    """Ask a participant for consent.

    The inclusion questions follow. If the answers meet the criteria, the participant is allocated to a trial order.
    After a new version of the consent text, participants must consent again. If a participant cannot consent alone,
    store two records: the consent of a representative (--by proxy), and the participant's assent (--by assent).
    """
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        if by not in CONSENT_ROLES:
            raise RuntimeError(f"--by is {by!r}; allowed: {', '.join(CONSENT_ROLES)}")
        person = store.read_participant(participant)
        if person.must_reconsent(store.design.consent.version):
            if not _ask_again(store, person, by):
                return
        elif person.state != "consented" and not _ask_for_consent(store, person, by):
            return
        if person.state != "allocated":
            _ask_for_inclusion(store, person)


def _ask_for_consent(store: "StudyStore", person: "Participant", by: str) -> bool:
    """Ask for consent, and store the answer. Returns whether the consent is complete."""
    from avrgym.study.storage.state_transitions import check_transition

    check_transition("participant", person.pseudonym, person.state, "consented")
    if not _agrees(store, person):
        raise RuntimeError(f"{person} does not agree. Nothing was stored")
    return _record(store, person, by)


def _record(store: "StudyStore", person: "Participant", by: str) -> bool:
    """Store a consent. Returns whether it is complete: consent of a representative and assent need each other."""
    from avrgym.study.people.participants import record_consent

    complete = record_consent(store, person.pseudonym, by)
    log_command(store, "consent", person.pseudonym, detail="" if by == PARTICIPANT_RESPONDENT else by)
    if not complete:
        missing = "assent" if by == "proxy" else "proxy"
        print_line(f"{person}: stored; next `avrgym study consent {store.folder} {person} --by {missing}`")
    return complete


def _ask_again(store: "StudyStore", person: "Participant", by: str) -> bool:
    """Ask for consent to a new version of the text. Returns whether the participant still takes part."""
    from avrgym.study.people.participants import decline_consent

    print_line(f"{person} agreed to version {person.consent_version} at {person.consented_at}")
    if _agrees(store, person):
        complete = _record(store, person, by)
        if complete:
            print_line(f"{person} agrees to version {store.design.consent.version}")
        return complete
    if not confirm(f"Store that {person} does not agree and withdraws? This is final."):
        raise RuntimeError(
            f"{person} has not decided. Nothing was stored; run the command again after a decision"
        )
    decline_consent(store, person.pseudonym, by)
    log_command(store, "declined-consent", person.pseudonym)
    print_line(f"{person} has withdrawn; `avrgym study delete-participant` deletes their data")
    return False


def _agrees(store: "StudyStore", person: "Participant") -> bool:
    from avrgym.study.people.participants import read_consent_text

    shown = read_consent_text(store, person)
    print_line(f"Consent, version {shown.version}\n\n{shown.text.strip()}\n")
    return confirm("Do you agree?")


def _ask_for_inclusion(store: "StudyStore", person: "Participant") -> None:
    from avrgym.study.people.participants import read_participant_texts, record_inclusion_answers

    participant, texts = person.pseudonym, read_participant_texts(store, person)
    answers = {question.id: confirm(texts.translate(question.text)) for question in store.design.inclusion}
    fits = record_inclusion_answers(store, participant, answers)
    log_command(store, "inclusion", participant)
    print_line(f"{participant} takes part" if fits else f"{participant} cannot take part")


@app.command()
def withdraw(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    reason: Annotated[str, typer.Option(help="The reason, without names.")] = "",
) -> None:
    """Withdraw a participant.

    A withdrawal is final. A running session of the participant ends within a second.
    """
    from avrgym.study.people.participants import withdraw_participant as end_participation
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        end_participation(store, participant, reason)
        log_command(store, "withdraw", participant)
    print_line(f"{participant} has withdrawn")


@app.command("confirm-participation")
def confirm_participation(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    evidence: Annotated[
        str, typer.Option(help="Evidence of the consent without names, such as a signed form and its place.")
    ],
) -> None:
    """Confirm participation after a database rebuild.

    After `study rebuild`, the state of some participants is unknown. Confirm each participant who consented and did not
    withdraw.
    """
    from avrgym.study.people.participants import confirm_participation as confirm_by
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        state = confirm_by(store, participant, evidence)
    print_line(f"{participant} is {state}; `check` and the report contain the experimenter's confirmation")


@app.command()
def simulate(
    folder: StudyFolderArgument,
    participants: Annotated[
        int, typer.Option(help="Number of simulated participants of the study.", min=1)
    ] = 8,
    seed: Annotated[int, typer.Option(help="Random seed. The same seed gives the same study.", min=0)] = 0,
    people: Annotated[str, typer.Option(help=f"The population: {ALLOWED_PEOPLE_TEXT}.")] = "participants",
    impairment: ImpairmentOption = "none",
    jobs: JobsOption = None,
    cluster: ClusterOption = None,
    json_file: JsonFileOption = None,
) -> None:
    """Simulate the sessions of participants.

    The sessions run in simulated time. If the command is repeated, it continues the earlier simulation.
    """
    from avrgym.study.checking.study_summary import summarise_study
    from avrgym.study.sessions.dry_run import simulate_study
    from avrgym.study.storage.remote_recordings import RecordingUploader
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with (
            connect_cluster(cluster, jobs) as workers,
            show_progress_bar("simulating", unit="trials", stopped=CONTINUE_HINT) as bar,
        ):
            simulate_study(folder, participants, seed, bar.update, jobs, people, impairment, workers)
        with StudyStore(folder) as store, RecordingUploader(store, print_warning):
            log_command(store, "simulate", detail=f"{participants} participants, seed {seed}")
            summary = summarise_study(store)
        write_json(json_file, asdict(summary))
    print_line(
        f"{summary.completed} of {summary.planned} planned participants completed, {summary.simulated} simulated"
    )


@app.command()
def check(
    folder: StudyFolderArgument,
    fix_permissions: Annotated[
        bool, typer.Option("--fix-permissions", help="Restrict the study's files to their owner.")
    ] = False,
    json_file: JsonFileOption = None,
) -> None:
    """Check a study before and during its sessions.

    The command loads all policies, and checks that stored data are complete and unchanged.
    """
    from avrgym.study.checking.database_checks import restrict_file_permissions as fix
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with StudyStore(folder) as store:
            if fix_permissions:
                fix(store)
                log_command(store, "fix permissions")
            findings = check_study_and_plan(store)
            head = store.database.read_chain_head()
        write_json(json_file, [asdict(finding) for finding in findings])
    for finding in findings:
        print_line(f"{'error' if finding.is_error else 'note '}  {finding.where}: {finding.message}")
    print_line(f"hash chain {head.number} entries, last digest {head.digest or 'none'}")
    errors = sum(finding.is_error for finding in findings)
    print_line(f"{errors} errors" if errors else "no errors")
    if errors:
        raise typer.Exit(1)


@app.command()
def rebuild(folder: StudyFolderArgument) -> None:
    """Rebuild a lost database from the recordings.

    The command also uses the participation list. It lists data that cannot be rebuilt. Names and recordings are not
    changed.
    """
    from avrgym.study.checking.database_rebuild import rebuild_study_database
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        rebuilt = rebuild_study_database(folder)
        with StudyStore(folder) as store:
            log_command(store, "rebuild")
    print_line(
        f"{rebuilt.participant_count} participants, {rebuilt.attempt_count} attempts, {rebuilt.answer_count} answers"
    )
    print_line(f"lost      {rebuilt.lost_data}")
    if rebuilt.unknown_participation_count:
        print_line(
            f"unknown   consent or withdrawal of {rebuilt.unknown_participation_count} participants: they are excluded "
            f"from analyses until "
            "you confirm each with `avrgym study confirm-participation`"
        )
    print_line(
        "marked    `check` and the report contain the rebuild of the database; it no longer proves the date of a plan"
    )
    for each in rebuilt.omission_messages:
        print_line(f"left out  {each}")


@app.command()
def export(
    folder: StudyFolderArgument,
    out: Annotated[Path, typer.Option(help="An empty or new folder for the export.")],
    data_format: Annotated[
        str, typer.Option("--format", help="Format of the export: csv, bids, hdf5, lerobot or minari.")
    ],
    skip_damaged: Annotated[
        bool,
        typer.Option("--skip-damaged", help="Omit damaged and missing recordings; left_out.csv lists them."),
    ] = False,
    free_text: Annotated[
        bool,
        typer.Option(
            "--free-text",
            help="Also export free text and names of experimenters. Read the text before you share it.",
        ),
    ] = False,
    health: Annotated[
        bool,
        typer.Option("--health-data", help="Also export answers about functioning and assistive devices."),
    ] = False,
    camera: Annotated[
        list[str] | None,
        typer.Option(
            help="For hdf5 and lerobot: images of a camera, such as wrist or scene:128x96:rgb+depth. Repeatable.",
        ),
    ] = None,
) -> None:
    """Export a study's data, pseudonymised.

    The export contains movements of head and hands, which can identify a person.
    """
    from avrgym.study.export import export_study
    from avrgym.study.export.event_tables import ExportOptions
    from avrgym.study.storage.store import StudyStore

    left_out: list[str] = []
    with (
        report_errors(),
        StudyStore(folder) as store,
        show_progress_bar("verifying recordings", unit="recordings") as bar,
    ):
        files = export_study(
            store,
            data_format,
            out,
            skip_damaged=skip_damaged,
            extras=ExportOptions(free_text, health),
            cameras=camera or (),
            progress=bar.update,
            report=left_out.append,
        )
        log_command(store, "export", detail=data_format, shows_results=True)
    for why in left_out:
        print_line(f"left out  {why}")
    print_line(f"{files} files in {out}. They are pseudonymised, not anonymous.")
    if free_text:
        print_line("They contain free text, which may contain names: read it before you share them.")


@app.command("delete-participant")
def delete_participant(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
) -> None:
    """Delete all data of a participant.

    The command deletes the participant's recordings, database rows and name. It also deletes all backups of the
    database, and the study's analysis.
    """
    from avrgym.study.people.participant_deletion import delete_participant as delete
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        delete(store, participant)
        log_command(store, "delete participant", participant)
    print_line(f"{participant} is deleted. Delete earlier exports and copies outside the study yourself.")
