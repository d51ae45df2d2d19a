"""Recordings as files for Foxglove and Rerun."""

import subprocess
import sys
from collections import defaultdict
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

for package in ("foxglove_schemas_protobuf", "mcap_protobuf"):
    pytest.importorskip(package, reason="`pip install avrgym[foxglove]` brings what the export needs")

from mcap_protobuf.decoder import DecoderFactory  # noqa: E402

from avrgym.geometry import transforms  # noqa: E402
from avrgym.recording.reader import Recording, read_recording  # noqa: E402
from avrgym.replay.foxglove import TRACKING_FRAME_ID, WORLD_FRAME_ID, write_foxglove  # noqa: E402
from helpers.system.paths import OLD_RECORDING  # noqa: E402
from helpers.vr.visit import Visit, plan  # noqa: E402

Messages = dict[str, list[tuple[int, Any]]]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    visit = Visit(tmp_path_factory.mktemp("recordings"), plan())
    visit.go_to("finished")
    visit.leave()
    return read_recording(visit.session.recordings[0])


@pytest.fixture(scope="module")
def file(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("foxglove") / "trial.mcap"
    write_foxglove(recording, out, lambda: None)
    return out


@pytest.fixture(scope="module")
def shown(file: Path) -> Messages:
    found: Messages = defaultdict(list)
    with file.open("rb") as opened:
        reader = make_reader(opened, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            decoded = DecoderFactory().decoder_for(channel.message_encoding, schema)
            found[channel.topic].append(
                (message.log_time, decoded(message.data) if decoded else message.data)
            )
    return found


def place(transform: Any) -> tuple[np.ndarray, np.ndarray]:
    at, turned = transform.translation, transform.rotation
    return np.array([at.x, at.y, at.z]), np.array([turned.w, turned.x, turned.y, turned.z])


@pytest.mark.slow
def test_times_are_those_of_the_calendar(recording: Recording, shown: Messages) -> None:
    assert datetime.now(UTC) - recording.began_at < timedelta(hours=1)
    began_ns = round(recording.began_at.timestamp() * 1e9)
    for topic in ("/physics", "/events", "/control"):
        assert [at - began_ns for at, _ in shown[topic]] == [
            at for at, _ in recording.messages_by_topic[topic]
        ]
    first, transforms_ = shown["/tf"][0]
    assert transforms_.transforms[0].timestamp.ToNanoseconds() == first == began_ns


def test_all_that_the_recording_holds_is_there_as_well(recording: Recording, shown: Messages) -> None:
    for topic, held in recording.messages_by_topic.items():
        assert len(shown[topic]) == len(held)


def test_every_body_has_a_place_and_what_is_seen_has_a_body(recording: Recording, shown: Messages) -> None:
    _, first = shown["/tf"][0]
    assert [each.child_frame_id for each in first.transforms] == list(recording.configuration.body_names)
    assert {each.parent_frame_id for _, some in shown["/tf"] for each in some.transforms} == {WORLD_FRAME_ID}
    ((_, scene),) = shown["/scene"]
    entities = {entity.frame_id: entity for entity in scene.entities}
    assert all(entity.frame_locked and not entity.lifetime.ToNanoseconds() for entity in entities.values())
    assert {"person/head", "person/right_hand", "robot/link_7", "wheelchair"} <= set(entities)
    assert set(entities) <= {*recording.configuration.body_names, "world"}
    head = np.array([[p.x, p.y, p.z] for part in entities["person/head"].triangles for p in part.points])
    assert 0.1 < np.ptp(head, axis=0).min() < np.ptp(head, axis=0).max() < 0.5


def test_points_lie_on_the_triangles(shown: Messages) -> None:
    ((_, scene),) = shown["/scene"]
    (hand,) = (entity for entity in scene.entities if entity.frame_id == "person/right_hand")
    corners = np.array([[p.x, p.y, p.z] for part in hand.triangles for p in part.points])
    ((_, cloud),) = shown["/surfaces/person_right_hand"]
    points = np.frombuffer(cloud.data, np.dtype([("place", "<f4", 3), ("rgba", "u1", 4)]))
    assert cloud.frame_id == "person/right_hand"
    assert (points["place"] >= corners.min(axis=0) - 1e-6).all()
    assert (points["place"] <= corners.max(axis=0) + 1e-6).all()
    assert (points["rgba"][:, 3] == 255).all()


def test_the_tracked_head_lies_at_the_head_of_the_body(shown: Messages) -> None:
    (floor,) = (
        each
        for _, some in shown["/tf"]
        for each in some.transforms
        if each.child_frame_id == TRACKING_FRAME_ID
    )
    head_body = [
        place(e) for _, some in shown["/tf"] for e in some.transforms if e.child_frame_id == "person/head"
    ]
    _, tracked = shown["/tracked/head"][-1]
    at = tracked.pose.position
    floor_at, floor_turned = place(floor)
    head_w = floor_at + transforms.rotate(floor_turned, np.array([at.x, at.y, at.z]))
    assert tracked.frame_id == TRACKING_FRAME_ID
    assert np.linalg.norm(head_w - head_body[-1][0]) < 0.25, (
        "the headset sits ahead of the head, whose body begins below"
    )


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    taken = tmp_path / "taken.mcap"
    taken.write_bytes(b"mine")
    with pytest.raises(FileExistsError, match="choose another name"):
        write_foxglove(read_recording(OLD_RECORDING), taken, lambda: None)
    assert taken.read_bytes() == b"mine"


def test_rerun_takes_places_and_points(file: Path, tmp_path: Path) -> None:
    rerun = Path(sys.executable).with_name("rerun")
    if not rerun.exists():
        pytest.skip("Rerun is not installed (`pip install rerun-sdk` brings it)")
    out = tmp_path / "trial.rrd"
    subprocess.run([rerun, "mcap", "convert", file, "-o", out], check=True, capture_output=True)
    told = subprocess.run(
        [rerun, "rrd", "print", "-v", out], check=True, capture_output=True, text=True
    ).stdout
    assert "Transform3D:translation" in told
    assert "Points3D:positions" in told
