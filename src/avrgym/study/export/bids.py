"""Export a study in BIDS with its motion extension (https://bids-specification.readthedocs.io, version 1.11).

Each completed trial is a run. A run contains the tracked poses of head and hands, a LATENCY channel, events, and
samples of other devices. The session's scans file has a row for each run. Answers are in ``phenotype``, with a column
for each condition and item.
"""

import gzip
import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.recording.schema import Event, Pose, TrackingFrame
from avrgym.study.export import OMITTED_RECORDINGS_FILE, PRIVACY_NOTICE
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.event_tables import (
    DEFAULT_EXPORT_OPTIONS,
    ExportOptions,
    make_event_and_note_tables,
    write_table,
)
from avrgym.study.export.exported_attempts import ExportedAttempt
from avrgym.study.export.physio import (
    NumericStreamSamples,
    read_numeric_stream_samples,
    read_text_events,
    read_text_stream_time_corrections,
)
from avrgym.study.export.table_files import format_tsv_cell, write_json, write_tsv
from avrgym.study.storage.answers import find_answer_moments
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.store import StudyStore

BIDS_VERSION = "1.11.1"
TRACKED_POINTS = {"head": "head", "left": "left_hand", "right": "right_hand"}
"""BIDS names of the tracked points, by field of ``TrackingFrame``."""
SOURCE_DATA_FOLDER = "sourcedata"
"""Folder for events, adverse events and notes. BIDS does not define its contents."""
POSITION_AXES = ("x", "y", "z")
QUATERNION_COMPONENTS = ("quat_x", "quat_y", "quat_z", "quat_w")
REFERENCE_FRAME = "local_floor"
"""Name of the reference frame of all poses."""
TRACKING_SYSTEM = "headset"
"""Name of the tracking system in BIDS file names (``tracksys-headset``)."""
CONDITION_COLUMN_MEANINGS = {
    name: COLUMNS_BY_TABLE["attempts"][name].meaning
    for name in ("simulated", "practice", "task", "robot", "policy", "reward", "success")
}
"""Columns of the scans file that describe a trial, with their descriptions."""


def write(
    store: StudyStore,
    completed: Sequence[ExportedAttempt],
    folder: Path,
    extras: ExportOptions = DEFAULT_EXPORT_OPTIONS,
) -> None:
    """Write completed attempts as a BIDS dataset into a folder."""
    write_json(folder / "dataset_description.json", _description(store))
    (folder / "README").write_text(f"{store.design.title}\n\n{PRIVACY_NOTICE}\n", encoding="utf-8")
    (folder / ".bidsignore").write_text(f"{OMITTED_RECORDINGS_FILE}\n", encoding="utf-8")
    _write_participants(store, completed, folder)
    for _, session in groupby(completed, key=lambda exported: exported.session.id):
        _write_session(list(session), folder)
    _write_answers(store, completed, folder / "phenotype")
    (folder / SOURCE_DATA_FOLDER).mkdir()
    for name, rows in make_event_and_note_tables(store, extras).items():
        write_table(folder / SOURCE_DATA_FOLDER, name, rows)


def _description(store: StudyStore) -> dict[str, Any]:
    return {
        "Name": store.design.title,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "GeneratedBy": [{"Name": "AVR Gym"}],
        "Acknowledgements": PRIVACY_NOTICE,
    }


def _write_participants(store: StudyStore, attempts: Sequence[ExportedAttempt], folder: Path) -> None:
    present = {exported.participant.number for exported in attempts}
    rows = [
        {
            "participant_id": participant.pseudonym,
            "age": participant.age_years,
            "sex": {"man": "male", "woman": "female"}[participant.sex],
            "language": participant.language or store.design.languages[0],
            "site": participant.site,
            "simulated": participant.simulated,
        }
        for participant in store.read_participants()
        if participant.number in present
    ]
    _write_table(folder / "participants.tsv", rows)
    write_json(
        folder / "participants.json",
        {
            "age": {"Description": COLUMNS_BY_TABLE["participants"]["age_years"].meaning, "Units": "year"},
            **{
                name: {"Description": COLUMNS_BY_TABLE["participants"][name].meaning}
                for name in ("sex", "language", "site", "simulated")
            },
        },
    )


def _write_session(attempts: list[ExportedAttempt], folder: Path) -> None:
    first = attempts[0]
    prefix = f"{first.participant.pseudonym}_{first.session.name}"
    place = folder / first.participant.pseudonym / first.session.name
    (place / "motion").mkdir(parents=True)
    for exported in attempts:
        _write_run(exported, place / "motion")
    _write_table(place / f"{prefix}_scans.tsv", [_scan(exported) for exported in attempts])
    write_json(
        place / f"{prefix}_scans.json",
        {name: {"Description": description} for name, description in CONDITION_COLUMN_MEANINGS.items()},
    )


def _scan(exported: ExportedAttempt) -> dict[str, Any]:
    metrics = exported.attempt.metrics
    labels = exported.make_identifiers()
    moment = exported.attempt.started_at.removesuffix("+00:00")
    return {
        "filename": f"motion/{_run_name(exported)}_motion.tsv",
        "acq_time": f"{moment}Z",
        "simulated": labels.simulated,
        "practice": labels.practice,
        "task": labels.task,
        "robot": labels.robot,
        "policy": labels.policy,
        "reward": metrics.reward,
        "success": metrics.success,
    }


def _run_name(exported: ExportedAttempt) -> str:
    return (
        f"{exported.participant.pseudonym}_{exported.session.name}_task-{exported.trial.task}"
        f"_tracksys-{TRACKING_SYSTEM}_run-{exported.trial.position:02}"
    )


def _write_run(exported: ExportedAttempt, folder: Path) -> None:
    name = _run_name(exported)
    topics = exported.read_complete_recording().messages_by_topic
    frames = [frame for _, frame in topics["/tracking"]]
    channels = list(_channels())
    write_tsv(folder / f"{name}_motion.tsv", [_row(frame, frames[0]) for frame in frames])
    _write_table(folder / f"{name}_channels.tsv", channels)
    write_json(folder / f"{name}_channels.json", _reference_frame())
    write_json(folder / f"{name}_motion.json", _sidecar(exported, frames, len(channels)))
    start_s = frames[0].received_time_s if frames else 0.0
    events = [*topics["/events"], *read_text_events(topics)]
    _write_events(
        events, start_s, folder / f"{name}_events", read_text_stream_time_corrections(topics, start_s)
    )
    for series in read_numeric_stream_samples(topics, start_s):
        _write_series(series, exported, folder / f"{name}_recording-{series.stream.name}_physio")


def _write_series(series: NumericStreamSamples, exported: ExportedAttempt, path: Path) -> None:
    """Write samples as gzip, and their JSON sidecar. The gzip file has no date, so equal studies give equal bytes."""
    lines = ("\t".join(format_tsv_cell(value) for value in row) + "\n" for row in series.make_sample_rows())
    data = gzip.compress("".join(lines).encode(), mtime=0)
    path.with_suffix(".tsv.gz").write_bytes(data)
    write_json(path.with_suffix(".json"), {"TaskName": exported.trial.task, **series.make_sidecar()})


def _write_events(
    events: Sequence[tuple[int, Event]], start_s: float, path: Path, corrected: Mapping[str, Any]
) -> None:
    """Write events with onsets from the first tracking frame. ``corrected``: time corrections of text streams."""
    rows = [
        {"onset": time_ns / 1e9 - start_s, "duration": None, "trial_type": event.name, "detail": event.detail}
        for time_ns, event in sorted(events, key=lambda timed: timed[0])
    ]
    if rows:
        _write_table(path.with_suffix(".tsv"), rows)
        about: dict[str, Any] = {"detail": {"Description": "More about the event."}}
        if corrected:
            about["onset"] = {
                "Description": "Onset from the first tracking frame on.",
                "Units": "s",
                **corrected,
            }
        write_json(path.with_suffix(".json"), about)


def _channels() -> Iterator[dict[str, Any]]:
    yield _channel("latency", "n/a", "LATENCY", "n/a", "s", "n/a")
    for point in TRACKED_POINTS.values():
        for axis in POSITION_AXES:
            yield _channel(f"{point}_{axis}", axis, "POS", point, "m", REFERENCE_FRAME)
        for component in QUATERNION_COMPONENTS:
            yield _channel(f"{point}_{component}", component, "ORNT", point, "n/a", REFERENCE_FRAME)
        yield _channel(f"{point}_followed", "n/a", "MISC", point, "n/a", "n/a")


def _channel(
    name: str, component: str, kind: str, point: str, units: str, reference_frame: str
) -> dict[str, str]:
    return {
        "name": name,
        "component": component,
        "type": kind,
        "tracked_point": point,
        "units": units,
        "reference_frame": reference_frame,
    }


def _reference_frame() -> dict[str, Any]:
    frame = {
        "SpatialAxes": "RSP",
        "RotationRule": "right-hand",
        "Description": "WebXR's local-floor space: origin on the floor, x right, y up, z backward.",
    }
    return {"reference_frame": {"Levels": {REFERENCE_FRAME: frame}}}


def _sidecar(exported: ExportedAttempt, frames: Sequence[TrackingFrame], channels: int) -> dict[str, Any]:
    duration_s = frames[-1].received_time_s - frames[0].received_time_s if frames else 0.0
    rate_hz = (len(frames) - 1) / duration_s if duration_s > 0 else 0.0
    points = len(TRACKED_POINTS)
    return {
        "TaskName": exported.trial.task,
        "TaskDescription": f"A virtual {exported.trial.robot} helps the participant: {exported.trial.task}.",
        "SamplingFrequency": rate_hz,
        "SamplingFrequencyEffective": rate_hz,
        "RecordingDuration": duration_s,
        "TrackingSystemName": TRACKING_SYSTEM,
        "TrackedPointsCount": points,
        "MotionChannelCount": channels,
        "POSChannelCount": points * len(POSITION_AXES),
        "ORNTChannelCount": points * len(QUATERNION_COMPONENTS),
        "LATENCYChannelCount": 1,
        "MISCChannelCount": points,
        "MissingValues": "n/a",
        "Simulated": exported.participant.simulated,
    }


def _row(frame: TrackingFrame, first: TrackingFrame) -> list[float | None]:
    row: list[float | None] = [frame.received_time_s - first.received_time_s]
    for field in TRACKED_POINTS:
        pose: Pose | None = getattr(frame, field)
        row += (
            [*pose.position, *pose.orientation]
            if pose
            else [None] * (len(POSITION_AXES) + len(QUATERNION_COMPONENTS))
        )
        row.append(float(_is_followed(frame, field)))
    return row


def _is_followed(frame: TrackingFrame, field: str) -> bool:
    """Returns whether the person model used the tracked pose of a body part: not untracked, stale or rejected."""
    return not (frame.rejected or field in frame.rejected_parts or field in frame.untracked_parts)


def _write_answers(store: StudyStore, attempts: Sequence[ExportedAttempt], folder: Path) -> None:
    folder.mkdir()
    answered_items = AnsweredItems(store)
    for questionnaire in answered_items.design.questionnaires:
        items = {item.id: item for item in questionnaire.items}
        rows, item_by_column = _rows_of_answers(store, attempts, questionnaire, answered_items)
        if not item_by_column:
            continue
        columns, name = ["participant_id", "simulated", *item_by_column], _label(questionnaire.name)
        _write_table(folder / f"{name}.tsv", [{c: row.get(c) for c in columns} for row in rows])
        described = {column: _describe(questionnaire, items[item]) for column, item in item_by_column.items()}
        described["simulated"] = {"Description": CONDITION_COLUMN_MEANINGS["simulated"]}
        write_json(folder / f"{name}.json", described)
    if not any(folder.iterdir()):
        folder.rmdir()


def _describe(questionnaire: Questionnaire, item: Item) -> dict[str, Any]:
    scale = questionnaire.find_response_scale(item)
    between = [f"{value}, from {scale.lowest_value} to {scale.highest_value}" for value in scale.values[1:-1]]
    words = item.labels or (item.low, *between, item.high)
    return {
        "Description": item.text,
        "Levels": {str(value): said for value, said in zip(scale.values, words, strict=True)},
    }


def _label(name: str) -> str:
    """Returns the name of an item or questionnaire without characters that are invalid in file names."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")


def _rows_of_answers(
    store: StudyStore,
    attempts: Sequence[ExportedAttempt],
    questionnaire: Questionnaire,
    answered_items: AnsweredItems,
) -> tuple[list[dict[str, Any]], dict[str, str]]:
    """Returns one row for each participant, and the item id of each column.

    A row has a column for each item and condition, or for each item and session.
    """
    rows: list[dict[str, Any]] = []
    item_by_column: dict[str, str] = {}
    scales = {item.id: questionnaire.find_response_scale(item) for item in questionnaire.items}
    people = {person.number: person for person in store.read_participants()}
    for number, own in groupby(attempts, key=lambda exported: exported.participant.number):
        about = {e.attempt.id: f"{e.trial.task}_{e.trial.robot}_{e.trial.policy}" for e in own}
        participant = people[number]
        sessions = {session.id: session.name for session in store.read_sessions(participant.pseudonym)}
        row: dict[str, Any] = {"participant_id": participant.pseudonym, "simulated": participant.simulated}
        answers = store.read_answers(participant.pseudonym)
        moments = find_answer_moments(store.design, answers, store.read_session_events(participant.pseudonym))
        for answer in answers:
            item = answered_items.find_item(answer).id
            if item not in scales or (answer.attempt is not None and answer.attempt not in about):
                continue
            session = f"{sessions[answer.session]}_{moments[answer.id]}"
            column = f"{session if answer.attempt is None else about[answer.attempt]}_{_label(item)}"
            row[column], item_by_column[column] = scales[item].compute_option_value(answer.value), item
        rows.append(row)
    return rows, item_by_column


def _write_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    names = list(rows[0]) if rows else []
    write_tsv(path, [names, *(list(row.values()) for row in rows)])
