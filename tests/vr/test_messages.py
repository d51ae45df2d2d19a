"""The protocol: every message is decoded as it was encoded, and the client's types are current."""

import subprocess
import sys

import msgspec
import pytest

import write_typescript
from avrgym.vr.protocol import messages

EXAMPLES = write_typescript.example_messages()
FROM_CLIENT, FROM_SERVER = EXAMPLES["ParticipantMessage"], EXAMPLES["ServerMessage"]
FROM_EXPERIMENTER = EXAMPLES["WatcherMessage"]
"""The first is the hello, which every client says."""
DECODERS = {
    "ParticipantMessage": messages.decode_participant_message,
    "WatcherMessage": messages.decode_watcher_message,
    "ServerMessage": messages.decode_server_message,
}


def tag(message: messages.Message) -> str:
    return str(message.__struct_config__.tag)


FROM_BOTH = {tag(m) for m in FROM_CLIENT} & {tag(m) for m in FROM_EXPERIMENTER}
WRONG_WAY = [(messages.decode_server_message, m) for m in FROM_CLIENT] + [
    (messages.decode_participant_message, m)
    for m in (*FROM_SERVER, *FROM_EXPERIMENTER)
    if tag(m) not in FROM_BOTH
]


def name(value: object) -> str:
    return getattr(value, "__name__", type(value).__name__)


@pytest.mark.parametrize(
    ("union", "message"), [(union, m) for union, group in EXAMPLES.items() for m in group], ids=name
)
def test_round_trip(union, message):
    assert DECODERS[union](messages.encode_message(message)) == message


@pytest.mark.parametrize(("decode", "message"), WRONG_WAY, ids=name)
def test_messages_of_the_other_side_are_refused(decode, message):
    with pytest.raises(msgspec.DecodeError):
        decode(messages.encode_message(message))


@pytest.mark.parametrize("message", FROM_CLIENT, ids=name)
def test_cut_and_extended_messages_are_refused(message):
    data = messages.encode_message(message)
    for wrong in (
        b"",
        data[:-1],
        data + b"\x00",
        msgspec.msgpack.encode({**msgspec.to_builtins(message), "x": 1}),
    ):
        with pytest.raises(msgspec.DecodeError):
            messages.decode_participant_message(wrong)


def test_integers_are_accepted_as_floats():
    pose = [[0, 1, 2], [0, 0, 0, 1]]
    frame = {
        "type": "tracking",
        "sequence": 3,
        "client_time_ms": 16,
        "head": pose,
        "left": None,
        "right": pose,
        "left_modality": "none",
        "right_modality": "hand",
    }
    decoded = messages.decode_participant_message(msgspec.msgpack.encode(frame))
    assert isinstance(decoded, messages.TrackingFrameMessage)
    assert decoded.head == messages.XRPose((0.0, 1.0, 2.0), (0.0, 0.0, 0.0, 1.0))
    assert isinstance(decoded.client_time_ms, float)


def test_the_typescript_is_current():
    if not write_typescript.CLIENT.is_dir():
        pytest.skip("not in a checkout")
    assert list(write_typescript.stale()) == [], "run python scripts/write_typescript.py"


def test_check_fails_when_stale(tmp_path, monkeypatch):
    (tmp_path / "src").mkdir()
    monkeypatch.setattr(write_typescript, "CLIENT", tmp_path)
    monkeypatch.setattr(sys, "argv", ["write_typescript", "--check"])
    with pytest.raises(SystemExit, match="stale"):
        write_typescript.main()
    monkeypatch.setattr(sys, "argv", ["write_typescript"])
    write_typescript.main()
    assert write_typescript.stale() == {}


def test_check_runs_as_a_script():
    if not write_typescript.CLIENT.is_dir():
        pytest.skip("not in a checkout")
    done = subprocess.run(
        [sys.executable, str(write_typescript.__file__), "--check"], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_unknown_types_are_named():
    with pytest.raises(TypeError, match="not SetType"):
        write_typescript.type_text(msgspec.inspect.type_info(set[int]))
