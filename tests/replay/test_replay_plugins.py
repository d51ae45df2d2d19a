"""A recording stores its plug-ins, and a verification that finds differences names the plug-in that changed."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from avrgym.cli import replay as command
from avrgym.recording.reader import Recording, read_recording
from avrgym.replay.playback import Playback, ReplayError
from avrgym.replay.verification import verify_recording
from avrgym.system import plugins
from avrgym.tasks.registry import find_plugins
from helpers.studies.configurations import with_configuration
from helpers.system.fake_plugins import change, register
from helpers.vr.visit import ENVIRONMENT, Visit, plan


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A recording with a robot of a package, whose module is there to be changed."""
    folder = tmp_path_factory.mktemp("plugins")
    with pytest.MonkeyPatch.context() as patch:
        module = register(patch, folder / "lab", plugins.ROBOT_ENTRY_POINT_GROUP, "Jaco")
        visit = Visit(folder / "visit", plan(environments=[ENVIRONMENT], trial_steps=2))
        visit.calibrate()
        visit.run_until("trial")
        visit.tick(15)
        visit.leave()
        yield read_recording(visit.session.recordings[-1]), module


@pytest.fixture
def recording(made: tuple[Recording, Path]) -> Recording:
    return made[0]


def with_other_states(recording: Recording) -> Recording:
    """As if the robot had been quicker then."""
    messages = list(recording.messages)
    place = max(number for number, (topic, _, _) in enumerate(messages) if topic == "/physics")
    topic, time_ns, physics = messages[place]
    state = (np.array(physics.state) + 1e-3).tolist()
    messages[place] = (topic, time_ns, type(physics)(physics.step, physics.simulation_time_s, state))
    return replace(recording, messages=messages)


def test_a_recording_stores_its_plug_ins_and_verifies(recording: Recording) -> None:
    assert recording.configuration.plugins == find_plugins(ENVIRONMENT)
    found = verify_recording(recording)
    assert (found.is_identical, found.plugin_differences) == (True, [])


def test_a_difference_without_a_reason_stays_an_error(recording: Recording) -> None:
    found = verify_recording(with_other_states(recording))
    with pytest.raises(ReplayError, match="although both have the same versions"):
        command._print_differences(found)


def test_the_changed_plug_in_is_the_reason(
    made: tuple[Recording, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    recording, module = made
    before = find_plugins(ENVIRONMENT)[0]
    change(module)
    found = verify_recording(with_other_states(recording))
    assert found.plugin_differences == [f"robot Jaco was {before}, is {find_plugins(ENVIRONMENT)[0]}"]
    command._print_differences(found)
    assert f"A plug-in has changed: {found.plugin_differences[0]}." in capsys.readouterr().out
    other_scene = with_configuration(recording, body_names=("world",))
    with pytest.raises(ReplayError, match=r"have changed: .*; robot Jaco was lab-robots 1\.0"):
        Playback(other_scene)
