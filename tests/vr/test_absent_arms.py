"""Laws of absent arms: no robot touches, avoids or measures an amputated arm, and no image shows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from avrgym.models import human
from avrgym.models.body_names import PERSON_ARM_SIDES, Side
from avrgym.models.human import ARM_BODIES, BODIES, GEOMS, Person, compute_bind_frames
from avrgym.models.human_shape import make_skin_meshes
from avrgym.policies import registry
from avrgym.recording.input_profile import InputProfile
from avrgym.replay.timeline import get_scene_parameters
from avrgym.replay.verification import verify_recording
from avrgym.safety.limits import REGION_INDEX_OF_GEOM
from avrgym.safety.retreat import Retreat
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from avrgym.vr.protocol.messages import HapticAndAudioFeedback, Problem, Scene
from helpers.vr.visit import ENVIRONMENT, Visit, plan

SCRATCHING = "avrgym/ScratchItchJaco-v1"
OF_ARM = [REGION_INDEX_OF_GEOM[name] for name in ARM_BODIES["right"]]


def world_of(environment: str, absent: tuple[Side, ...]) -> Episodes:
    task = TASKS[ENVIRONMENTS[environment][0]]
    person = Person("woman", 0.56, task.pose_distribution.rest_angles_rad, absent_arms=absent)
    episodes = Episodes(environment, 1, person=person, moving=True, num_threads=1, by_region=True)
    episodes.reset(np.array([0]), [np.random.default_rng(0)])
    return episodes


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_an_absent_arm_makes_no_contact_and_is_near_nothing(environment: str) -> None:
    for arm in PERSON_ARM_SIDES:
        episodes = world_of(environment, (arm,))
        absent = np.array([name in ARM_BODIES[arm] for name in GEOMS])
        model = episodes.simulation.batch.get_model(0)
        touches = [bool(model.geom_contype[model.geom(human.PERSON_NAME_PREFIX + name).id]) for name in GEOMS]
        np.testing.assert_array_equal(touches, ~absent)
        state = episodes.get_state()
        apart_m = np.linalg.norm(state.person_capsule_ends_w[0] - state.head_pos_w[0], axis=-1).min(axis=-1)
        assert (apart_m[absent] > 3.0).all()
        assert (apart_m[~absent] < 1.5).all()
        episodes.set_person(Person())
        assert (episodes.simulation.batch.get_model(0).geom_contype == model.geom_contype).sum() == (
            model.ngeom - absent.sum()
        )


def test_the_robot_passes_through_an_absent_arm_and_does_not_avoid_it() -> None:
    peak_n, gaps = dict[tuple[Side, ...], float](), dict[tuple[Side, ...], int]()
    choices: tuple[tuple[Side, ...], ...] = ((), ("right",))
    for absent in choices:
        episodes = world_of(SCRATCHING, absent)
        generators = [np.random.default_rng(0)]
        policy = registry.resolve_policy("revised", SCRATCHING)
        forces = list[float]()
        with registry.open_policy(policy, episodes, generators) as act:
            for _ in range(40):
                episodes.step(act(episodes.observe()).astype(float))
                forces.append(float(episodes.simulation.compute_region_force_n()[0, OF_ARM].sum()))
        peak_n[absent] = max(forces)
        gaps[absent] = int(Retreat(episodes.simulation)._measure().is_hand.sum())
    assert peak_n[()] > 1.0
    assert peak_n["right",] == 0.0
    assert gaps[()] > gaps["right",]


@pytest.mark.parametrize("sex", human.SEXES)
def test_no_mesh_shows_an_absent_arm(sex: human.Sex) -> None:
    hand_w = compute_bind_frames(sex, Person(sex).torso_height_m)[0]["left_hand"]
    for (name, whole), (_, shape) in zip(
        make_skin_meshes(Person(sex), open_mouth=False),
        make_skin_meshes(Person(sex, absent_arms=("left",)), open_mouth=False),
        strict=True,
    ):
        bound = np.isin(shape.body_indices, [BODIES.index(body) for body in ARM_BODIES["left"]])
        assert shape.body_weights[bound].sum() == 0.0, name
        assert np.linalg.norm(shape.vertices - hand_w, axis=-1).min() > 0.2, name
        other = (np.isin(whole.body_indices, BODIES.index("head")) & (whole.body_weights == 1.0)).any(axis=1)
        np.testing.assert_array_equal(shape.vertices[other], whole.vertices[other])


def test_a_session_records_the_absent_arm_and_replays(tmp_path: Path) -> None:
    profile = InputProfile("head", absent_arms=("left",))
    visit = Visit(tmp_path, replace(plan(), input_profile=profile))
    visit.go_to("questionnaire")
    assert visit.session.world.person.absent_arms == ("left",)
    assert not any(each.left_touched for each in visit.received(HapticAndAudioFeedback))
    (recording,) = visit.recordings()
    assert recording.configuration.start_person.absent_arms == ("left",)
    assert get_scene_parameters(recording)[1].absent_arms == ("left",)
    assert verify_recording(recording).is_identical


def test_a_change_of_absent_arms_changes_the_next_world(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(seeds=(1, 2)))
    visit.go_to("trial")
    first = visit.received(Scene)[-1].url
    visit.session.change_input_profile(InputProfile("head", absent_arms=("right",)), visit.now_s)
    visit.run_until("questionnaire")
    assert visit.session.world.person.absent_arms == ()
    visit.answer(4, 4, 4, 4)
    visit.run_until("trial")
    assert visit.session.world.person.absent_arms == ("right",)
    assert visit.received(Scene)[-1].url != first
    before, after = (each.configuration.input_profile.absent_arms for each in visit.recordings())
    assert (before, after) == ((), ("right",))


def test_a_change_that_takes_the_served_arm_is_refused(tmp_path: Path) -> None:
    visit = Visit(tmp_path, plan(environments=[ENVIRONMENT, SCRATCHING], seeds=(1, 2)))
    visit.go_to("check")
    visit.session.change_input_profile(InputProfile("head", absent_arms=("right",)), visit.now_s)
    assert visit.received(Problem)[-1].message.startswith(
        "ScratchItch works on the right arm, which is absent"
    )
    assert visit.session.person.absent_arms == ()
