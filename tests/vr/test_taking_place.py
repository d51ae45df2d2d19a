"""The start of a session: the participant's body, from its choice to the recording."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.models.human import BODY_DIMENSIONS, SKIN_TONES
from avrgym.recording.configuration import BodyModel
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant
from avrgym.vr.protocol.messages import BodyChoice, ParticipantBody, ParticipantReady, Scene
from avrgym.vr.session import events as read_session_events
from helpers.vr.visit import Visit, plan


@pytest.fixture
def visit(tmp_path: Path) -> Iterator[Visit]:
    """A woman's visit, of one short trial."""
    made = Visit(tmp_path, plan())
    yield made
    made.leave()


def chosen(visit: Visit) -> list[tuple[str, str]]:
    return [
        (each.sex, each.skin_tone)
        for each in visit.observed
        if isinstance(each, read_session_events.BodyChosen)
    ]


def test_who_connects_is_told_which_bodies_there_are(visit: Visit) -> None:
    visit.session.send_initial_state(visit.inbox.append, "participant", 0.0)
    (body,) = visit.received(ParticipantBody)
    assert (body.sex, body.skin_tone) == ("woman", visit.session.person.skin_tone)
    assert dict(zip(body.skin_tones, body.skin_tones_rgb, strict=True)) == SKIN_TONES


@pytest.mark.parametrize("phase", ["waiting", "calibration"])
def test_a_body_that_is_chosen_first_is_measured_seen_and_recorded(visit: Visit, phase: str) -> None:
    man = replace(visit.participant.traits, sex="man", torso_height_m=0.58)
    visit.participant = SimulatedParticipant(man, 4)
    visit.go_to(phase)
    visit.send(BodyChoice("man", "brown"))
    assert visit.phase == phase
    assert (visit.received(ParticipantBody)[-1].sex, visit.received(ParticipantBody)[-1].skin_tone) == (
        "man",
        "brown",
    )
    visit.tick(20)
    visit.go_to("trial") if phase == "waiting" else visit.send(ParticipantReady())
    visit.run_until("trial")
    person = visit.session.person
    assert (person.sex, person.skin_tone) == ("man", "brown")
    assert person.torso_height_m == pytest.approx(0.58, abs=0.005)
    assert chosen(visit) == [("man", "brown")]
    seen = visit.session.scenes[
        int(visit.received(Scene)[-1].url.removeprefix("/scenes/").removesuffix(".glb"))
    ][1]
    assert (seen.sex, seen.skin_tone, seen.torso_height_m) == ("man", "brown", person.torso_height_m)
    visit.leave()
    recorded = visit.recordings()[0].configuration.person
    assert recorded == BodyModel("man", person.torso_height_m, "brown")


def test_another_tone_of_skin_keeps_the_measure_and_is_looked_at_again(visit: Visit) -> None:
    visit.go_to("check")
    before, url = visit.session.person, visit.received(Scene)[-1].url
    visit.send(BodyChoice(before.sex, "dark"))
    visit.run_until("check")
    assert visit.session.person.torso_height_m == before.torso_height_m
    assert visit.received(Scene)[-1].url != url
    assert visit.phases.count("calibration") == 1


def test_a_body_of_the_other_sex_is_measured_anew(visit: Visit) -> None:
    """The same headset stands higher above a woman's hips."""
    visit.go_to("check")
    woman_m = visit.session.person.torso_height_m
    visit.send(BodyChoice("man", "fair"))
    assert visit.phase == "calibration"
    visit.confirms = False
    visit.tick(60)
    visit.send(ParticipantReady())
    visit.run_until("check")
    height_offset_m = (
        BODY_DIMENSIONS["man"].seated_hips_height_m - BODY_DIMENSIONS["woman"].seated_hips_height_m
    )
    assert visit.session.person.torso_height_m == pytest.approx(woman_m - height_offset_m, abs=0.002)


@pytest.mark.parametrize("phase", ["loading", "free_before", "trial", "questionnaire", "finished"])
@pytest.mark.fast_cases(2)
def test_a_trial_keeps_its_body(visit: Visit, phase: str) -> None:
    visit.go_to(phase)
    before = visit.session.person
    visit.send(BodyChoice("man", "dark"))
    assert visit.phase == phase
    assert visit.session.person is before
    assert "only before or between trials" in visit.problems[-1]


def test_a_tone_that_there_is_not_is_refused(visit: Visit) -> None:
    visit.go_to("calibration")
    before = visit.session.person
    visit.send(BodyChoice("woman", "green"))
    assert visit.session.person is before
    assert all(tone in visit.problems[-1] for tone in SKIN_TONES)
    assert chosen(visit) == []


AT_REST: dict[str, bool] = {
    "waiting": True, "calibration": True, "loading": True, "check": True, "free_before": False, "trial": False,
    "questionnaire": True, "paused": True, "finished": True,
}  # fmt: skip


@pytest.mark.parametrize("phase", AT_REST)
@pytest.mark.fast_cases(4)
def test_a_session_is_at_rest_where_no_trial_runs(visit: Visit, phase: str) -> None:
    visit.go_to(phase)
    assert visit.session.is_at_rest == AT_REST[phase]
