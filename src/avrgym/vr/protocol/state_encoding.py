"""Delta encoding of states for one connection. Each value is rounded to an integer number of quantisation steps.

A WebSocket delivers every message once and in order. Server and client therefore store the same previous state, without
acknowledgements. Differences are integers. Errors therefore do not accumulate: each decoded value is within half a step
of the original.
"""

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray
from avrgym.vr.protocol.messages import WorldState, WorldStateChange

POSITION_STEP_M = 1e-4
QUATERNION_QUANTISATION_STEP = 5e-5
"""Quantisation step of a quaternion's components. The rounding error of a rotation is at most 1e-4 rad."""
JOINT_STEP_RAD = 1e-5
POSE_QUANTISATION_STEPS = np.array([POSITION_STEP_M] * 3 + [QUATERNION_QUANTISATION_STEP] * 4)
JOINT_QUANTISATION_STEPS = np.array([JOINT_STEP_RAD])
MAX_QUANTISATION_STEPS = 2.0**31 - 1.0
"""Maximum absolute value in steps. Larger values are clipped. NaN is encoded as the lower limit."""

VARINT_DIGIT_BITS = 7

IntegerArray = NDArray[np.int64]


class StateEncoder:
    """Encodes the states of one connection, in the server."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Reset after a scene message: the next state is encoded without reference to a previous state."""
        self._targets, self._poses = (
            _DeltaCodec(JOINT_QUANTISATION_STEPS),
            _DeltaCodec(POSE_QUANTISATION_STEPS),
        )

    def encode(self, state: WorldState) -> WorldStateChange:
        """Returns the encoded difference between ``state`` and the previous state."""
        return WorldStateChange(
            sequence=state.sequence_number,
            simulation_time_s=state.simulation_time_s,
            tracking_sequence=state.tracking_sequence_number,
            deviating_parts=state.deviating_parts,
            joint_targets=self._targets.encode(state.joint_targets),
            poses=self._poses.encode(state.poses),
        )


class StateDecoder:
    """Decodes the states of one connection, in a Python client."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Reset after a scene message: the next state is decoded without reference to a previous state."""
        self._targets, self._poses = (
            _DeltaCodec(JOINT_QUANTISATION_STEPS),
            _DeltaCodec(POSE_QUANTISATION_STEPS),
        )

    def decode(self, change: WorldStateChange) -> WorldState:
        """Returns the decoded state. Each value is within half a quantisation step of the original."""
        return WorldState(
            sequence_number=change.sequence,
            simulation_time_s=change.simulation_time_s,
            tracking_sequence_number=change.tracking_sequence,
            joint_targets=self._targets.decode(change.joint_targets),
            deviating_parts=change.deviating_parts,
            poses=self._poses.decode(change.poses),
        )


class _DeltaCodec:
    """Encodes or decodes rows of numbers as differences to the previous rows. Differences are integer numbers of
    steps."""

    def __init__(self, steps: FloatArray) -> None:
        self._steps = steps
        self._whole: IntegerArray = np.zeros((0, len(steps)), np.int64)

    def encode(self, numbers: bytes) -> bytes:
        """Encode the differences between ``numbers`` (little-endian float32) and the previous numbers."""
        rows = np.frombuffer(numbers, "<f4").reshape(-1, len(self._steps)) / self._steps
        whole = np.rint(np.fmin(np.fmax(rows, -MAX_QUANTISATION_STEPS), MAX_QUANTISATION_STEPS)).astype(
            np.int64
        )
        if not len(self._whole):
            self._whole = whole
            return encode_row_changes(np.arange(len(whole)), whole)
        changes, self._whole = whole - self._whole, whole
        rows = np.flatnonzero((changes != 0).any(axis=1))
        return encode_row_changes(rows, changes[rows])

    def decode(self, packed: bytes) -> bytes:
        """Decode differences. Returns the new numbers (little-endian float32)."""
        rows, changes = decode_row_changes(packed, len(self._steps))
        if not len(self._whole):
            self._whole = np.zeros((1 + max(rows, default=-1), len(self._steps)), np.int64)
        self._whole[rows] += changes
        return (self._whole * self._steps).astype("<f4").tobytes()


def encode_row_changes(rows: IntegerArray, changes: IntegerArray) -> bytes:
    """Encode the changes (R, columns) of the rows with these ascending indices (R,). Returns the bytes.

    For each row: the number of unchanged rows before it, then its changes in zigzag encoding. All are varints as in
    Protocol Buffers (https://protobuf.dev/programming-guides/encoding).
    """
    numbers = np.empty((len(rows), 1 + changes.shape[1]), np.int64)
    numbers[:, 0] = np.diff(rows, prepend=-1) - 1
    numbers[:, 1:] = (changes << 1) ^ (changes >> 63)
    digits = -(-int(numbers.max(initial=1)).bit_length() // VARINT_DIGIT_BITS)
    rest = numbers.reshape(-1, 1) >> (VARINT_DIGIT_BITS * np.arange(digits))
    written = rest > 0
    written[:, 0] = True
    more = (rest > 0x7F) << VARINT_DIGIT_BITS
    return ((rest & 0x7F) | more)[written].astype(np.uint8).tobytes()


def decode_row_changes(packed: bytes, columns: int) -> tuple[IntegerArray, IntegerArray]:
    """Decode the result of ``encode_row_changes``. Returns the row indices (R,) and the changes (R, columns).

    Raises:
        ValueError: for incomplete data.
    """
    digits = np.frombuffer(packed, np.uint8).astype(np.int64)
    (ends,) = (digits < 0x80).nonzero()
    starts = np.concatenate([[0], ends[:-1] + 1]).astype(np.int64)[: len(ends)]
    if len(digits) != (ends[-1] + 1 if len(ends) else 0) or len(ends) % (1 + columns):
        raise ValueError(
            f"incomplete data: {len(packed)} bytes do not end with a complete row; allowed: rows of {columns} numbers"
        )
    place = np.arange(len(digits)) - np.repeat(starts, ends - starts + 1)
    numbers = np.add.reduceat((digits & 0x7F) << (VARINT_DIGIT_BITS * place), starts) if len(ends) else digits
    table = numbers.reshape(-1, 1 + columns)
    zigzag = table[:, 1:]
    return np.cumsum(table[:, 0] + 1) - 1, (zigzag >> 1) ^ -(zigzag & 1)
