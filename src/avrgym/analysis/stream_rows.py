"""The rows of the analysis' table of other devices' streams."""

from dataclasses import dataclass

from avrgym.recording.streams import StreamFigures


@dataclass(frozen=True, kw_only=True)
class StreamRow(StreamFigures):
    """How well the samples of a stream lie in time in the recording of one completed trial."""

    participant: str
    site: str | None = None
    simulated: bool
    position: int
