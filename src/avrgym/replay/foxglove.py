"""Exports a recorded trial for 3D display in Foxglove and Rerun. Needs the extra ``foxglove``.

The MCAP file contains the recording's messages and Foxglove's schemas
(https://docs.foxglove.dev/docs/visualization/message-schemas) as protocol buffers:

- ``/tf``: poses of bodies that moved, at 50 Hz;
- ``/scene``: triangle meshes of the bodies, for Foxglove;
- ``/surfaces/BODY``: the surfaces of a body as points, because Rerun does not show these meshes;
- ``/tracked/head``, ``/tracked/left``, ``/tracked/right``: tracked poses in the headset's space;
- ``/log``: phases, events and answers as text.

Times are UTC.
"""

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.Point3_pb2 import Point3
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.TriangleListPrimitive_pb2 import TriangleListPrimitive
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema
from numpy.typing import NDArray

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.recording.reader import Recording
from avrgym.recording.schema import TOPICS, TrackingFrame, encode, make_json_schema
from avrgym.replay.output_files import check_output_path
from avrgym.replay.timeline import build_timeline, get_scene_parameters
from avrgym.system import random_streams
from avrgym.system.files import write_atomically
from avrgym.vr.scene.body_surfaces import BodySurface, make_body_surfaces
from avrgym.vr.scene.export_process import build_model_with_appearance

WORLD_FRAME_ID, TRACKING_FRAME_ID = "world", "local_floor"
"""Names of coordinate frames: the simulated world (z up), and the headset's space of tracked poses (y up)."""
TRACKED_BODY_PARTS = ("head", "left", "right")
"""Names of the body parts with tracked poses: the head and both hands."""
NUM_SURFACE_POINTS = 40_000
"""Total number of points on the surfaces of all bodies."""
POINT_FIELD_OFFSETS = {"x": 0, "y": 4, "z": 8, "red": 12, "green": 13, "blue": 14, "alpha": 15}
"""Byte offset of each field of a point in a Foxglove point cloud, by name of the field."""
POINT_BYTES = 16
"""Size of one point in a Foxglove point cloud, in bytes."""


def write_foxglove(recording: Recording, out: Path, progress: Callable[[], None]) -> None:
    """Write a recorded trial to a new file for Foxglove and Rerun.

    Args:
        recording: the recording of the trial.
        out: a new file that ends in .mcap.
        progress: called after each recorded state.

    Raises:
        ValueError: for a wrong suffix, a missing folder, or a recording that cannot be recomputed.
        FileExistsError: if the file exists.
    """
    check_output_path(out, (".mcap",))
    timeline, poses = build_timeline(recording, progress)
    data = io.BytesIO()
    log = _Log(data, round(recording.began_at.timestamp() * 1e9), _described(recording))
    surfaces = make_body_surfaces(build_model_with_appearance(*get_scene_parameters(recording)))
    log.write("/scene", 0.0, SceneUpdate(entities=[_entity(log, *each) for each in surfaces.items()]))
    for body, cloud in _clouds(surfaces):
        log.write(f"/surfaces/{body.replace('/', '_')}", 0.0, _point_cloud(log, body, cloud))
    frames = np.frombuffer(poses, "<f4").reshape(len(timeline.frames_s), -1, 7).astype(float)
    for time_s, moved in _moves(
        timeline.frames_s, frames[:, : len(timeline.scene.bodies)], timeline.scene.bodies
    ):
        log.write(
            "/tf", time_s, FrameTransforms(transforms=[_transform(log, time_s, *each) for each in moved])
        )
    log.write(
        "/tf",
        0.0,
        FrameTransforms(transforms=[_transform(log, 0.0, TRACKING_FRAME_ID, _tracking_space(recording))]),
    )
    for time_ns, frame in recording.messages_by_topic["/tracking"]:
        _write_tracked(log, time_ns / 1e9, frame)
    for event in timeline.events:
        time = log.timestamp(event.time_s)
        log.write("/log", event.time_s, Log(timestamp=time, level=Log.INFO, message=event.text))
    for topic, time_ns, record in recording.messages:
        log.write_record(topic, time_ns, record)
    log.finish()
    write_atomically(out, data.getvalue())


class _Log:
    """An MCAP file that is open for writing. Times are in seconds from the start of the trial."""

    def __init__(self, data: io.BytesIO, began_ns: int, described: dict[str, str]) -> None:
        self._began_ns = began_ns
        self._mcap = Writer(data, compression=CompressionType.ZSTD)
        self._mcap.start(profile="", library="avrgym")
        self._mcap.add_metadata("trial", described)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def timestamp(self, time_s: float) -> Timestamp:
        """Returns the UTC time stamp of a time in the trial."""
        stamp = Timestamp()
        stamp.FromNanoseconds(self._at_ns(time_s))
        return stamp

    def write(self, topic: str, time_s: float, message: Any) -> None:
        """Write a message with one of Foxglove's schemas to a topic, at a time in the trial."""
        name = message.DESCRIPTOR.full_name
        if name not in self._schemas:
            self._schemas[name] = register_schema(self._mcap, type(message))
        self._add(topic, "protobuf", self._schemas[name], self._at_ns(time_s), message.SerializeToString())

    def write_record(self, topic: str, time_ns: int, record: Any) -> None:
        """Write a record of the recording as JSON. ``time_ns`` counts from the start of the trial."""
        if topic not in self._schemas:
            name = f"avrgym.{TOPICS[topic].__name__}"
            self._schemas[topic] = self._mcap.register_schema(name, "jsonschema", make_json_schema(topic))
        self._add(topic, "json", self._schemas[topic], self._began_ns + time_ns, encode(record))

    def finish(self) -> None:
        """Write the index and the end of the file."""
        self._mcap.finish()

    def _at_ns(self, time_s: float) -> int:
        return self._began_ns + round(time_s * 1e9)

    def _add(self, topic: str, encoding: str, schema: int, time_ns: int, data: bytes) -> None:
        if topic not in self._channels:
            self._channels[topic] = self._mcap.register_channel(topic, encoding, schema)
        self._mcap.add_message(self._channels[topic], time_ns, data, time_ns)


def _described(recording: Recording) -> dict[str, str]:
    trial = recording.configuration
    return {
        "environment": trial.environment,
        "policy": trial.policy,
        "simulated": str(trial.simulated),
        "practice": str(trial.practice),
        "session": trial.session,
        "began_at": recording.began_at.isoformat(),
    }


def _entity(log: _Log, body: str, surfaces: Sequence[BodySurface]) -> SceneEntity:
    """Returns the surfaces of a body as a permanent entity that moves with the body's frame."""
    triangles = [
        TriangleListPrimitive(
            pose=Pose(orientation=Quaternion(w=1.0)),
            points=[Point3(x=x, y=y, z=z) for x, y, z in surface.vertices.tolist()],
            indices=surface.faces.ravel().tolist(),
            **_colours(surface),
        )
        for surface in surfaces
    ]
    return SceneEntity(
        timestamp=log.timestamp(0.0), frame_id=body, id=body, frame_locked=True, triangles=triangles
    )


def _colours(surface: BodySurface) -> Mapping[str, Any]:
    """Returns one colour if all vertices have the same colour, otherwise a colour for each vertex."""
    colours = [Color(r=r, g=g, b=b, a=a) for r, g, b, a in surface.rgba.tolist()]
    one = bool((surface.rgba == surface.rgba[0]).all())
    return {"color": colours[0]} if one else {"colors": colours}


def _clouds(surfaces: Mapping[str, Sequence[BodySurface]]) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    """Yields the name of each body and points (P, ``POINT_BYTES``) of uniform density on its surfaces.

    The points are random, but the same in every export of the recording.
    """
    areas = {body: [_areas(surface) for surface in own] for body, own in surfaces.items()}
    density = NUM_SURFACE_POINTS / sum(area.sum() for own in areas.values() for area in own)
    generator = random_streams.make_surface_point_rng()
    for body, own in surfaces.items():
        drawn = [
            _points(surface, area, int(np.ceil(density * area.sum())), generator)
            for surface, area in zip(own, areas[body], strict=True)
        ]
        yield body, np.concatenate(drawn)


def _areas(surface: BodySurface) -> FloatArray:
    corners = surface.vertices[surface.faces]
    return (
        np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    )


def _points(
    surface: BodySurface, areas: FloatArray, count: int, generator: np.random.Generator
) -> NDArray[np.uint8]:
    faces = surface.faces[generator.choice(len(areas), count, p=areas / areas.sum())]
    shares = generator.dirichlet((1.0, 1.0, 1.0), count)[:, :, None]
    places = (surface.vertices[faces] * shares).sum(axis=1).astype("<f4")
    rgba: FloatArray = (surface.rgba[faces] * shares).sum(axis=1)
    colours = np.rint(255.0 * rgba).astype(np.uint8)
    return np.concatenate([places.view(np.uint8).reshape(count, 12), colours], axis=1)


def _point_cloud(log: _Log, body: str, points: NDArray[np.uint8]) -> PointCloud:
    kinds = PackedElementField.NumericType
    return PointCloud(
        timestamp=log.timestamp(0.0),
        frame_id=body,
        pose=Pose(orientation=Quaternion(w=1.0)),
        point_stride=POINT_BYTES,
        fields=[
            PackedElementField(name=name, offset=offset, type=kinds.FLOAT32 if offset < 12 else kinds.UINT8)
            for name, offset in POINT_FIELD_OFFSETS.items()
        ],
        data=points.tobytes(),
    )


def _moves(
    times_s: Sequence[float], frames: FloatArray, bodies: Sequence[str]
) -> Iterator[tuple[float, list[tuple[str, FloatArray]]]]:
    """Yields each time at which bodies have moved, with the names and poses (7,) of these bodies.

    The first time includes all bodies.
    """
    before = np.full_like(frames[0], np.nan)
    for time_s, poses in zip(times_s, frames, strict=True):
        moved = np.flatnonzero((poses != before).any(axis=1)).tolist()
        before = poses
        if moved:
            yield time_s, [(bodies[number], poses[number]) for number in moved]


def _transform(log: _Log, time_s: float, frame: str, pose: FloatArray) -> FrameTransform:
    """Returns the message for a frame with this pose (7,) in the world: x, y, z, then quaternion w, x, y, z."""
    x, y, z, qw, qx, qy, qz = pose.tolist()
    return FrameTransform(
        timestamp=log.timestamp(time_s),
        parent_frame_id=WORLD_FRAME_ID,
        child_frame_id=frame,
        translation=Vector3(x=x, y=y, z=z),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )


def _tracking_space(recording: Recording) -> FloatArray:
    """Returns the pose (7,) of the headset's tracking space in the world: x, y, z, then quaternion w, x, y, z."""
    pose = recording.configuration.xr_from_world
    x, y, z, w = pose.orientation
    return np.concatenate(transforms.invert(np.array(pose.position), np.array([w, x, y, z])))


def _write_tracked(log: _Log, time_s: float, frame: TrackingFrame) -> None:
    for part in TRACKED_BODY_PARTS:
        pose = getattr(frame, part)
        if pose is None:
            continue
        (x, y, z), (qx, qy, qz, qw) = pose.position, pose.orientation
        placed = Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
        message = PoseInFrame(timestamp=log.timestamp(time_s), frame_id=TRACKING_FRAME_ID, pose=placed)
        log.write(f"/tracked/{part}", time_s, message)
