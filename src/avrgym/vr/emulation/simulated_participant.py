"""Simulated participants send the tracking frames of a headset and answer the questionnaire.

Simulated participants sit or lie, sway, and move mouth or arm to the tool. A behaviour model of ``people`` or a trained
policy determines the goals of their motion. The motor model ``population_names.motor_model`` executes the motion. All
data of simulated participants are marked as simulated.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.commands.vocabulary import CommandSource
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.body_names import Side
from avrgym.models.furniture.real_furniture import DEFAULT_FURNITURE, RealFurniture
from avrgym.models.human import JOINT_INDEX, JOINTS, SEATED_POSE_RAD, SEATED_POSTURE, Person, Sex
from avrgym.models.scene import CONTROL_STEP_S, PHYSICS_STEP_S, SCENE_TOOL_BODY
from avrgym.networks.policy import Policy
from avrgym.people import cooperation, distributions, impaired_motion, impairments, motor_model
from avrgym.people.clinical_impairments import sample_motor_signs
from avrgym.people.distributions import POPULATION_DISTRIBUTIONS, PeopleDistribution
from avrgym.people.impaired_motion import MotorSigns
from avrgym.people.motor_model import MotorState
from avrgym.people.population_names import ImpairmentName
from avrgym.people.zoo import partner_behaviour, partners
from avrgym.system import random_streams
from avrgym.tasks.human_observation import HumanObservationInputs, HumanObserver
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.vr.emulation.simulated_commands import (
    CommandTraits,
    SimulatedCommandGenerator,
    compute_gesture_angles_rad,
    sample_command_traits,
)
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose
from avrgym.vr.protocol.webxr import Pose, Registration, convert_hand_to_grip, convert_head_to_headset
from avrgym.vr.session.attempt import AttemptResults

PARTICIPANT_DISTRIBUTION = POPULATION_DISTRIBUTIONS["participants"]
"""The distribution of the paper's participants."""
MIN_POSE_DIFFERENCE_M = 1e-9
"""Minimum difference in metres between consecutive measured positions. Real trackers never measure identical poses."""
LOOK_AT_ARM_OFFSET_RAD = human.make_seated_joint_angles(
    head_x=35.0, head_z=-40.0
) - human.make_seated_joint_angles(head_x=0.0, head_z=0.0)
"""Change of the joint angles (20,), in radians, with which a participant looks at the right arm."""
SWAY_STOP_TIME_S = 0.5
"""Time in seconds from the start of holding still until sway and tremor end."""
MAX_MOTION_STEP_S = 1.0
"""Maximum duration in seconds of the motion that is computed between two tracking frames."""
RATING_OFFSET_STD, RATING_NOISE_STD = 0.08, 0.1
"""Standard deviations of ratings as shares of the scale: between participants, and between answers of one
participant."""

RATING_RULES: Mapping[str, Callable[[AttemptResults], float]] = {
    "L1": lambda results: 0.9 if results.success else 0.15,
    "L2": lambda results: 1.0 - results.force_mean_n / 20.0 - results.tool_speed_mean_m_s / 1.0,
    "L3": lambda results: 1.0 - results.force_max_n / 60.0,
    "L4": lambda results: 1.0 - abs(results.tool_speed_mean_m_s - 0.1) / 0.3,
}
"""Function of each item of the paper that returns a rating as a share of the scale. The rating of help depends on
success, and the rating of comfort on mean force and speed. The rating of safety depends on the maximum force, and the
rating of speed on the difference from 0.1 m/s. The constants are assumptions."""


@dataclass(frozen=True)
class ParticipantTraits:
    """Body and behaviour of a simulated participant.

    Attributes:
        sex: sex of the body model.
        torso_height_m: distance in metres from the hip bone to the centre of the head.
        sway_amplitude_deg: amplitude of the slow movement of the waist.
        sway_frequency_hz: frequency of the slow movement of the waist.
        lean_deg: forward lean of the torso at rest.
        arm_offset_deg: backward offset of the arms.
        cooperation_fraction: distance that mouth or arm moves towards the tool, as a share (0 to 1) of the whole
            distance.
        reaction_time_s: delay of the movement towards the tool.
        rating_offset: offset of all ratings, as a share of the scale.
        command_traits: traits of the commands to the robot.
        behaviour_parameters: parameters, arrays (1,), of a partner model that replaces the default behaviour; ``None``
            without a partner model.
        trained_policy: a trained policy that replaces the default behaviour; ``None`` without a policy.
        range_share: joint ranges, see ``People``.
        strength_share: strength, see ``People``; it scales the movement.
        tremor_amplitude_rad: amplitude (20,) of the tremor, see ``People``.
        motor_signs: motor signs of a clinical impairment; ``None`` without an impairment.
    """

    sex: Sex
    torso_height_m: float
    sway_amplitude_deg: float
    sway_frequency_hz: float
    lean_deg: float
    arm_offset_deg: float
    cooperation_fraction: float
    reaction_time_s: float
    rating_offset: float
    command_traits: CommandTraits = CommandTraits()  # noqa: RUF009
    behaviour_parameters: partners.BehaviourParameters | None = None
    trained_policy: Policy | None = None
    range_share: float = 1.0
    strength_share: float = 1.0
    tremor_amplitude_rad: FloatArray = field(default_factory=lambda: np.zeros(len(JOINTS)))
    motor_signs: MotorSigns | None = None


def sample_participant_traits(
    sex: Sex,
    seed: int,
    distribution: PeopleDistribution = PARTICIPANT_DISTRIBUTION,
    impairment: ImpairmentName = "none",
    trained: Policy | None = None,
) -> ParticipantTraits:
    """Returns random traits of a participant from ``distribution`` (default: the paper's participants).

    ``trained`` is a policy that controls the participant.
    """
    random = random_streams.make_participant_trait_rng(seed)
    heights_m = distribution.torso_height_woman_m if sex == "woman" else distribution.torso_height_man_m
    traits = ParticipantTraits(
        sex=sex,
        torso_height_m=float(random.uniform(*heights_m)),
        sway_amplitude_deg=float(random.uniform(0.3, 1.0)),
        sway_frequency_hz=float(random.uniform(0.1, 0.3)),
        lean_deg=float(random.uniform(-2.0, 5.0)),
        arm_offset_deg=float(random.uniform(-8.0, 8.0)),
        cooperation_fraction=float(random.uniform(0.0, 1.0)),
        reaction_time_s=float(random.uniform(0.2, 0.4)),
        rating_offset=float(random.normal(0.0, RATING_OFFSET_STD)),
        command_traits=sample_command_traits(seed),
    )
    if not distribution.is_moving:
        traits = replace(traits, sway_amplitude_deg=0.0, cooperation_fraction=0.0)
    traits = _with_body(traits, random, distribution, impairment)
    return traits if trained is None else replace(traits, behaviour_parameters=None, trained_policy=trained)


def _with_body(
    traits: ParticipantTraits,
    random: np.random.Generator,
    distribution: PeopleDistribution,
    impairment: ImpairmentName,
) -> ParticipantTraits:
    """Returns the traits, with joint ranges, strength and tremor of the impairment and the partner model (if any)."""
    body, partner = distributions.repeat_person(Person(traits.sex, traits.torso_height_m), 1), None
    if distribution.partners is not None:
        partner = distribution.partners.sample(random.random((1, 2)))
        body = partners.apply_partner_bodies(body, partner)
    uniforms = random.random((1, impairments.NUM_RANDOM_NUMBERS))
    body = impairments.apply_impairment(body, impairment, uniforms)
    return replace(
        traits,
        behaviour_parameters=partner,
        range_share=float(body.range_share[0]),
        strength_share=float(body.strength_share[0]),
        tremor_amplitude_rad=body.tremor_rad[0],
        motor_signs=sample_motor_signs(impairment, uniforms)
        if impairments.is_clinical_impairment(impairment)
        else None,
    )


@dataclass(frozen=True)
class _Observation:
    """Inputs of a behaviour model for one person: poses of tool and body. See
    ``people.cooperation.PersonObservation``."""

    tool_pos_w: FloatArray
    head_pos_w: FloatArray
    mouth_pos_w: FloatArray
    right_arm_pos_w: FloatArray


class SimulatedParticipant:
    """A simulated participant. The room's origin and direction differ from those of the simulation.

    The participant is seated until ``adopt_posture`` is called.
    """

    def __init__(
        self, traits: ParticipantTraits, seed: int, furniture: RealFurniture = DEFAULT_FURNITURE
    ) -> None:
        """Create a participant. ``furniture``: the room's real furniture, which determines the height of the head."""
        random = random_streams.make_participant_motion_rng(seed)
        self.traits = traits
        self._random = random
        self._furniture = furniture
        self._room = Registration(
            np.array([*random.uniform(-0.3, 0.3, 2), 0.0]), float(random.uniform(-np.pi, np.pi))
        )
        self._phase = random.uniform(0.0, 2.0 * np.pi, 3)[None, :2]
        self._chance = random_streams.make_participant_behaviour_rng(seed).random((1, 4))
        self._action_generator = random_streams.make_participant_noise_rng(seed)
        self.command_generator = SimulatedCommandGenerator(traits.command_traits, seed)
        self._gesture: tuple[CommandSource, float] = "nod", -np.inf
        self._sequence = -1
        self._measured: dict[str, XRPose] = {}
        self._moved_s: float | None = None
        self._moving = self._watching = False
        self._bodies: list[str] = []
        self._environment = "", DEFAULT_SETTINGS
        self._offered: cooperation.OfferedBodyPart = "mouth"
        self._rest(SEATED_POSTURE, SEATED_POSE_RAD)

    def adopt_posture(self, environment_id: str, settings: Settings = DEFAULT_SETTINGS) -> None:
        """Sit or lie as in an environment with these settings. A second call with the same arguments has no effect.

        Raises:
            ValueError: for an unknown environment. The message lists the allowed ids.
        """
        if (environment_id, settings) == self._environment:
            return
        task, scene = find_task_and_scene(environment_id, settings)
        self._environment, self._offered = (environment_id, settings), task.offered_body_part
        self._view = HumanObserver(task.offered_body_part, task.make_observation_spec(scene))
        self._rest(scene.posture, task.pose_distribution.rest_angles_rad)

    def receive(self, message: messages.Message) -> None:
        """Handle a message of the server. It may contain the bodies, the start of a trial, or the tool's pose."""
        if isinstance(message, messages.Scene):
            self._bodies = message.bodies
        elif isinstance(message, messages.PhaseDescription) and message.name == "free_before":
            self._reset_behaviour()
        elif isinstance(message, messages.WorldState) and SCENE_TOOL_BODY in self._bodies:
            self._observe_tool(message)

    def _rest(self, posture: human.Posture, rest_rad: FloatArray) -> None:
        traits = self.traits
        people = distributions.repeat_person(Person(traits.sex, traits.torso_height_m, rest_rad), 1)
        people = replace(people, tremor_rad=traits.tremor_amplitude_rad[None])
        self._people = impairments.limit_joint_ranges(people, np.array([traits.range_share]))
        person = self._people.get_person(0)
        self._posture, self._rest_rad = posture, person.joint_angles_rad
        self._held_rad = self._angles_rad = self._rest_rad
        self._sway_share = 0.0
        higher_m = self._furniture.compute_head_height_offset_m(posture, person.torso_height_m)
        self._room = replace(self._room, origin_w=np.array([*self._room.origin_w[:2], -higher_m]))
        self._sites = human.compute_body_layout(self._people.is_woman, self._people.torso_height_m).site_pos
        self._model = human.compile_person_model(person, posture, moving=True)
        self._data = mujoco.MjData(self._model)
        self._reset_behaviour()
        self._motor = self._motor_state()
        self._impaired_state = impaired_motion.make_initial_state(self._rest_rad[None])

    def _reset_behaviour(self) -> None:
        """Resets the behaviour model to its initial state. The participant's pose does not change."""
        self._behaviour_state: cooperation.CooperationState | partner_behaviour.PartnerState
        if self.traits.behaviour_parameters is not None:
            self._behaviour_state = partner_behaviour.make_initial_state(
                self._people, self.traits.behaviour_parameters, self._chance
            )
        else:
            mind = cooperation.make_initial_state(
                self._people, np.full((1, cooperation.NUM_RANDOM_NUMBERS), 0.5)
            )
            self._behaviour_state = replace(
                mind, reaction_delay_steps=np.array([round(self.traits.reaction_time_s / CONTROL_STEP_S)])
            )
        self._wanted_rad = self._rest_rad[None]
        self._next_look_s = -np.inf

    def _motor_state(self) -> MotorState:
        """Returns the state of the motor model at rest."""
        traits, mind = self.traits, self._behaviour_state
        if isinstance(mind, partner_behaviour.PartnerState):
            return partner_behaviour.make_initial_motor_state(mind, self._people)
        sway_rad, none = np.radians([traits.sway_amplitude_deg]), np.zeros(1)
        rhythms = motor_model.sample_rhythms(
            sway_rad, np.array([traits.sway_frequency_hz]), self._phase, none, none, self._chance[:, :2]
        )
        return motor_model.make_initial_state(
            self._people, rhythms if sway_rad.any() else None, np.ones(1), self._chance[:, 1:]
        )

    def _observe_tool(self, state: messages.WorldState) -> None:
        """Observes the tool and updates the goals of the motion, ten times a second."""
        if state.simulation_time_s < self._next_look_s:
            return
        self._next_look_s = state.simulation_time_s + CONTROL_STEP_S
        poses = np.frombuffer(state.poses, "<f4").reshape(-1, 7).astype(float)
        bodies, marks_w = dict(zip(self._bodies, poses, strict=False)), poses[len(self._bodies) :, :3]
        observation = self._observation(bodies)
        mind = replace(self._behaviour_state, joint_targets_rad=self._motor.second_filter_angles_rad)
        if self.traits.trained_policy is not None:
            self._act(self.traits.trained_policy, observation, bodies, marks_w)
        elif isinstance(mind, partner_behaviour.PartnerState):
            self._behaviour_state, self._wanted_rad = partner_behaviour.choose_goal_angles(
                mind, observation, self._offered, self._posture
            )
        else:
            self._behaviour_state, self._wanted_rad = cooperation.choose_goal_angles(
                mind, self._wanted_rad, observation, self._offered, self._posture
            )
        self._aim()

    def _act(
        self,
        trained: Policy,
        observation: _Observation,
        bodies: Mapping[str, FloatArray],
        marks_w: FloatArray,
    ) -> None:
        """Applies an action of the policy for 0.1 s. Forces in the policy's observation are 0, because VR has no force
        feedback."""
        hips, head, tool = (
            bodies[human.PERSON_NAME_PREFIX + "hips"],
            bodies[human.PERSON_NAME_PREFIX + "head"],
            bodies[SCENE_TOOL_BODY],
        )
        marked = [tool[None, :3] - marks_w[0] for _ in self._view.goal_entries] if len(marks_w) else None
        seen = HumanObservationInputs(
            hips_pos_w=hips[None, :3],
            hips_quat_w=hips[None, 3:],
            tool_pos_w=tool[None, :3],
            tool_quat_w=tool[None, 3:],
            tool_goal_offsets_w=marked
            or [entry.compute(cast("Any", observation), None) for entry in self._view.goal_entries],
            joint_angles_rad=self._held_rad[None],
            arm_pos_w=_arm_pos_w(bodies, "left")
            if self._offered == "left_arm"
            else observation.right_arm_pos_w,
            head_pos_w=np.atleast_2d(observation.head_pos_w),
            head_quat_w=head[None, 3:],
            total_force_n=np.zeros(1),
            tool_force_n=np.zeros(1),
        )
        action = trained.act(self._view.compute(seen), [self._action_generator])
        joints = cooperation.OFFERED_JOINTS[self._offered]
        targets = partner_behaviour.move_joint_targets(self._wanted_rad, joints, action.astype(float))
        self._wanted_rad = self._clip_to_ranges(targets)

    def _observation(self, bodies: Mapping[str, FloatArray]) -> _Observation:
        """Returns the inputs of the behaviour model. ``bodies``: poses (7,) in the world frame, by body name."""
        head = bodies[human.PERSON_NAME_PREFIX + "head"]
        head_centre, mouth = (
            head[:3] + transforms.rotate(head[3:], self._sites[name]) for name in ("head_centre", "mouth")
        )
        return _Observation(
            bodies[SCENE_TOOL_BODY][None, :3], head_centre, mouth, _arm_pos_w(bodies, "right")
        )

    def make_tracking_frame(
        self, time_s: float, *, moving: bool, watching: bool = False
    ) -> TrackingFrameMessage:
        """Returns the tracking frame at a time.

        With ``moving``, the participant sways and reacts to the robot; otherwise the participant holds still. With
        ``watching``, the participant looks at the arm if the task needs the right arm.
        """
        if (moving, watching) != (self._moving, self._watching):
            self._moving, self._watching = moving, watching
            self._aim()
        angles = self._move_until(time_s)
        pitch, yaw = compute_gesture_angles_rad(self._gesture[0], time_s - self._gesture[1])
        if pitch or yaw:
            angles = angles.copy()
            angles[[JOINT_INDEX["head_x"], JOINT_INDEX["head_z"]]] += pitch, yaw
            angles = self._clip_to_ranges(angles[None])[0]
        return self.make_tracking_frame_from_angles(angles, time_s)

    def begin_gesture(self, gesture: CommandSource, time_s: float) -> None:
        """Begin a nod or a shake of the head at this time."""
        self._gesture = gesture, time_s

    def make_tracking_frame_from_angles(
        self, joint_angles_rad: FloatArray, time_s: float
    ) -> TrackingFrameMessage:
        """Returns the tracking frame of a body with joint angles (20,), captured at ``time_s``."""
        self._held_rad = joint_angles_rad
        self._data.qpos[:] = joint_angles_rad
        mujoco.mj_kinematics(self._model, self._data)
        self._sequence += 1
        return TrackingFrameMessage(
            sequence=self._sequence,
            client_time_ms=1000.0 * time_s,
            head=self._measure(
                "head", convert_head_to_headset(self._room, self._pose("head_centre", "head"))
            ),
            left=self._measure("left", self._grip("left")),
            right=self._measure("right", self._grip("right")),
            left_modality="controller",
            right_modality="controller",
        )

    def rate_item(self, item: str, points: int, results: AttemptResults) -> int:
        """Returns a rating, 1 to ``points``, by the item's function in ``RATING_RULES``.

        The ratings of all other items are near the middle of the scale.
        """
        wanted = RATING_RULES[item](results) if item in RATING_RULES else 0.5
        share = wanted + self.traits.rating_offset + self._random.normal(0.0, RATING_NOISE_STD)
        return 1 + round(min(max(share, 0.0), 1.0) * (points - 1))

    def _aim(self) -> None:
        """Sets the goal of the motor model: the rest pose, or the joint angles that the behaviour model returns."""
        traits, mind, startled = self.traits, self._behaviour_state, None
        goal = self._rest_rad[None]
        if self._moving:
            way = traits.strength_share * (self._wanted_rad - goal)
            if isinstance(mind, partner_behaviour.PartnerState):
                startled = partner_behaviour.are_startled(mind)
            elif traits.trained_policy is None:
                way = traits.cooperation_fraction * way + self._stance_rad()
            goal = goal + way
        if self._watching and self._offered == "arm":
            goal = goal + LOOK_AT_ARM_OFFSET_RAD
        self._motor = motor_model.set_goal_angles(self._motor, self._clip_to_ranges(goal), startled)

    def _move_until(self, time_s: float) -> FloatArray:
        """Returns the joint angles (20,) in radians at a time. The motion advances in steps of 10 ms."""
        if self._moved_s is None or time_s - self._moved_s > MAX_MOTION_STEP_S:
            self._moved_s = time_s - (0.0 if self._moved_s is None else MAX_MOTION_STEP_S)
        steps = int((time_s - self._moved_s) / PHYSICS_STEP_S + 1e-6)
        if steps > 0:
            passed_s = steps * PHYSICS_STEP_S
            self._moved_s += passed_s
            self._motor, targets = motor_model.advance_joint_targets_rad(self._motor, steps)
            change = passed_s / SWAY_STOP_TIME_S
            self._sway_share += float(np.clip(float(self._moving) - self._sway_share, -change, change))
            moved = self._motor.second_filter_angles_rad
            angles = moved + self._sway_share * (targets[-1] - moved)
            self._angles_rad = self._clip_to_ranges(self._impaired(angles, min(passed_s, CONTROL_STEP_S)))[0]
        return self._angles_rad

    def _impaired(self, joint_angles_rad: FloatArray, step_s: float) -> FloatArray:
        """Returns the joint angles (1, 20) that the participant executes, with the motor signs of a clinical
        impairment."""
        if self.traits.motor_signs is None:
            return joint_angles_rad
        self._impaired_state, executed = impaired_motion.step_impaired_motion(
            self.traits.motor_signs, self._impaired_state, joint_angles_rad, self._rest_rad[None], step_s
        )
        return executed

    def _clip_to_ranges(self, joint_angles_rad: FloatArray) -> FloatArray:
        """Returns joint angles (1, 20) clipped to the participant's joint ranges."""
        return impairments.clip_to_joint_ranges(self._people, joint_angles_rad)

    def _stance_rad(self) -> FloatArray:
        """Returns the change of the joint angles (20,) in radians by lean and arm posture."""
        traits = self.traits
        stance = human.make_seated_joint_angles(
            waist_x=traits.lean_deg,
            head_x=-traits.lean_deg,
            right_shoulder_x=-10.0 + traits.arm_offset_deg,
            left_shoulder_x=-10.0 + traits.arm_offset_deg,
        )
        return stance - SEATED_POSE_RAD

    def _measure(self, part: str, pose: XRPose) -> XRPose:
        """Returns the measured pose of a body part. It differs at least slightly from the previous measured pose."""
        if pose == self._measured.get(part):
            x, y, z = pose.position
            pose = XRPose((x + MIN_POSE_DIFFERENCE_M, y, z), pose.orientation)
        self._measured[part] = pose
        return pose

    def _grip(self, side: str) -> XRPose:
        return convert_hand_to_grip(self._room, self._pose(f"{side}_hand_centre", f"{side}_hand"))

    def _pose(self, site: str, body: str) -> Pose:
        return Pose(
            self._data.site(human.PERSON_NAME_PREFIX + site).xpos.copy(),
            self._data.body(human.PERSON_NAME_PREFIX + body).xquat.copy(),
        )


def _arm_pos_w(bodies: Mapping[str, FloatArray], arm: Side) -> FloatArray:
    """Returns the positions (1, 3, 3) of shoulder, elbow and wrist, in metres in the world frame.

    ``bodies``: poses (7,) of bodies, by body name.
    """
    return np.stack([bodies[human.PERSON_NAME_PREFIX + part][:3] for part in human.ARM_BODIES[arm]])[None]
