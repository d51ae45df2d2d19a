import json
import math
import os
import random
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, Writer
from msgspec.structs import replace

from avrgym.recording import schema
from avrgym.recording import writer as writing
from avrgym.recording.reader import Recording, RecordingError, read_recording
from avrgym.recording.schema import (
    TOPICS,
    Answer,
    BodyTargets,
    Command,
    Control,
    Event,
    Latency,
    Outcome,
    Pacing,
    Physics,
    Placement,
    Pose,
    RobotCommand,
    Stream,
    StreamSamples,
    TrackingFrame,
    decode,
    encode,
    make_json_schema,
)
from avrgym.recording.writer import RecordingWriter
from helpers.studies.configurations import configuration
from helpers.system.paths import OLD_RECORDING
from helpers.system.processes import kill_with_parent

CONFIGURATION = configuration(environment="avrgym/FeedingJaco-v1", seed=3)
OUTCOME = Outcome(result="completed", reward=1.5, success=True)
POSE = Pose(position=[0.1, -0.2, 1.3], orientation=[0.0, 0.0, 0.0, 1.0])
RECORDS = {
    "/physics": Physics(3, 0.3, [0.1, -1e-300, 5e-324, 1.7976931348623157e308]),
    "/tracking": TrackingFrame(7, 12.5, 0.25, moved_person=True, rejected=False, head=POSE, right=POSE),
    "/body_targets": BodyTargets([0.1, 0.2]),
    "/commands": Command(3, [0.5, -1.0]),
    "/control": Control(3, [1.0], [0.5], -1.5, {"distance": -0.3, "action": 0.1}, False, 0.3, 2.5),
    "/events": Event("disconnected", 'a null and a "quote" and an é'),
    "/answers": Answer("L1", 7, 1.25),
    "/latency": Latency([7, 9], [0.5, 0.25], [3.0, 4.0], [9.0, 8.0], [0.1, 0.2], [3.5, 2.5], [45.0, 47.0]),
    "/streams": Stream("heart", "Belt", "ECG", 130.0, ["ecg"], ["mV"]),
    "/samples": StreamSamples("heart", 0.001, [0.5, 0.51], [[-0.25], [1e-300]], [["r-peak"], ["é"]]),
    "/placement": Placement(POSE),
    "/robot_commands": RobotCommand("slower", "key", 7, had_effect=True),
    "/pacing": Pacing(8, "waiting", 0.75, 0.15, -1.0, 0.16, 0.0),
}


def write_trial(path: Path, steps: int = 40, outcome: Outcome | None = OUTCOME) -> dict[str, list]:
    """Record some made-up steps in several chunks; returns what was written."""
    rng = random.Random(0)
    written: dict[str, list] = {topic: [] for topic in TOPICS}
    writer = RecordingWriter(path, CONFIGURATION)
    for step in range(steps):
        for topic, record in {
            **RECORDS,
            "/physics": Physics(step, step / 10, [rng.gauss(0, 1) for _ in range(9)]),
        }.items():
            writer.write(topic, step * 100_000_000, record)
            written[topic].append((step * 100_000_000, record))
        if step % 10 == 9:
            time.sleep(0.01)
    writer.close(outcome)
    return written


@pytest.fixture
def small_chunks(monkeypatch):
    monkeypatch.setattr(writing, "FLUSH_INTERVAL_S", 0.001)


# Records


@pytest.mark.parametrize("topic", TOPICS)
def test_every_record_reads_back_as_written(topic):
    assert decode(topic, encode(RECORDS[topic])) == RECORDS[topic]


def test_finite_doubles_keep_their_bits():
    rng = random.Random(1)
    floats = [rng.uniform(-1, 1) * 10.0 ** rng.randint(-308, 307) for _ in range(2000)] + [-0.0, 5e-324]
    read = decode("/physics", encode(Physics(0, 0.0, floats))).state
    assert [number.hex() for number in read] == [number.hex() for number in floats]


def test_numbers_that_are_not_finite_survive():
    frame = TrackingFrame(
        0, math.inf, 0.0, False, True, head=Pose([math.nan, -math.inf, 1.0], [math.inf, 0.0, 0.0, 1.0])
    )
    read = decode("/tracking", encode(frame))
    assert math.isnan(read.head.position[0])
    assert read.head.position[1:] == [-math.inf, 1.0]
    assert (read.client_time_ms, read.head.orientation[0], read.left) == (math.inf, math.inf, None)


@pytest.mark.parametrize("topic", TOPICS)
def test_schemas_describe_every_field_without_references(topic):
    schema = json.loads(make_json_schema(topic))
    assert schema["type"] == "object"
    assert set(schema["properties"]) == set(TOPICS[topic].__struct_encode_fields__)
    assert not re.search(r"\$ref|anyOf|prefixItems|null", make_json_schema(topic).decode())


# Files


def test_a_closed_recording_reads_back_whole(tmp_path):
    path = tmp_path / "trial.mcap"
    written = write_trial(path)
    read = read_recording(path)
    assert (read.configuration, read.outcome, read.is_complete) == (CONFIGURATION, OUTCOME, True)
    assert read.messages_by_topic == written


def test_other_readers_of_mcap_find_the_schemas_the_messages_and_the_metadata(tmp_path):
    write_trial(tmp_path / "trial.mcap")
    with open(tmp_path / "trial.mcap", "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = list(reader.iter_messages(topics=["/control"]))
        assert [record.name for record in reader.iter_metadata()] == ["configuration", "origin", "outcome"]
    schema, channel, message = messages[0]
    assert schema is not None
    assert (schema.name, schema.encoding, channel.message_encoding) == (
        "avrgym.Control",
        "jsonschema",
        "json",
    )
    assert json.loads(message.data)["reward_terms"] == {"distance": -0.3, "action": 0.1}
    assert len(messages) == 40


def test_an_existing_file_is_never_overwritten(tmp_path):
    path = tmp_path / "trial.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(FileExistsError):
        RecordingWriter(path, CONFIGURATION)
    assert path.read_bytes() == b"precious"


def test_without_an_outcome_the_trial_is_incomplete(tmp_path):
    path = tmp_path / "trial.mcap"
    written = write_trial(path, outcome=None)
    read = read_recording(path)
    assert (read.is_complete, read.outcome) == (False, None)
    assert read.messages_by_topic == written


def test_closing_twice_changes_nothing_and_a_late_record_is_refused(tmp_path):
    path = tmp_path / "trial.mcap"
    writer = RecordingWriter(path, CONFIGURATION)
    writer.close(OUTCOME)
    before = path.read_bytes()
    writer.close(Outcome(result="stopped"))
    assert path.read_bytes() == before
    with pytest.raises(RecordingError, match="is closed"):
        writer.write("/answers", 0, RECORDS["/answers"])


def test_a_wrong_topic_or_record_is_refused(tmp_path):
    writer = RecordingWriter(tmp_path / "trial.mcap", CONFIGURATION)
    with pytest.raises(
        RecordingError, match="no topic '/answer' for Answer; allowed: /physics: Physics, /tracking"
    ):
        writer.write("/answer", 0, RECORDS["/answers"])
    with pytest.raises(RecordingError, match="no topic '/physics' for Answer"):
        writer.write("/physics", 0, RECORDS["/answers"])
    writer.close(OUTCOME)


def test_a_recording_whose_messages_are_not_numbered_reads_whole(tmp_path, monkeypatch):
    add_message = Writer.add_message
    monkeypatch.setattr(Writer, "add_message", lambda *args, sequence, **more: add_message(*args, **more))
    path = tmp_path / "trial.mcap"
    written = write_trial(path)
    read = read_recording(path)
    assert read.is_complete
    assert read.messages_by_topic == written


@pytest.mark.slow
def test_a_file_cut_anywhere_gives_a_prefix(tmp_path, small_chunks):
    path = tmp_path / "trial.mcap"
    written = write_trial(path)
    content = path.read_bytes()
    header = content.index(b"began_at") + 60
    cut = tmp_path / "cut.mcap"
    lengths = set()
    for end in (*range(header), *range(header, len(content), 101), *range(len(content) - 200, len(content))):
        cut.write_bytes(content[:end])
        try:
            read = read_recording(cut)
        except RecordingError:
            assert end < header
            continue
        assert not read.is_complete
        assert read.configuration == CONFIGURATION
        assert_begins(read, written)
        lengths.add(len(read.messages_by_topic["/physics"]))
    assert len(lengths) > 3


def assert_begins(read: Recording, written) -> None:
    """What was read of each topic is what was written first."""
    for topic, messages in read.messages_by_topic.items():
        assert messages == written[topic][: len(messages)]


def records_of_the_data_section(content: bytes) -> list[tuple[int, int]]:
    """(opcode, position) of each record before the end of the data, as the specification of MCAP frames them."""
    found = []
    position = len(MCAP0_MAGIC)
    while content[position] != Opcode.DATA_END:
        found.append((content[position], position))
        position += 9 + int.from_bytes(content[position + 1 : position + 9], "little")
    return [*found, (Opcode.DATA_END, position)]


@pytest.mark.slow
def test_damage_to_any_byte_ends_the_reading(tmp_path, small_chunks):
    path = tmp_path / "trial.mcap"
    written = write_trial(path, steps=20)
    content = path.read_bytes()
    *records, (_, end) = records_of_the_data_section(content)
    chunks = [position for opcode, position in records if opcode == Opcode.CHUNK]
    assert len(chunks) > 1
    rng = random.Random(2)
    flips = [(start + byte, bit) for _, start in records for byte in range(9) for bit in range(8)]
    flips += [(rng.randrange(end), rng.randrange(8)) for _ in range(500)]
    for position, bit in flips:
        damaged = bytearray(content)
        damaged[position] ^= 1 << bit
        path.write_bytes(damaged)
        try:
            read = read_recording(path)
        except RecordingError:
            assert position < chunks[0]
            continue
        assert not read.is_complete
        assert_begins(read, written)


def test_a_message_outside_of_a_chunk_ends_the_reading(tmp_path, small_chunks):
    path = tmp_path / "trial.mcap"
    written = write_trial(path, steps=20)
    content = bytearray(path.read_bytes())
    records = records_of_the_data_section(bytes(content))
    index = next(position for opcode, position in records if opcode == Opcode.MESSAGE_INDEX)
    content[index] = Opcode.MESSAGE
    content[index + 11 : index + 15] = bytes(4)  # of a message: its number, and 0 is none
    path.write_bytes(content)
    read = read_recording(path)
    assert not read.is_complete
    assert 0 < sum(map(len, read.messages_by_topic.values())) < sum(map(len, written.values()))
    assert_begins(read, written)


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"not a recording at all" * 9])
def test_a_foreign_file_is_refused(tmp_path, content):
    path = tmp_path / "foreign.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=r"foreign\.mcap: not a recording"):
        read_recording(path)


def test_a_recording_with_another_topic_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "trial.mcap"
    write_trial(path)
    monkeypatch.delitem(schema.TOPICS, "/answers")
    with pytest.raises(RecordingError, match=r"invalid message in '/answers'.* allowed: /physics, /tracking"):
        read_recording(path)


# Crashes and failing disks

CHILD = """
import os, random, resource, sys, time
from avrgym.recording.reader import RecordingError, read_header
from avrgym.recording.writer import RecordingWriter
from avrgym.recording.schema import Outcome, Physics
path, size_limit = sys.argv[1], int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_FSIZE, (size_limit or resource.RLIM_INFINITY, resource.RLIM_INFINITY))
writer = RecordingWriter(path, read_header(sys.argv[3]).configuration)
print("started", flush=True)
step, full_at, began = 0, None, time.monotonic()
while writer.disk_error is None and time.monotonic() - began < 20:
    state = [random.random() for _ in range(300)]
    writer.write("/physics", time.monotonic_ns(), Physics(step, step / 100, state))
    step += 1
    time.sleep(0.01)
    if size_limit and full_at is None and os.path.getsize(path) >= size_limit:
        full_at = time.monotonic()
try:
    writer.close(Outcome(result="completed", success=True))
except RecordingError as error:
    print(time.monotonic() - full_at, error, flush=True)
"""


def start_child(path: Path, size_limit: int) -> subprocess.Popen:
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, str(path), str(size_limit), str(OLD_RECORDING)],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=kill_with_parent,
    )
    assert child.stdout is not None
    assert child.stdout.readline() == "started\n"
    return child


def assert_steps_are_whole(physics: list) -> None:
    assert [record.step for _, record in physics] == list(range(len(physics)))


def test_a_killed_process_loses_at_most_the_last_second(tmp_path):
    with start_child(tmp_path / "trial.mcap", 0) as child:
        time.sleep(1.7)
        killed_at_ns = time.monotonic_ns()
        child.kill()
    read = read_recording(tmp_path / "trial.mcap")
    physics = read.messages_by_topic["/physics"]
    assert not read.is_complete
    assert_steps_are_whole(physics)
    assert killed_at_ns - physics[-1][0] < 1_000_000_000
    assert physics[-1][0] - physics[0][0] > 500_000_000


def test_a_full_disk_raises_an_alarm_within_a_second_and_never_completes(tmp_path):
    with start_child(tmp_path / "trial.mcap", 100_000) as child:
        assert child.stdout is not None
        alarm_s, message = child.stdout.readline().split(maxsplit=1)
    assert float(alarm_s) < 1
    assert "is incomplete" in message
    read = read_recording(tmp_path / "trial.mcap")
    assert not read.is_complete
    assert_steps_are_whole(read.messages_by_topic["/physics"])
    assert len(read.messages_by_topic["/physics"]) > 5


@pytest.fixture
def stalled_disk(monkeypatch):
    """A disk that takes nothing until the event is set."""
    goes_on = threading.Event()
    write = writing._Disk.write

    def wait_and_write(self, data):
        if threading.current_thread() is not threading.main_thread():
            goes_on.wait()
        write(self, data)

    monkeypatch.setattr(writing._Disk, "write", wait_and_write)
    return goes_on


def test_a_stall_raises_an_alarm_within_a_second_and_may_pass(tmp_path, stalled_disk):
    writer = RecordingWriter(tmp_path / "trial.mcap", CONFIGURATION)
    writer.write("/answers", 0, RECORDS["/answers"])
    assert writer.disk_error is None
    began = time.monotonic()
    while writer.disk_error is None and time.monotonic() - began < 5:
        time.sleep(0.01)
    assert time.monotonic() - began < 1
    assert isinstance(writer.disk_error, TimeoutError)
    stalled_disk.set()
    writer.close(OUTCOME)
    assert writer.disk_error is None
    assert read_recording(tmp_path / "trial.mcap").is_complete


def test_a_disk_too_slow_loses_records_loudly_and_never_blocks(tmp_path, stalled_disk, monkeypatch):
    monkeypatch.setattr(writing, "MAX_QUEUED_MESSAGES", 50)
    monkeypatch.setattr(writing, "FLUSH_INTERVAL_S", 0)
    writer = RecordingWriter(tmp_path / "trial.mcap", CONFIGURATION)
    for step in range(500):
        writer.write("/physics", step, Physics(step, 0.0, []))
    assert isinstance(writer.disk_error, RecordingError)
    stalled_disk.set()
    with pytest.raises(RecordingError, match=r"is incomplete: .* a record was lost"):
        writer.close(OUTCOME)
    read = read_recording(tmp_path / "trial.mcap")
    assert not read.is_complete
    assert_steps_are_whole(read.messages_by_topic["/physics"])


def test_a_disk_that_never_takes_the_data_does_not_hold_up_the_close(tmp_path, stalled_disk, monkeypatch):
    monkeypatch.setattr(writing, "CLOSE_TIMEOUT_S", 0.05)
    writer = RecordingWriter(tmp_path / "trial.mcap", CONFIGURATION)
    writer.write("/answers", 0, RECORDS["/answers"])
    with pytest.raises(RecordingError, match="does not accept data"):
        writer.close(OUTCOME)
    stalled_disk.set()
    writer.close()


@pytest.mark.parametrize("good_syncs", [0, 1])
def test_data_that_are_not_safely_on_disk_are_never_complete(tmp_path, monkeypatch, good_syncs):
    path = tmp_path / "trial.mcap"
    syncs = []

    def failing_sync(_descriptor):
        syncs.append(1)
        if len(syncs) > good_syncs:
            raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", failing_sync)
    with pytest.raises(RecordingError, match=r"is incomplete: .*Input/output error"):
        write_trial(path)
    read = read_recording(path)
    assert (read.is_complete, read.outcome) == (False, None)
    assert len(read.messages_by_topic["/physics"]) == 40


def test_a_record_that_is_not_plain_data_is_a_failure(tmp_path):
    writer = RecordingWriter(tmp_path / "trial.mcap", CONFIGURATION)
    writer.write("/events", 0, Event("strange", object()))  # pyright: ignore[reportArgumentType]
    with pytest.raises(RecordingError, match="is incomplete"):
        writer.close(OUTCOME)


def test_a_failed_start_leaves_no_file(tmp_path):
    with pytest.raises(TypeError):
        RecordingWriter(tmp_path / "trial.mcap", replace(CONFIGURATION, goal=object()))
    assert not list(tmp_path.iterdir())
