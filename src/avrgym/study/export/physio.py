"""Export streams of other devices in BIDS: physiological signals, eye tracking, and text streams (event markers)."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.recording.schema import Event, Stream
from avrgym.recording.streams import (
    MessagesByTopic,
    SampleChunks,
    SampleTimes,
    collect_stream_chunks,
    collect_streams,
    correct_sample_times,
)

GAZE_STREAM_TYPE = "gaze"
"""Stream type of eye trackers in Lab Streaming Layer."""
GAZE_AXES = ("x", "y")
"""Last words of the channel labels of gaze coordinates."""
GAZE_COORDINATES = ("x_coordinate", "y_coordinate")
"""BIDS names of the gaze coordinates."""
EYE_TRACKING_FIELDS = {
    "PhysioType": "eyetrack",
    "RecordedEye": "cyclopean",
    "SampleCoordinateSystem": "custom",
    "SampleCoordinateSystemDescription": "As the device reports them; see the names of its channels.",
}
TIMESTAMP_FIELDS = {
    "Description": "Time of the sample, from the first tracking frame on; clocks are synchronised.",
    "Units": "s",
}
TIME_CORRECTION_NOTE = (
    "If the device's clock jumped, times are corrected by the arrival of samples. They never decrease."
)
"""Description of time corrections in the sidecar."""


@dataclass(frozen=True, eq=False)
class NumericStreamSamples:
    """Samples of one stream.

    ``sample_times_s``: times of samples (n,), from the first tracking frame. ``sample_values``: samples (n, columns).
    ``column_names``: column names. ``channel_labels`` and ``channel_units``: the device's channel names and units.
    ``time_corrections``: description of time corrections; empty without corrections.
    """

    stream: Stream
    column_names: Sequence[str]
    channel_labels: Sequence[str]
    channel_units: Sequence[str]
    sample_times_s: FloatArray
    sample_values: FloatArray
    time_corrections: Mapping[str, Any]

    def make_sample_rows(self) -> Iterator[list[float | None]]:
        """Yields time (s) and values of each sample; values that are not finite become ``None``."""
        for time_s, row in zip(self.sample_times_s.tolist(), self.sample_values.tolist(), strict=True):
            yield [time_s, *(value if isfinite(value) else None for value in row)]

    def make_sidecar(self) -> dict[str, Any]:
        """Returns the contents of the BIDS sidecar: the JSON file that describes the samples."""
        stream, lasted_s = self.stream, float(np.ptp(self.sample_times_s))
        came_hz = (len(self.sample_times_s) - 1) / lasted_s if lasted_s > 0.0 else 0.0
        is_gaze = tuple(self.column_names[:2]) == GAZE_COORDINATES
        about = {
            column: {"Description": f"{label} of {stream.device_name}", "Units": unit}
            for column, label, unit in zip(
                self.column_names, self.channel_labels, self.channel_units, strict=True
            )
        }
        return {
            "SamplingFrequency": stream.rate_hz or came_hz,
            "StartTime": float(self.sample_times_s[0]),
            "Columns": ["timestamp", *self.column_names],
            **(EYE_TRACKING_FIELDS if is_gaze else {"PhysioType": "generic"}),
            "ManufacturersModelName": stream.device_name,
            "Description": f"{stream.measurement_type} by Lab Streaming Layer.",
            "timestamp": {**TIMESTAMP_FIELDS, **self.time_corrections},
            **about,
        }


def read_numeric_stream_samples(topics: MessagesByTopic, start_s: float) -> Iterator[NumericStreamSamples]:
    """Yields the samples of each numeric stream of a recording. ``start_s``: time of the first tracking frame."""
    for name, stream in collect_streams(topics).items():
        chunks = [each for each in collect_stream_chunks(topics, name) if each[1].values]
        if chunks:
            values = np.concatenate([np.array(chunk.values, float) for _, chunk in chunks])
            yield _series(stream, correct_sample_times(chunks, stream.rate_hz), start_s, values)


def read_text_events(topics: MessagesByTopic) -> list[tuple[int, Event]]:
    """Returns the samples of text streams as events, with their times (ns). The event's name is the stream's name."""
    return [
        (round(time_s * 1e9), Event(name, ", ".join(texts)))
        for name, chunks in _text_chunks(topics)
        for time_s, texts in zip(
            correct_sample_times(chunks, 0.0).time_s,
            (row for _, chunk in chunks for row in chunk.texts),
            strict=True,
        )
    ]


def read_text_stream_time_corrections(topics: MessagesByTopic, start_s: float) -> dict[str, Any]:
    """Returns the time corrections of text streams, by stream name. Streams without corrections are omitted."""
    found = {
        name: describe_time_corrections(correct_sample_times(chunks, 0.0), start_s)
        for name, chunks in _text_chunks(topics)
    }
    return {name: each for name, each in found.items() if each}


def _text_chunks(topics: MessagesByTopic) -> Iterator[tuple[str, SampleChunks]]:
    for name in dict.fromkeys(chunk.stream_name for _, chunk in topics["/samples"] if chunk.texts):
        yield name, [each for each in collect_stream_chunks(topics, name) if each[1].texts]


def describe_time_corrections(times: SampleTimes, start_s: float) -> dict[str, Any]:
    """Returns the description of a stream's time corrections for the sidecar; empty without corrections."""
    if not times.clock_resets and not times.num_corrected_samples:
        return {}
    return {
        "Correction": TIME_CORRECTION_NOTE,
        "ClockResets": [
            {"Onset": reset.time_s - start_s, "JumpInSeconds": reset.jump_s} for reset in times.clock_resets
        ],
        "SamplesRaised": times.num_corrected_samples,
    }


def _series(stream: Stream, times: SampleTimes, start_s: float, values: FloatArray) -> NumericStreamSamples:
    """Returns the samples with columns in the device's order. Gaze coordinates are the first columns."""
    channels = range(values.shape[1])
    labels = [_at(stream.channels, channel, f"channel_{channel + 1}") for channel in channels]
    names = _column_names(labels)
    column_order: list[int] = list(channels)
    if stream.measurement_type.lower() == GAZE_STREAM_TYPE:
        first = [next((i for i in column_order if _ends_with(labels[i], axis)), None) for axis in GAZE_AXES]
        if None not in first:
            column_order = [
                *(i for i in first if i is not None),
                *(i for i in column_order if i not in first),
            ]
            names = {**names, **dict(zip(column_order, GAZE_COORDINATES, strict=False))}
    return NumericStreamSamples(
        stream,
        [names[i] for i in column_order],
        [labels[i] for i in column_order],
        [_at(stream.units, i, "n/a") for i in column_order],
        times.time_s - start_s,
        values[:, column_order],
        describe_time_corrections(times, start_s),
    )


def _column_names(labels: Sequence[str]) -> dict[int, str]:
    """Returns a unique column name for each channel, by channel number.

    The name contains the letters and digits of the channel's label. Duplicates get a number.
    """
    names: dict[int, str] = {}
    for number, label in enumerate(labels):
        name = re.sub(r"[^A-Za-z0-9]+", "_", label).strip("_").lower() or f"channel_{number + 1}"
        taken = name in names.values() or name in ("timestamp", *GAZE_COORDINATES)
        names[number] = f"{name}_{number + 1}" if taken else name
    return names


def _ends_with(label: str, axis: str) -> bool:
    """Returns whether the last word of a channel's label is the axis. A unit in brackets is ignored."""
    words = re.findall(r"[a-z0-9]+", re.sub(r"[\[(].*", "", label.lower()))
    return bool(words) and words[-1] == axis


def _at(texts: Sequence[str], place: int, otherwise: str) -> str:
    return (texts[place] if place < len(texts) else "") or otherwise
