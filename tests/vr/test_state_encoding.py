"""Laws of encoded states: decoded values, accuracy, and number of bytes."""

import numpy as np
import pytest

from avrgym.models.human import Person
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import WorldState
from avrgym.vr.protocol.state_encoding import (
    JOINT_STEP_RAD,
    MAX_QUANTISATION_STEPS,
    POSE_QUANTISATION_STEPS,
    POSITION_STEP_M,
    QUATERNION_QUANTISATION_STEP,
    StateDecoder,
    StateEncoder,
    decode_row_changes,
    encode_row_changes,
)

MOST_BYTES = 1500
ROTATION_RAD = 1e-4
SINGLE = 1e-6
"""What single precision adds to the error of numbers of a few metres."""


def state(poses: np.ndarray, targets_rad: np.ndarray | None = None, sequence: int = 0) -> WorldState:
    targets = np.zeros(0) if targets_rad is None else targets_rad
    return WorldState(
        sequence, 0.0, -1, targets.astype("<f4").tobytes(), ["left"], poses.astype("<f4").tobytes()
    )


def numbers(data: bytes, columns: int) -> np.ndarray:
    return np.frombuffer(data, "<f4").reshape(-1, columns).astype(float)


def check(sent: WorldState, told: WorldState) -> None:
    """The decoded state equals the sent one, within half a step."""
    assert (
        told.sequence_number,
        told.simulation_time_s,
        told.tracking_sequence_number,
        told.deviating_parts,
    ) == (
        *(sent.sequence_number, sent.simulation_time_s, sent.tracking_sequence_number, sent.deviating_parts),
    )
    targets = numbers(told.joint_targets, 1) - numbers(sent.joint_targets, 1)
    assert np.abs(targets).max(initial=0.0) <= 0.5 * JOINT_STEP_RAD + SINGLE
    poses, wanted = numbers(told.poses, 7), numbers(sent.poses, 7)
    assert np.abs(poses - wanted)[:, :3].max() <= 0.5 * POSITION_STEP_M + SINGLE
    length = np.linalg.norm(poses[:, 3:], axis=1)
    assert np.abs(length - 1.0).max() <= ROTATION_RAD
    along = np.abs((poses[:, 3:] * wanted[:, 3:]).sum(1)) / length / np.linalg.norm(wanted[:, 3:], axis=1)
    assert 2.0 * np.arccos(np.minimum(along, 1.0)).max() <= ROTATION_RAD + 10.0 * SINGLE


@pytest.mark.parametrize("columns", [1, 7])
@pytest.mark.parametrize("most", [1, 200, 1 << 32])
def test_rows_are_packed_and_unpacked(columns: int, most: int) -> None:
    random = np.random.default_rng(columns)
    for count in (0, 1, 300):
        rows = np.flatnonzero(random.uniform(size=count) < 0.5)
        changes = random.integers(-most, most, (len(rows), columns), endpoint=True)
        again, unpacked = decode_row_changes(encode_row_changes(rows, changes), columns)
        np.testing.assert_array_equal(again, rows)
        np.testing.assert_array_equal(unpacked, changes)


@pytest.mark.parametrize("cut", [1, 3])
def test_bytes_that_are_missing_are_missed(cut: int) -> None:
    packed = encode_row_changes(np.array([4]), np.array([[300, -1]]))
    with pytest.raises(ValueError, match="do not end with a complete row"):
        decode_row_changes(packed[:-cut], 2)


def test_unchanged_rows_are_omitted_without_drift() -> None:
    random = np.random.default_rng(1)
    encoder, decoder = StateEncoder(), StateDecoder()
    poses = np.concatenate([random.uniform(-3.0, 3.0, (30, 3)), np.eye(4)[random.integers(0, 4, 30)]], axis=1)
    for sequence in range(500):
        poses[:10, :3] += random.uniform(-4e-5, 4e-5, (10, 3))
        sent = state(poses, np.full(20, 1e-6 * sequence), sequence)
        check(sent, decoder.decode(encoder.encode(sent)))
    still = encoder.encode(sent)
    assert (still.joint_targets, still.poses) == (b"", b"")
    poses[29, 2] += 1e-3
    assert len(encoder.encode(state(poses, np.full(20, 1e-6 * sequence))).poses) == 8


def test_nan_and_large_values_do_not_affect_other_rows() -> None:
    encoder, decoder = StateEncoder(), StateDecoder()
    poses = np.tile([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0], (3, 1))
    for wrong in (np.nan, np.inf, -np.inf, 1e30):
        poses[1, 0] = wrong
        told = numbers(decoder.decode(encoder.encode(state(poses))).poses, 7)
        np.testing.assert_allclose(told[[0, 2]], poses[[0, 2]])
        assert abs(told[1, 0]) == pytest.approx(MAX_QUANTISATION_STEPS * POSITION_STEP_M)
    poses[1, 0] = 0.25
    check(state(poses), decoder.decode(encoder.encode(state(poses))))


def test_angles_are_within_half_a_step() -> None:
    """The farthest that rounding four numbers turns a unit quaternion: twice the half diagonal of a step's cube."""
    assert 2.0 * 0.5 * QUATERNION_QUANTISATION_STEP * np.sqrt(4.0) <= ROTATION_RAD
    assert len(POSE_QUANTISATION_STEPS) == 7


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.fast_cases(3)
def test_states_of_moving_worlds_are_small_and_exact(environment: str) -> None:
    """Person and robot move at random, more than anybody does."""
    random = np.random.default_rng(0)
    world, encoder, decoder = LiveWorld(environment, Person("woman", 0.55)), StateEncoder(), StateDecoder()
    targets_rad, sizes = world.joint_targets_rad, []
    for sequence in range(30):
        targets_rad = targets_rad + random.normal(0.0, 0.005, targets_rad.shape)
        world.simulation.command_person(targets_rad[None])
        world.simulation.command_robot(random.uniform(-1.0, 1.0, (1, world._episodes.action_size)))
        world.tick(None)
        sent = state(numbers(world.encode_poses(), 7), targets_rad, sequence)
        change = encoder.encode(sent)
        sizes.append(len(messages.encode_message(change)))
        check(sent, decoder.decode(change))
    print(f"{environment}: {sizes[0]} bytes after the scene, then {max(sizes[1:])} at most")
    assert max(sizes[1:]) <= MOST_BYTES
