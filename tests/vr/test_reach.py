"""Laws of measured arm lengths: two poses determine them, and the body's hands then match the participant's."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from msgspec.structs import replace as replace_frame

from avrgym.models import human
from avrgym.models.human import SEATED_POSTURE, Person
from avrgym.models.human_shape import make_skin_meshes
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.study.design.design import parse_design, read_default_design_text
from avrgym.vr.protocol.messages import ParticipantReady, PhaseDescription
from avrgym.vr.session import events
from avrgym.vr.tracking.arm import ArmLengths
from avrgym.vr.tracking.calibration import measure_arm_scale
from helpers.vr.visit import Visit, plan

STRAIGHT = {"right_elbow_x": 0.0, "left_elbow_x": 0.0}
AHEAD_RAD = human.make_seated_joint_angles(right_shoulder_x=-85.0, left_shoulder_x=-85.0, **STRAIGHT)
ASIDE_RAD = human.make_seated_joint_angles(right_shoulder_y=85.0, left_shoulder_y=-85.0, **STRAIGHT)
REACHING = replace(plan(free_movement_s=6.0), reach_measurement_enabled=True)


class Reacher(Visit):
    """A participant with arms of another length, who stretches them when told to."""

    def __init__(self, folder: Path, arm_scale: float) -> None:
        super().__init__(folder, REACHING)
        traits = self.participant.traits
        person = Person(traits.sex, traits.torso_height_m, arm_scale=arm_scale)
        self.participant._model = human.compile_person_model(person, SEATED_POSTURE, moving=True)
        self.participant._data = mujoco.MjData(self.participant._model)

    def stretch(self) -> None:
        self.calibrate()
        assert self.phase == "reach"
        for pose_rad in (AHEAD_RAD, ASIDE_RAD):
            self.pose_rad, told = pose_rad, self.received(PhaseDescription)[-1].text
            while self.received(PhaseDescription)[-1].text == told:
                self.tick()
        self.pose_rad = self.participant._rest_rad


@pytest.mark.slow
@pytest.mark.parametrize("arm_scale", [0.85, 1.2])
def test_two_poses_tell_how_long_the_arms_are(tmp_path: Path, arm_scale: float) -> None:
    visit = Reacher(tmp_path, arm_scale)
    visit.stretch()
    assert visit.phases.count("reach") == 2
    (measured,) = [each.arm_scale for each in visit.observed if isinstance(each, events.ReachMeasured)]
    assert measured == pytest.approx(arm_scale, abs=0.02)
    visit.run_until("free_before")
    visit.pose_rad = AHEAD_RAD
    visit.tick(500)
    hands = {
        "tracked": visit.participant._data,
        "simulated": visit.session.world.simulation.batch.get_data(0),
    }
    heads = {name: data.site(human.PERSON_NAME_PREFIX + "head_centre").xpos for name, data in hands.items()}
    reaches = {
        name: np.linalg.norm(data.site(human.PERSON_NAME_PREFIX + "right_hand_centre").xpos - heads[name])
        for name, data in hands.items()
    }
    print(f"\narms {arm_scale:g}: measured {measured:.3f}, hand from head {reaches}")
    assert reaches["simulated"] == pytest.approx(reaches["tracked"], abs=0.02)


@pytest.mark.slow
def test_a_trial_with_other_arms_verifies_bit_by_bit(tmp_path: Path) -> None:
    visit = Reacher(tmp_path, 1.15)
    visit.stretch()
    visit.run_until("questionnaire")
    visit.answer(1, 2, 3, 4)
    visit.leave()
    recording = read_recording(visit.session.recordings[0])
    assert recording.configuration.person.arm_scale == pytest.approx(1.15, abs=0.02)
    found = verify_recording(recording)
    assert found.num_identical_states == found.num_states > 0


def test_the_trigger_leaves_it_out(tmp_path: Path) -> None:
    visit = Visit(tmp_path, REACHING)
    visit.calibrate()
    assert visit.phase == "reach"
    visit.send(ParticipantReady())
    visit.run_until("free_before")
    assert visit.session.person.arm_scale == 1.0
    visit.leave()
    assert visit.recordings()[0].configuration.person.arm_scale == 1.0


def test_hands_that_are_not_seen_measure_nothing_and_that_is_said(tmp_path: Path) -> None:
    visit = Visit(tmp_path, REACHING)
    visit.calibrate()
    visit.tracking = False
    visit.tick(600)
    assert "were not tracked" in visit.problems[0]
    assert visit.session.person.arm_scale == 1.0


def test_who_moves_the_hand_with_a_mouse_stretches_no_arms(tmp_path: Path) -> None:
    visit = Visit(tmp_path, REACHING)
    visit.frame = lambda of=visit.frame: replace_frame(of(), left_modality="mouse", right_modality="mouse")
    visit.calibrate()
    assert visit.phases[-2:] == ["calibration", "loading"]


def test_nobody_has_arms_that_no_adult_has() -> None:
    person = Person("man", 0.6)
    most = ArmLengths.from_person(person)
    assert measure_arm_scale(person, [most.upper_arm_m + most.forearm_m]) == pytest.approx(1.0)
    for reach_m in (0.2, 1.2):
        with pytest.raises(ValueError, match=r"allowed: 0\.8 to 1\.25"):
            measure_arm_scale(person, [reach_m])


def test_drawn_arms_are_as_long_as_simulated_ones_and_nothing_else_changes() -> None:
    usual, long = Person("woman", 0.52), Person("woman", 0.52, arm_scale=1.2)
    frames = [human.compute_people_layout(human.People.from_persons([person])) for person in (usual, long)]
    for name in human.BODIES:
        same = np.array_equal(frames[0].body_pos[name], frames[1].body_pos[name])
        assert same == (not name.endswith(("forearm", "hand")))
    drawn = [dict(make_skin_meshes(person, open_mouth=False)) for person in (usual, long)]
    widths_m = [max(np.ptp(part.vertices[:, 0]) for part in parts.values()) for parts in drawn]
    assert widths_m[1] > widths_m[0] + 0.05


def test_studies_measure_no_reach_unless_they_say_so() -> None:
    assert not parse_design(read_default_design_text()).measure_reach
    assert parse_design(
        read_default_design_text().replace("measure_reach = false", "measure_reach = true")
    ).measure_reach
