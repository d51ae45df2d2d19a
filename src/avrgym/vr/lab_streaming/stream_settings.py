"""Selects the streams that a session sends and receives with Lab Streaming Layer."""

import re
from collections.abc import Mapping, Sequence

import msgspec

STREAM_NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z0-9]{0,39}")
"""Pattern of allowed stream names. File names contain these names."""
STREAM_QUERY_PATTERN = re.compile(
    r"{one}( and {one})*".format(one=r"(name|type|source_id|hostname)='[^'<>&\"]{1,80}'")
)
"""Pattern of allowed queries for streams, see ``STREAM_QUERY_HELP``."""
STREAM_QUERY_HELP = "name='…', type='…', source_id='…' or hostname='…', several of them joined by \"and\""


class StreamSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The streams that a session sends and receives with Lab Streaming Layer.

    ``send``: whether to send events, poses and forces. ``receive``: the query of each received stream, by stream name.
    """

    send: bool = False
    receive: Mapping[str, str] = {}


def find_stream_error(name: str, query: str) -> str:
    """Returns an error message with the allowed values for a stream's name or query; empty if both are valid."""
    if not STREAM_NAME_PATTERN.fullmatch(name):
        return f"{name!r} is not a valid stream name; allowed: a letter, then up to 39 letters and digits"
    return (
        ""
        if STREAM_QUERY_PATTERN.fullmatch(query)
        else f"{query!r} is not a valid stream query; allowed: {STREAM_QUERY_HELP}"
    )


def parse_stream_options(send: bool, received: Sequence[str]) -> StreamSettings:
    """Returns the streams of the command-line options. Raises ``ValueError`` if an option is not ``NAME=QUERY``."""
    receive = dict(_named(each) for each in received)
    return StreamSettings(send, receive)


def _named(option: str) -> tuple[str, str]:
    name, _, query = option.partition("=")
    fault = find_stream_error(name, query)
    if fault:
        raise ValueError(f"--receive {option}: {fault}, as in --receive \"heart=type='ECG'\"")
    return name, query
