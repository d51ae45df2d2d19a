"""Defines the state of N worlds for tasks and observations, and the initial states of episodes."""

from collections.abc import Mapping
from dataclasses import dataclass

from avrgym.array_types import FloatArray
from avrgym.models.human import People


@dataclass(frozen=True)
class RightArmPoses:
    """Poses of upper arm, forearm and hand: positions of shoulder, elbow and wrist (N, 3, 3), quaternions (N, 3, 4).

    World frame, metres.
    """

    right_arm_pos_w: FloatArray
    right_arm_quat_w: FloatArray


@dataclass(frozen=True)
class ArmPoses(RightArmPoses):
    """Poses of the right and the left arm, as in ``RightArmPoses``."""

    left_arm_pos_w: FloatArray
    left_arm_quat_w: FloatArray


@dataclass(frozen=True)
class State(ArmPoses):
    """The state of N worlds at one instant; metres, seconds, radians, newtons, world frame.

    Positions are (N, 3), quaternions (N, 4). ``joint_positions`` (N, J) are radians or metres. ``base_displacement``
    (N, 3) is x, y (m) and yaw (rad) of a driving base in the frame of its start; (N, 0) for other robots.
    ``robot_torso_pos_w`` is the robot's torso, or its base if it has no torso. The pad is the part of the tool that
    touches people, see ``models.tools.Tool.contact_body``. ``furniture_pos_w`` contains the positions of movable
    furniture by name of the body. ``particle_*`` have shape (N, K, 3). The person's body consists of G capsules, in
    the order of ``human.GEOMS``: ``person_capsule_ends_w`` (N, G, 2, 3) are the ends of their axes,
    ``person_radius_m`` (N, G) their radii. ``tool_contact_*`` (N, ``MAX_TOOL_CONTACTS``, …) are the tool's strongest
    contacts with the person. Unused
    rows have force zero. Normals point from the tool to the person. ``cloth_pos_w`` (N, V, 3) are the vertices of the
    tool's cloth.

    Forces on the person, (N,): ``robot_force_n`` (robot and tool) and ``tool_force_n`` (tool) are magnitudes of net
    forces, in which opposite forces cancel out. ``total_force_n`` (robot and tool) and ``links_force_n`` (links only)
    are sums of the magnitudes of all contact forces. The tool includes its cloth; ``cloth_force_n`` is this sum for the
    cloth alone.
    """

    robot_torso_pos_w: FloatArray
    joint_positions: FloatArray
    base_displacement: FloatArray
    end_effector_velocity_w: FloatArray
    tool_velocity_w: FloatArray
    tool_pos_w: FloatArray
    tool_quat_w: FloatArray
    tool_pad_pos_w: FloatArray
    tool_pad_quat_w: FloatArray
    head_pos_w: FloatArray
    head_quat_w: FloatArray
    mouth_pos_w: FloatArray
    furniture_pos_w: Mapping[str, FloatArray]
    particle_pos_w: FloatArray
    particle_velocity_w: FloatArray
    cloth_pos_w: FloatArray
    person_capsule_ends_w: FloatArray
    person_radius_m: FloatArray
    robot_force_n: FloatArray
    tool_force_n: FloatArray
    total_force_n: FloatArray
    links_force_n: FloatArray
    cloth_force_n: FloatArray
    tool_contact_pos_w: FloatArray
    tool_contact_normal_w: FloatArray
    tool_contact_force_n: FloatArray


@dataclass(frozen=True)
class InitialState:
    """The initial state of n worlds; world frame.

    Attributes:
        people: body parameters of the people (n,).
        robot_base_pos_w: positions (n, 3) of the robot's base.
        robot_base_quat_w: quaternions (n, 4) of the robot's base.
        joint_positions: joint positions (n, J) of the arm.
        furniture_pos_w: positions (n, 3) of the scene's movable furniture, by body.
        tool_position_error_m: distance (n,) of the tool from its intended position, if the scene checks the reach.
    """

    people: People
    robot_base_pos_w: FloatArray
    robot_base_quat_w: FloatArray
    joint_positions: FloatArray
    furniture_pos_w: Mapping[str, FloatArray]
    tool_position_error_m: FloatArray | None = None
