"""The configuration of a trial: the first record of its recording. Replay recomputes the trial from it."""

from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from avrgym.commands.preferences import TrialRules
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Person, Sex
from avrgym.questionnaires.questionnaire import Item
from avrgym.questionnaires.stop_rules import StopRule
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.recording.schema import Pose
from avrgym.system.used_plugins import UsedPlugin
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.tasks.task import EpisodeStart

FORMAT_VERSION = 1


class BodyModel(msgspec.Struct, frozen=True):
    """Parameters of the body model that represents the participant."""

    sex: Sex
    torso_height_m: Annotated[float, Meta(description="From the hip bone to the centre of the head.")]
    skin_tone: str
    arm_scale: Annotated[float, Meta(description="Length of the arms, relative to this torso height.")] = 1.0


class Versions(msgspec.Struct, frozen=True):
    """Versions of AVR Gym and MuJoCo. The recorded numbers depend on them."""

    avrgym: str
    mujoco: str

    def __str__(self) -> str:
        return f"AVR Gym {self.avrgym}, MuJoCo {self.mujoco}"


class RecordedConsent(msgspec.Struct, frozen=True, omit_defaults=True):
    """A participant's consent to the study. A field is ``None`` if the study did not store it."""

    decided_at: Annotated[str, Meta(description="Time of the consent: ISO 8601, UTC.")] = msgspec.field(
        name="at"
    )
    version: str | None = None
    language: str | None = None
    sha256: Annotated[str | None, Meta(description="Checksum of the consent text.")] = None
    role: Annotated[
        str | None,
        Meta(
            description="`proxy` (a representative) or `assent` (the participant); otherwise the participant's own."
        ),
    ] = None


class TrackingQuality(msgspec.Struct, frozen=True):
    """The tracking quality of the head or of one hand in the headset check."""

    modality: Annotated[
        str, Meta(description="`headset`, `controller`, `hand` (bare), `mouse`, `rests` or `none`.")
    ] = msgspec.field(name="with")
    tracked_share: Annotated[float, Meta(description="Share of the frames in which it was tracked.")] = (
        msgspec.field(name="share")
    )
    jitter_mm: Annotated[
        float | None,
        Meta(description="At rest: root-mean-square distance from parabolas through half a second."),
    ] = None
    reach_m: Annotated[float | None, Meta(description="Largest distance of the hand from the head.")] = None


class HeadsetCheck(msgspec.Struct, frozen=True):
    """The measurements of the headset check. A value is ``None`` if it was not measured."""

    device: Annotated[str, Meta(description="Name of the device, as the browser reports it.")]
    emulated: bool
    profiles: Annotated[
        list[str], Meta(description="WebXR profiles of the controllers, as the browser reports them.")
    ]
    display_hz: float | None
    duration_s: Annotated[float, Meta(description="Duration of the measurement.")] = msgspec.field(
        name="seconds"
    )
    num_frames: int = msgspec.field(name="frames")
    frame_rate_hz: float
    dropped_share: float
    latency_ms: Annotated[
        dict[str, dict[str, float]], Meta(description="Percentiles of each stage of `/latency`.")
    ]
    head: TrackingQuality
    left: TrackingQuality
    right: TrackingQuality
    vibration_felt: Annotated[
        bool | None, Meta(description="Whether the participant felt the vibration.")
    ] = msgspec.field(default=None, name="haptics")
    sound_heard: Annotated[bool | None, Meta(description="Whether the participant heard the sound.")] = (
        msgspec.field(default=None, name="sound")
    )
    stop_method: Annotated[
        str | None, Meta(description="Stop method that the participant tried, or `none`.")
    ] = msgspec.field(default=None, name="stop")
    stop_delay_s: Annotated[float | None, Meta(description="Time from the request to the stop.")] = (
        msgspec.field(default=None, name="stop_after_s")
    )


class TrialConfiguration(msgspec.Struct, frozen=True, kw_only=True):
    """All parameters of a trial. With them, replay recomputes the trial without random numbers.

    Fields with a default are missing in recordings of AVR Gym 0.2.
    """

    format_version: Annotated[int, Meta(description="Version of this table.")] = FORMAT_VERSION
    session: Annotated[str, Meta(description="Name of the session: `sub-001 ses-01` in a study.")]
    environment: str
    policy: str
    seed: Annotated[int, Meta(description="Seed from which the start of the episode was drawn.")]
    practice: bool
    goal: Annotated[str, Meta(description="The instruction, in the participant's language.")]
    needed_parts: Annotated[
        tuple[str, ...], Meta(description="The parts that the task needs: `head`, `left`, `right`.")
    ] = msgspec.field(name="tracked")
    trial_number: Annotated[int, Meta(description="Number of the trial in the session, from 1.")] = (
        msgspec.field(name="trial")
    )
    attempt_number: Annotated[int, Meta(description="Number of the attempt at the trial, from 1.")] = (
        msgspec.field(name="attempt")
    )
    planned_steps: Annotated[int, Meta(description="Planned number of control steps.")] = msgspec.field(
        name="steps"
    )
    simulated: Annotated[bool, Meta(description="Whether the participant is simulated.")]
    person: BodyModel
    start_angles_rad: Annotated[
        tuple[float, ...],
        Meta(description="The person's joint angles at the start, in the order of `joints`."),
    ] = msgspec.field(name="start_rad")
    episode_start: EpisodeStart = msgspec.field(name="start")
    joint_names: Annotated[tuple[str, ...], Meta(description="The joints of the person.")] = msgspec.field(
        name="joints"
    )
    body_names: Annotated[tuple[str, ...], Meta(description="The bodies of the scene.")] = msgspec.field(
        name="bodies"
    )
    xr_from_world: Annotated[Pose, Meta(description="Pose of the simulated world in `local-floor`.")]
    language: str
    force_guard: bool
    withdraw_after_success: bool
    free_movement_s: Annotated[
        float | None, Meta(description="Duration of free movement before and after the trial.")
    ] = None
    stop_rules: Annotated[tuple[StopRule, ...] | None, Meta(description="The stop rules of the study.")] = (
        None
    )
    headset_check: HeadsetCheck | None = None
    consent: RecordedConsent | None = None
    proxy_consent: Annotated[
        RecordedConsent | None, Meta(description="Consent of a representative; `consent` is then the assent.")
    ] = None
    respondent: Annotated[
        str, Meta(description="Person who answers the questionnaires: `participant` or `proxy`.")
    ] = "participant"
    input_profile: Annotated[
        InputProfile, Meta(description="Input profile of the participant at the start of the trial.")
    ] = DEFAULT_INPUT_PROFILE
    settings: Annotated[
        Settings, Meta(description="Settings of the environment that differ from the defaults.")
    ] = DEFAULT_SETTINGS
    trial_rules: Annotated[
        TrialRules | None, Meta(description="Allowed commands, input sources and preferences of the trial.")
    ] = msgspec.field(default=None, name="rules")
    furniture: RealFurniture
    reward_weights: dict[str, float]
    items: Annotated[tuple[Item, ...], Meta(description="The questions after the trial, in order.")]
    motion_version: Annotated[
        int, Meta(description="Version of the motion of simulated participants. 2: `people.motor`.")
    ] = 1
    versions: Versions
    plugins: tuple[UsedPlugin, ...]
    world_version: Annotated[int, Meta(description="Replay needs the same version of the simulated world.")]
    c_library: Annotated[str, Meta(description="Fingerprint of the rounding of the C library.")]

    @property
    def start_person(self) -> Person:
        """The person at the start of the episode. Raises ``ValueError`` if the values are outside the limits of the
        body model."""
        return Person(
            **msgspec.structs.asdict(self.person),
            joint_angles_rad=np.array(self.start_angles_rad, float),
            absent_arms=self.input_profile.absent_arms,
        )


def parse_configuration(values: Mapping[str, Any]) -> TrialConfiguration:
    """Returns the configuration from the values of a metadata record.

    Raises:
        ValueError: for missing or invalid fields, or for a newer format version.
    """
    version = values.get("format_version", FORMAT_VERSION)
    if isinstance(version, int) and version > FORMAT_VERSION:
        raise ValueError(
            f"its format version is {version}; allowed: up to {FORMAT_VERSION}; run `pip install --upgrade avrgym`"
        )
    return msgspec.convert(values, TrialConfiguration)
