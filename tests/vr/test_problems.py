"""Problems are sent only to the roles that they concern."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import get_args

import pytest
from test_authentication import hear, opened, participant, tell
from websockets.sync.client import ClientConnection

from avrgym.vr.protocol.messages import (
    PROTOCOL_VERSION,
    Answer,
    BodyChoice,
    ExperimenterCommand,
    ExperimenterCommandName,
    Hello,
    Message,
    PhaseDescription,
    Problem,
    RecalibrationRequest,
    Stop,
    TorsoHeightCorrection,
    VrEntered,
)
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.session import Session
from helpers.vr.visit import Visit, constant_policies, plan

WAITING = "waiting"
BY_EXPERIMENTER = (
    *(ExperimenterCommand(name=name) for name in ("stop", "continue", "repeat", "skip", "recalibrate")),
    TorsoHeightCorrection(torso_height_m=9.0),
    BodyChoice(sex="man", skin_tone="plaid"),
    Hello(PROTOCOL_VERSION, "?", "again", emulated=True),
)
BY_PARTICIPANT = (
    Stop(),
    RecalibrationRequest(),
    Answer(item="L1", value=1, response_time_s=1.0),
    BodyChoice(sex="man", skin_tone="plaid"),
    Hello(PROTOCOL_VERSION, "?", "again", emulated=True),
)


@pytest.fixture
def parties(tmp_path: Path) -> Iterator[dict[str, ClientConnection]]:
    """All three, connected to a session that waits."""
    with ExitStack() as entered:
        server = entered.enter_context(
            LiveServer(
                lambda send: Session(plan(), constant_policies(plan()), tmp_path, send, "test"),
                "127.0.0.1",
                0,
            )
        )
        watching = {
            role: entered.enter_context(opened(server, "/watch", getattr(server.tokens, role)))
            for role in ("experimenter", "spectator")
        }
        for socket in watching.values():
            hear(socket, PhaseDescription)
        yield {"participant": entered.enter_context(participant(server)), **watching}


def problems(parties: dict[str, ClientConnection]) -> dict[str, int]:
    """The number of problems that each role received until the participant entered VR."""
    tell(parties["participant"], VrEntered())
    counts = {}
    for role, socket in parties.items():
        counts[role] = 0
        while not (isinstance(heard := hear(socket, Message), PhaseDescription) and heard.name != WAITING):
            counts[role] += isinstance(heard, Problem)
    return counts


def test_participants_do_not_receive_problems_of_the_experimenter(
    parties: dict[str, ClientConnection],
) -> None:
    experimenter = parties["experimenter"]
    for wrong in BY_EXPERIMENTER:
        tell(experimenter, wrong)
        assert isinstance(hear(experimenter, Problem), Problem)
    experimenter.send("nonsense")
    assert isinstance(hear(experimenter, Problem), Problem)
    assert problems(parties) == {"participant": 0, "experimenter": 0, "spectator": 0}


def test_the_experimenter_receives_problems_of_the_participant(
    parties: dict[str, ClientConnection],
) -> None:
    for wrong in BY_PARTICIPANT:
        tell(parties["participant"], wrong)
        assert isinstance(hear(parties["participant"], Problem), Problem)
    told = problems(parties)
    own = sum(isinstance(wrong, Hello) for wrong in BY_PARTICIPANT)
    in_detail = sum(isinstance(wrong, BodyChoice) for wrong in BY_PARTICIPANT)
    expected = len(BY_PARTICIPANT) - own + in_detail
    assert told == {"participant": 0, "experimenter": expected, "spectator": 0}


@pytest.mark.parametrize("phase", ["waiting", "calibration", "check", "trial", "questionnaire", "finished"])
def test_every_problem_has_a_role(tmp_path: Path, phase: str) -> None:
    visit = Visit(tmp_path, plan())
    visit.go_to(phase)
    before = len(visit.received(Problem))
    for name in get_args(ExperimenterCommandName):
        visit.send(ExperimenterCommand(name=name))
    assert {problem.role for problem in visit.received(Problem)[before:]} <= {"experimenter"}
