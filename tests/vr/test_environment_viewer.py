"""The environment viewer: scenes, states and status of episodes for watchers."""

import numpy as np
import pytest

from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import (
    ExperimenterCommand,
    ExperimenterCommandName,
    Message,
    PhaseDescription,
    Scene,
    SessionStatus,
    Stop,
    VelocityCommand,
    WatcherSceneLoaded,
    Welcome,
    WorldState,
)
from avrgym.vr.server.environment_viewer import (
    EPISODE_END_PAUSE_S,
    SCENE_LOADING_TIMEOUT_S,
    EnvironmentViewer,
)

BATHING = "avrgym/BedBathingJaco-v1"
TICK_S = 0.01


class Watcher:
    """Shows an environment on a clock of its own and keeps what it says."""

    def __init__(self, environment: str, policy: str = "zero", *, force_guard: bool = False) -> None:
        self.received: list[Message] = []
        self.viewing = EnvironmentViewer(
            environment, policy, "original", 0, self.received.append, force_guard=force_guard
        )
        self._now_s = 0.0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self._now_s += TICK_S
            self.viewing.tick(self._now_s)

    def load(self) -> None:
        """Answer that the newest scene is drawn."""
        self.viewing.receive(WatcherSceneLoaded(url=self.inbox(Scene)[-1].url), self._now_s)

    def command(self, name: ExperimenterCommandName) -> None:
        self.viewing.receive(ExperimenterCommand(name=name), self._now_s)

    def inbox(self, kind: type) -> list:
        return [message for message in self.received if isinstance(message, kind)]

    @property
    def words(self) -> str:
        return self.inbox(PhaseDescription)[-1].text


def place(state: WorldState) -> np.ndarray:
    return np.frombuffer(state.poses, "<f4").reshape(-1, 7)


def test_a_new_connection_receives_scene_and_status():
    watcher = Watcher(BATHING)
    watcher.received.clear()
    watcher.viewing.send_initial_state(watcher.received.append, "experimenter", 0.0)
    assert [type(message) for message in watcher.received] == [
        Welcome,
        Scene,
        PhaseDescription,
        SessionStatus,
    ]
    assert watcher.received[0].protocol == messages.PROTOCOL_VERSION  # type: ignore[attr-defined]
    assert watcher.words == f"{BATHING}, zero, episode 1: preparing"


def test_states_hold_the_bodies_then_the_marks_on_the_person():
    watcher = Watcher(BATHING)
    watcher.load()
    watcher.run(0.1)
    scene, state = watcher.inbox(Scene)[-1], watcher.inbox(WorldState)[-1]
    poses = place(state)
    assert len(poses) == len(scene.bodies) + scene.marks
    assert scene.marks > 50
    elbow = poses[scene.bodies.index("person/right_forearm"), :3]
    marks = poses[len(scene.bodies) :, :3]
    near = np.linalg.norm(marks - elbow, axis=1) < 0.4
    below_the_floor = marks[:, 2] < 0.0
    assert near.sum() > 30
    assert (near | below_the_floor).all()


def test_an_episode_waits_for_its_scene_but_not_for_ever():
    watcher = Watcher("avrgym/FeedingJaco-v1", "random")
    watcher.run(1.0)
    waiting = [place(state) for state in watcher.inbox(WorldState)]
    assert all((poses == waiting[0]).all() for poses in waiting)
    watcher.run(SCENE_LOADING_TIMEOUT_S)
    assert watcher.words.endswith("running")
    assert (place(watcher.inbox(WorldState)[-1]) != waiting[0]).any()


def test_episode_follows_episode_with_other_people():
    watcher = Watcher("avrgym/FeedingJaco-v1")
    watcher.load()
    watcher.run(EPISODE_STEPS * DEFAULT_SUBSTEPS * TICK_S)
    assert watcher.words.endswith("no success")
    watcher.run(EPISODE_END_PAUSE_S + TICK_S)
    assert watcher.words == "avrgym/FeedingJaco-v1, zero, episode 2: preparing"
    first, second = watcher.inbox(Scene)
    assert (first.url, second.url) == ("/scenes/0.glb", "/scenes/1.glb")
    (_, one, _), (_, other, _) = watcher.viewing.scenes
    assert not np.array_equal(one.joint_angles_rad, other.joint_angles_rad)


@pytest.mark.slow
def test_the_status_contains_reward_success_and_force():
    watcher = Watcher("avrgym/ScratchItchJaco-v1", "oracle")
    watcher.load()
    watcher.run(EPISODE_STEPS * DEFAULT_SUBSTEPS * TICK_S)
    told = watcher.inbox(SessionStatus)
    assert [status.step for status in told] == sorted(status.step for status in told)
    assert told[0].reward == 0.0
    assert (told[-1].step, told[-1].success, told[-1].phase) == (EPISODE_STEPS, True, "viewing")
    assert told[-1].reward > 0.0
    assert max(status.force_on_person_n for status in told) > 0.0
    touched = [status for status in told if status.force_share]
    assert touched
    assert all(status.force_region for status in touched)


def test_a_pause_holds_the_world_until_it_is_continued():
    watcher = Watcher("avrgym/FeedingJaco-v1", "random")
    watcher.load()
    watcher.run(0.5)
    watcher.command("pause")
    before, states = watcher.inbox(SessionStatus)[-1], len(watcher.inbox(WorldState))
    assert (before.paused, watcher.viewing.is_at_rest) == (True, True)
    watcher.run(SCENE_LOADING_TIMEOUT_S + EPISODE_END_PAUSE_S)
    assert watcher.words.endswith("paused")
    assert watcher.inbox(SessionStatus)[-1].step == before.step
    held = [place(state) for state in watcher.inbox(WorldState)[states:]]
    assert all((poses == held[0]).all() for poses in held)
    watcher.command("continue")
    watcher.run(0.5)
    assert watcher.words.endswith("running")
    assert watcher.inbox(SessionStatus)[-1].step > before.step


@pytest.mark.parametrize("paused", [False, True])
def test_skip_starts_the_next_episode(paused: bool):
    watcher = Watcher("avrgym/FeedingJaco-v1")
    watcher.load()
    watcher.run(0.3)
    if paused:
        watcher.command("pause")
    watcher.command("skip")
    status = watcher.inbox(SessionStatus)[-1]
    assert (status.trial, status.step, status.reward, status.paused) == (2, 0, 0.0, paused)
    assert len(watcher.inbox(Scene)) == 2
    watcher.load()
    watcher.run(0.3)
    assert (watcher.inbox(SessionStatus)[-1].step > 0) is not paused


def test_the_operator_drives_from_the_page_and_lets_go():
    watcher = Watcher("avrgym/FeedingJaco-v1", "operator")
    watcher.load()
    watcher.run(0.2)
    assert watcher.inbox(SessionStatus)[-1].operated
    rest = place(watcher.inbox(WorldState)[-1])
    watcher.viewing.receive(VelocityCommand(engaged=True, linear=(0, 0, 1), angular=(0, 0, 0)), 0.2)
    watcher.run(0.3)
    moved = place(watcher.inbox(WorldState)[-1])
    assert np.abs(moved - rest).max() > 0.005
    watcher.viewing.receive(VelocityCommand(engaged=True, linear=(0, 0, 1), angular=(0, 0, 0)), 0.5)
    watcher.command("pause")
    assert watcher.inbox(SessionStatus)[-1].idle
    watcher.command("continue")
    assert not watcher.inbox(SessionStatus)[-1].idle
    watcher.run(1.0)
    assert watcher.inbox(SessionStatus)[-1].idle


def test_messages_for_sessions_are_ignored():
    watcher = Watcher("avrgym/FeedingJaco-v1")
    watcher.load()
    watcher.viewing.receive(Stop(), 0.0)
    watcher.run(0.1)
    assert watcher.words.endswith("running")


def test_an_unknown_name_is_rejected_at_the_start():
    with pytest.raises(ValueError, match="unknown environment 'avrgym/Flying-v1'"):
        Watcher("avrgym/Flying-v1")


@pytest.mark.slow
def test_the_force_guard_overrides_a_policy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Limits far below contact make the guard hold every arm that approaches the person."""
    monkeypatch.setattr("avrgym.safety.force_guard.INTERVENTION_FORCE_LIMIT_FRACTION", 1e-6)
    ends: list[np.ndarray] = []
    for force_guard in (False, True):
        watcher = Watcher("avrgym/FeedingJaco-v1", "oracle", force_guard=force_guard)
        watcher.load()
        watcher.run(10.0)
        ends.append(place(watcher.inbox(WorldState)[-1]))
    assert not np.array_equal(ends[0], ends[1])
