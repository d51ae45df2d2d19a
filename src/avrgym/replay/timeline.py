"""Data of a replay page: poses over time, control steps and events."""

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from avrgym.models.human import Person
from avrgym.questionnaires.questionnaire import Item
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Answer
from avrgym.replay.playback import ComparedState, Playback, find_phase_start_times, format_title
from avrgym.tasks.settings import Settings
from avrgym.vr.live_world.scene_message import encode_world_poses, make_scene_message
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.scene.export_process import export_scene
from avrgym.vr.session.trial_worlds import make_resting_person

STATES_PER_FRAME = 2
"""Number of states per frame: every second state, 50 frames per second. The page interpolates between frames."""


class TimelineEvent(msgspec.Struct, frozen=True):
    """An event or an answer as text. ``kind`` is ``event``, ``answer``, or the name of the phase that starts at this
    time.
    """

    time_s: float
    kind: str
    text: str


class StepSeries(msgspec.Struct, frozen=True):
    """Results of the control steps: lists with one entry for each step.

    ``time_s``: end of the step. ``reward``: reward accumulated up to this step. ``force_n``: force on the person.
    ``distance_m``: distance of the tool from its goal. ``success``: whether the task has succeeded.
    """

    time_s: list[float]
    reward: list[float]
    force_n: list[float]
    distance_m: list[float]
    success: list[bool]


class Timeline(msgspec.Struct, frozen=True):
    """A trial as data for a replay page. Times are in seconds from the start of the trial.

    ``complete``: whether the recording contains the whole trial. ``result``: result of the attempt. ``seconds``:
    duration of the trial. ``facts``: further information by heading. ``frames_s``: time of each frame.

    The poses of the frames are stored separately, as 32-bit floats. A frame has a pose for each body of ``scene``
    and each mark on the person: position x, y, z, then quaternion w, x, y, z.
    """

    title: str
    simulated: bool
    complete: bool
    result: str | None
    seconds: float
    facts: dict[str, str]
    scene: messages.Scene
    frames_s: list[float]
    steps: StepSeries
    events: list[TimelineEvent]


def build_timeline(recording: Recording, progress: Callable[[], None]) -> tuple[Timeline, bytes]:
    """Returns the timeline of a recording, and the poses of its frames; see ``Timeline``.

    Args:
        recording: the recording of one attempt.
        progress: called after each recorded state.

    Raises:
        ValueError: if the recording cannot be recomputed.
    """
    playback = Playback(recording)
    frames_s, frames = _frames(playback, progress)
    timeline = Timeline(
        title=format_title(recording),
        simulated=recording.configuration.simulated,
        complete=recording.is_complete,
        result=recording.result,
        seconds=recording.duration_s,
        facts=_facts(recording),
        scene=make_scene_message(0, playback.episodes, Registration(np.zeros(3), 0.0)),
        frames_s=frames_s,
        steps=_steps(recording),
        events=sorted(_timeline_events(recording), key=lambda event: event.time_s),
    )
    return timeline, b"".join(frames)


def align_robot_starts(timelines: Sequence[Timeline]) -> list[Timeline]:
    """Returns the timelines with delays that make all robots start at the same time."""
    begin_s = [
        next((event.time_s for event in timeline.events if event.kind == "trial"), 0.0)
        for timeline in timelines
    ]
    return [
        _later(timeline, max(begin_s) - own_s) for timeline, own_s in zip(timelines, begin_s, strict=True)
    ]


def _later(timeline: Timeline, by_s: float) -> Timeline:
    replace = msgspec.structs.replace
    return replace(
        timeline,
        seconds=timeline.seconds + by_s,
        frames_s=[time_s + by_s for time_s in timeline.frames_s],
        steps=replace(timeline.steps, time_s=[time_s + by_s for time_s in timeline.steps.time_s]),
        events=[replace(each, time_s=each.time_s + by_s) for each in timeline.events],
    )


def export_recorded_scene(recording: Recording) -> bytes:
    """Returns the scene of a recording as a GLB file."""
    return export_scene(*get_scene_parameters(recording))


def get_scene_parameters(recording: Recording) -> tuple[str, Person, Settings]:
    """Returns the environment id of a recording, its person in the rest pose, and its settings."""
    trial = recording.configuration
    return (
        trial.environment,
        make_resting_person(trial.environment, trial.start_person, trial.settings),
        trial.settings,
    )


def _facts(recording: Recording) -> dict[str, str]:
    """Returns information about the trial, such as environment and policy, by heading. The information does not contain
    the participant's name.
    """
    trial = recording.configuration
    facts = {
        "Session": trial.session,
        "Participant": "simulated by a program" if trial.simulated else "a person",
        "Environment": trial.environment,
        "Policy": trial.policy,
        "Goal": trial.goal,
        "Body": f"{trial.person.sex}, torso {trial.person.torso_height_m:.3f} m",
        "Recorded with": str(trial.versions),
    }
    return {heading: text for heading, text in facts.items() if text}


def _frames(playback: Playback, progress: Callable[[], None]) -> tuple[list[float], list[bytes]]:
    """Returns the times (seconds) and the encoded poses of every second recorded state."""
    times_s: list[float] = []
    frames: list[bytes] = []
    states = (each for each in playback.recompute(follow=True) if isinstance(each, ComparedState))
    for number, state in enumerate(states):
        if number % STATES_PER_FRAME == 0:
            times_s.append(state.time_s)
            frames.append(encode_world_poses(playback.episodes))
        progress()
    return times_s, frames


def _steps(recording: Recording) -> StepSeries:
    control = recording.messages_by_topic["/control"]
    return StepSeries(
        time_s=[time_ns / 1e9 for time_ns, _ in control],
        reward=np.cumsum([step.reward for _, step in control]).tolist(),
        force_n=[step.force_on_person_n for _, step in control],
        distance_m=[step.distance_m for _, step in control],
        success=[step.success for _, step in control],
    )


def _timeline_events(recording: Recording) -> list[TimelineEvent]:
    entered = [
        TimelineEvent(time_s, name, name.replace("_", " "))
        for time_s, name in find_phase_start_times(recording)
    ]
    events = [
        TimelineEvent(time_ns / 1e9, "event", f"{event.name.replace('_', ' ')} {event.detail}".strip())
        for time_ns, event in recording.messages_by_topic["/events"]
        if event.name != "phase"
    ]
    items = {item.id: item for item in recording.configuration.items}
    answers = [
        TimelineEvent(time_ns / 1e9, "answer", _answer_text(answer, items.get(answer.item)))
        for time_ns, answer in recording.messages_by_topic["/answers"]
    ]
    return [*entered, *events, *answers]


def _answer_text(answer: Answer, item: Item | None) -> str:
    if item is None:
        return f"{answer.item}: {answer.value}"
    given = item.labels[answer.value - 1] if item.labels else f"{answer.value} of {item.points}"
    return f"{answer.item}: {given}: {item.text}"
