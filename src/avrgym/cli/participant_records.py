"""The commands of ``avrgym study`` about adverse events, retention periods and the data of one participant."""

from dataclasses import asdict
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.cli.audit_log import log_command
from avrgym.cli.participant_names import unlock_identity_file
from avrgym.cli.plan import StudyFolderArgument
from avrgym.cli.terminal import (
    JsonFileOption,
    check_json_file,
    print_line,
    print_table,
    report_errors,
    write_json,
)
from avrgym.commands.input_methods import INPUT_METHODS, STOP_INPUTS
from avrgym.commands.respondents import PARTICIPANT_RESPONDENTS

if TYPE_CHECKING:
    from avrgym.study.storage.store import StudyStore

PseudonymArgument = Annotated[str, typer.Argument(help="A pseudonym such as sub-001.")]
REQUIRED_REPORT_FIELDS = ("description", "severity", "seriousness", "relatedness", "outcome")
"""Required fields of a report. A follow-up copies missing fields from the latest report of the adverse event."""


def record_adverse_event(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    description: Annotated[str | None, typer.Option(help="What happened, without names.")] = None,
    severity: Annotated[
        str | None, typer.Option(help="Severity (CTCAE): mild, moderate, severe, life-threatening or fatal.")
    ] = None,
    seriousness: Annotated[
        str | None,
        typer.Option(
            help="Seriousness (ICH E2A): 'not serious', 'other medically important', 'congenital anomaly', disability, "
            "hospitalisation, life-threatening or death."
        ),
    ] = None,
    relatedness: Annotated[
        str | None,
        typer.Option(help="Relation to the study: unrelated, unlikely, possible, probable or definite."),
    ] = None,
    outcome: Annotated[
        str | None,
        typer.Option(
            help="Outcome: recovered, recovering, 'not recovered', 'recovered with sequelae', fatal or unknown."
        ),
    ] = None,
    action: Annotated[str | None, typer.Option(help="The action that was taken.")] = None,
    trial: Annotated[
        int | None, typer.Option(help="The position of the trial in which the event began.")
    ] = None,
    began: Annotated[
        datetime | None, typer.Option(help="Start of the event, in this computer's time zone; default: now.")
    ] = None,
    follow_up: Annotated[
        int | None,
        typer.Option(
            "--follow-up", help="For a follow-up: the number of the adverse event.", metavar="EVENT"
        ),
    ] = None,
    by: Annotated[
        str, typer.Option(help="The person who records the event; default: the account of this computer.")
    ] = "",
) -> None:
    """Record an adverse event or its follow-up.

    A follow-up needs only the changed fields. Earlier reports are not changed.
    """
    from avrgym.study.people import adverse_events
    from avrgym.study.storage.audit_log import find_process_user
    from avrgym.study.storage.store import StudyStore

    stated = {
        "description": description,
        "severity": severity,
        "seriousness": seriousness,
        "relatedness": relatedness,
        "outcome": outcome,
        "action": action,
        "trial": trial,
        "began_at": None if began is None else began.astimezone().isoformat(),
    }
    given: dict[str, Any] = {name: value for name, value in stated.items() if value is not None}
    with report_errors(), StudyStore(folder) as store:
        report = adverse_events.AdverseEventDetails(**_as_known(store, participant, follow_up) | given)
        number = adverse_events.record_adverse_event(
            store, participant, report, follows=follow_up, recorded_by=by or find_process_user().name
        )
        log_command(store, "record adverse event", participant)
    if follow_up is None:
        print_line(f"recorded  adverse event {number} of {participant}")
    else:
        print_line(f"recorded  a follow-up of adverse event {follow_up} of {participant}")


def _as_known(store: "StudyStore", participant: str, event: int | None) -> dict[str, Any]:
    """Returns default values for the fields of an adverse event report.

    For a follow-up (``event`` is a number): the fields of the event's latest report. For a new event: the current time.
    """
    from avrgym.study.people.adverse_events import group_reports_by_event
    from avrgym.study.storage.schema import make_utc_timestamp

    if event is None:
        return {"began_at": make_utc_timestamp(), **dict.fromkeys(REQUIRED_REPORT_FIELDS, "")}
    latest = next(
        (
            each.latest_report
            for each in group_reports_by_event(store.read_adverse_event_reports(participant))
            if each.event_number == event
        ),
        None,
    )
    if latest is None:
        raise ValueError(
            f"{participant} has no adverse event {event}; `avrgym study adverse-events` lists them"
        )
    positions = {each.id: each.position for each in store.read_trials(participant)}
    known = {name: getattr(latest, name) for name in (*REQUIRED_REPORT_FIELDS, "action", "began_at")}
    return known | {"trial": positions.get(latest.trial or 0)}


def adverse_events(
    folder: StudyFolderArgument,
    out: Annotated[
        Path | None,
        typer.Option(help="A new folder for all reports as TSV, with descriptions, names and a codebook."),
    ] = None,
    json_file: JsonFileOption = None,
) -> None:
    """List adverse events and safety events.

    The first table lists each adverse event with its latest follow-up. The second table lists stops, interventions and
    forces that sessions recorded.
    """
    from avrgym.study.export.event_tables import ExportOptions, make_adverse_event_rows, write_adverse_events
    from avrgym.study.people.adverse_events import ADVERSE_EVENT_SCALE_SOURCES, list_safety_events
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with StudyStore(folder) as store:
            rows = [
                vars(row)
                for row in make_adverse_event_rows(
                    store, store.read_participants(), ExportOptions(include_free_text=True)
                )
            ]
            noticed = [
                {"participant": person.pseudonym, **asdict(each)}
                for person in store.read_participants()
                for each in list_safety_events(store, person.pseudonym)
            ]
            if out is not None:
                write_adverse_events(store, out)
                log_command(store, "export", detail="adverse events")
        write_json(json_file, {"adverse_events": rows, "safety_events": noticed})
    latest = {row["event"]: row for row in rows}
    print_line(f"{len(latest)} adverse events" if latest else "No adverse events were recorded.")
    if latest:
        shown = ("event", "report", "participant", "began_at", "position", "severity", "seriousness")
        more = ("relatedness", "outcome", "description")
        print_table([{name: row[name] for name in (*shown, *more)} for row in latest.values()])
        print_line(ADVERSE_EVENT_SCALE_SOURCES)
    if noticed:
        print_line("Safety events that sessions reported; record those that are adverse events:")
        print_table(noticed)
    if out is not None:
        print_line(f"reports   {out}: they contain free text and names of experimenters")


def retention(
    folder: StudyFolderArgument,
    delete: Annotated[
        bool,
        typer.Option(
            "--delete",
            help="Delete data after their retention period. Without this option, nothing is deleted.",
        ),
    ] = False,
    json_file: JsonFileOption = None,
) -> None:
    """List data after their retention period.

    The periods are in [retention] of study.toml. With --delete, due data are deleted, and each deletion is logged. Run
    the command with --delete daily by cron or systemd.
    """
    from avrgym.study.people.retention import (
        DATA_KIND_LABELS,
        delete_due_data,
        describe_due_deletions,
        list_scheduled_deletions,
        today_utc,
    )
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        check_json_file(json_file)
        with StudyStore(folder) as store:
            day = today_utc()
            rows = [
                {
                    "data": DATA_KIND_LABELS[each.data_kind],
                    "due_on": each.due_date.isoformat(),
                    "due": each.is_due(day),
                    "participants": list(each.pseudonyms),
                }
                for each in list_scheduled_deletions(store)
            ]
            write_json(json_file, rows)
            if rows:
                print_table(rows)
            else:
                print_line(
                    "No data have a retention period: set periods and ended_on in [retention] of study.toml."
                )
            if not delete:
                for words in describe_due_deletions(store, day):
                    print_line(f"due       {words}")
                return
            for what, pseudonym in delete_due_data(store, day):
                log_command(store, "delete by schedule", pseudonym, detail=DATA_KIND_LABELS[what])
                print_line(f"deleted   {DATA_KIND_LABELS[what]} of {pseudonym}")


def participant_data(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    out: Annotated[Path, typer.Option(help="A new ZIP archive.", metavar="FILE.zip")],
) -> None:
    """Write all data of one participant to an archive.

    A participant can request their data. The archive contains an index, recordings, notes and the name.
    """
    from avrgym.study.export.participant_archive import write_participant_archive
    from avrgym.study.storage.identity_file import read_pseudonyms_with_identity
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        unlock_identity_file(folder)
        number = write_participant_archive(store, participant, out)
        log_command(store, "export", participant, detail="data of the participant")
        is_named, sites = participant in read_pseudonyms_with_identity(store.folder), store.read_sites()
    if is_named:
        print_line(f"{number} files in {out}, with name, contact and free text.")
    else:
        where = "names are in the studies of the sites" if sites else "the identity file has none"
        print_line(f"{number} files in {out}, with free text and without name and contact: {where}.")
    print_line("Search notes and descriptions for names of other people before you hand over the archive.")


def data_protection(folder: StudyFolderArgument) -> None:
    """Draft data protection documents.

    The documents are an impact assessment and a record of processing (GDPR, Articles 35 and 30). Known entries are
    filled in from the design. Your own entries are never overwritten.
    """
    from avrgym.study.plan.data_protection import write_data_protection_drafts
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        for path in write_data_protection_drafts(store):
            print_line(f"draft     {path}")


def change_input(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    method: Annotated[str | None, typer.Option(help=f"The input method: {', '.join(INPUT_METHODS)}.")] = None,
    dwell: Annotated[
        float | None, typer.Option("--dwell", help="Dwell time of the method head in seconds: 0.5 to 3.")
    ] = None,
    scan: Annotated[
        float | None,
        typer.Option("--scan", help="Time per target of the method one-switch in seconds: 0.5 to 10."),
    ] = None,
    select_key: Annotated[
        str | None, typer.Option(help="The key that selects with the method two-switches.")
    ] = None,
    resting_arm: Annotated[
        list[str] | None, typer.Option(help="An arm that does not move: left or right; repeatable.")
    ] = None,
    absent_arm: Annotated[
        list[str] | None, typer.Option(help="An absent (amputated) arm: left or right; repeatable.")
    ] = None,
    stop: Annotated[
        list[str] | None, typer.Option(help=f"The stop method: {', '.join(STOP_INPUTS)}; repeatable.")
    ] = None,
    text: Annotated[
        float | None, typer.Option("--text", help="Font size of items in VR in degrees: 1 to 3.")
    ] = None,
    panel_distance: Annotated[
        float | None,
        typer.Option("--panel-distance", help="Distance of the panel from the eyes in metres: 0.75 to 2."),
    ] = None,
    contrast: Annotated[str | None, typer.Option(help="Contrast: normal or high.")] = None,
    position: Annotated[
        str | None, typer.Option(help="Position of the panel: left, centre or right.")
    ] = None,
    reduced_motion: Annotated[bool | None, typer.Option(help="Move scene and dwell ring in steps.")] = None,
    read_aloud: Annotated[bool | None, typer.Option(help="Read texts aloud.")] = None,
    captions: Annotated[bool | None, typer.Option(help="Show a caption for each sound.")] = None,
) -> None:
    """Show or change a participant's input profile.

    Values of options that are not given do not change. A new input method has its own default stop method. During a
    session, use the dashboard instead.
    """
    import msgspec

    from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE
    from avrgym.study.people.input_profiles import make_input_profile, set_input_profile
    from avrgym.study.storage.store import StudyStore

    options = {
        "method": method,
        "dwell_s": dwell,
        "scan_s": scan,
        "select_key": select_key,
        "resting_arms": resting_arm,
        "absent_arms": absent_arm,
        "stops": stop,
    }
    presentation = {
        "text_deg": text,
        "panel_distance_m": panel_distance,
        "contrast": contrast,
        "position": position,
        "reduced_motion": reduced_motion,
        "read_aloud": read_aloud,
        "captions": captions,
    }
    given: dict[str, Any] = {name: value for name, value in options.items() if value is not None}
    presented = {name: value for name, value in presentation.items() if value is not None}
    with report_errors(), StudyStore(folder) as store:
        before = store.read_participant(participant).input_profile or DEFAULT_INPUT_PROFILE
        if presented:
            given["presentation"] = msgspec.structs.asdict(before.presentation) | presented
        known = {name: getattr(before, name) for name in before.__struct_fields__}
        if method is not None and method != before.method:
            known["stops"] = None
        profile = make_input_profile(known | given)
        if given:
            set_input_profile(store, participant, profile)
            log_command(store, "change input", participant)
    print_line(f"{participant}  {profile.describe()}")


def functioning(folder: StudyFolderArgument, participant: PseudonymArgument) -> None:
    """Ask about functioning, devices and diagnosis.

    The study's design must enable these questions. A participant can decline each question. New answers replace earlier
    answers.
    """
    from avrgym.study.design.functioning import (
        ASSISTIVE_DEVICES,
        ASSISTIVE_DEVICES_QUESTION,
        DIAGNOSIS_QUESTION,
        DIFFICULTY_LEVELS,
        FUNCTIONING_QUESTIONS,
    )
    from avrgym.study.people.functioning import FunctioningAnswers, record_functioning_answers
    from avrgym.study.people.participants import read_participant_texts
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        texts = read_participant_texts(store, store.read_participant(participant))
        levels: dict[str, str] = {}
        for question, text in FUNCTIONING_QUESTIONS.items():
            print_line(texts.translate(text))
            for key, word in DIFFICULTY_LEVELS.items():
                print_line(f"  {key}: {texts.translate(word)}")
            levels[question] = typer.prompt(question)
        print_line(texts.translate(ASSISTIVE_DEVICES_QUESTION))
        for key, word in ASSISTIVE_DEVICES.items():
            print_line(f"  {key}: {texts.translate(word)}")
        devices = typer.prompt("numbers, separated by commas", default="", show_default=False)
        diagnosis = typer.prompt(texts.translate(DIAGNOSIS_QUESTION), default="", show_default=False)
        named = tuple(each.strip() for each in devices.split(",") if each.strip())
        record_functioning_answers(store, participant, FunctioningAnswers(levels, named, diagnosis))
        log_command(store, "record functioning", participant)
    print_line(f"{participant}: the answers are stored")


def preferences(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a preference, for example speed=0.5.", metavar="NAME=VALUE"),
    ] = None,
) -> None:
    """Show or change a participant's preferences.

    Preferences are speed, distance_m, side, bite_timing, pause_s, force_share, commands and sources. Thresholds of
    gestures are swing_deg, swings, gaze_deg and gaze_s. All of them apply in conditions with preferences = true in
    study.toml.
    """
    from avrgym.commands.preferences import Preferences, change_preferences, describe_preferences
    from avrgym.study.people.participants import read_participant_texts
    from avrgym.study.people.preferences import read_latest_preferences, record_preferences
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        texts = read_participant_texts(store, store.read_participant(participant))
        own = read_latest_preferences(store, participant) or Preferences()
        if change:
            own = change_preferences(own, change)
            record_preferences(store, participant, own)
            log_command(store, "record preferences", participant)
    print_line(describe_preferences(own, texts.language))


def respondent(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    who: Annotated[str, typer.Argument(help=f"{' or '.join(PARTICIPANT_RESPONDENTS)}.", metavar="WHO")],
) -> None:
    """Set the respondent of all later questions.

    The participant or a proxy can answer. Answers of a proxy are marked in all tables, figures and exports.
    """
    from avrgym.study.people.participant_respondents import set_respondent
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        set_respondent(store, participant, who)
        log_command(store, "change respondent", participant, detail=who)
    print_line(f"{participant}  questions are answered by: {who}")


def own_furniture(
    folder: StudyFolderArgument,
    participant: PseudonymArgument,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a dimension, such as seat_height_m=0.52.", metavar="NAME=VALUE"),
    ] = None,
) -> None:
    """Show or store a participant's own furniture.

    In all later sessions of the participant, these dimensions replace those of study.toml and of the station. The names
    of dimensions are those of [furniture] in study.toml.
    """
    from msgspec.structs import asdict

    from avrgym.models.furniture.real_furniture import FURNITURE_MEASURE_RANGES, change_furniture
    from avrgym.study.people.furniture import read_own_furniture, record_own_furniture
    from avrgym.study.storage.store import StudyStore

    with report_errors(), StudyStore(folder) as store:
        store.read_participant(participant)
        own = read_own_furniture(store, participant) or store.design.furniture
        values: dict[str, float] = {}
        for each in change or ():
            name, _, text = (part.strip() for part in each.partition("="))
            if name not in FURNITURE_MEASURE_RANGES:
                raise RuntimeError(
                    f"unknown dimension {name!r}; allowed: {', '.join(FURNITURE_MEASURE_RANGES)}"
                )
            try:
                values[name] = float(text)
            except ValueError:
                raise RuntimeError(f"{each!r} has no number; allowed: {name}=0.5 or another number") from None
        if values:
            own = change_furniture(own, **values)
            record_own_furniture(store, participant, own)
            log_command(store, "measure furniture", participant)
    print_line(f"{participant}  {', '.join(f'{name} {value:g}' for name, value in asdict(own).items())}")
