"""Web application (JSON) of the caregiver's page: questions to the caregiver about the session."""

from typing import Any, Protocol

import msgspec
from fastapi import Depends, FastAPI, HTTPException, Request, Response
from fastapi.concurrency import run_in_threadpool

from avrgym.commands.respondents import CAREGIVER_RESPONDENT
from avrgym.questionnaires.questionnaire import translate_items
from avrgym.recording.schema import Answer
from avrgym.study.people.participants import read_participant_texts
from avrgym.study.storage.answers import read_caregiver_answers, record_caregiver_answer
from avrgym.study.storage.database_rows import format_pseudonym
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_session
from avrgym.vr.server.authentication import Tokens
from avrgym.vr.server.request_body import decode_json_body, make_error_handler, make_json_response

MAX_REQUEST_BODY_BYTES = 1 << 10


class CaregiverSession(Protocol):
    """The session that the caregiver's link opens."""

    @property
    def caregiver_session_id(self) -> int | None:
        """The session's id; ``None`` before the first session of the server."""
        ...


class CaregiverAnswer(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The caregiver's answer to an item: an option number from 1. ``response_time_s``: time since the display."""

    item: str
    value: int
    response_time_s: float


def make_caregiver_app(store: StudyStore, tokens: Tokens, sessions: CaregiverSession) -> FastAPI:
    """Returns the web application for the caregiver of the running or latest session.

    It accepts only the caregiver's link.
    """

    def caregiver_only(request: Request) -> None:
        caller = tokens.authenticate_request(request.headers)
        if caller is None or caller.role != "caregiver" or sessions.caregiver_session_id is None:
            raise HTTPException(
                401, "invalid link; open the caregiver's address of this session, which the dashboard shows"
            )
        request.state.session = sessions.caregiver_session_id

    app = FastAPI(openapi_url=None, dependencies=[Depends(caregiver_only)])

    app.add_exception_handler(StudyError, make_error_handler(409))

    @app.get("/items")
    def read_items(request: Request) -> Response:
        return make_json_response(list_caregiver_items(store, request.state.session))

    @app.post("/answers")
    async def answer(request: Request) -> Response:
        given = await decode_json_body(request, CaregiverAnswer, MAX_REQUEST_BODY_BYTES)
        stored = Answer(given.item, given.value, given.response_time_s)
        await run_in_threadpool(record_caregiver_answer, store, request.state.session, stored)
        return Response(status_code=204)

    return app


def list_caregiver_items(store: StudyStore, session_id: int) -> list[dict[str, Any]]:
    """Returns the caregiver's items in the participant's language, with the answers so far."""
    with store.database.read_transaction() as connection:
        session = find_session(connection, session_id)
    texts = read_participant_texts(store, store.read_participant(format_pseudonym(session.participant)))
    items = translate_items(
        store.design.list_items_at_moment(CAREGIVER_RESPONDENT, session.participant), texts
    )
    given = read_caregiver_answers(store, session_id)
    return [
        {name: getattr(item, name) for name in ("id", "text", "points", "low", "high", "labels")}
        | {"answer": given.get(item.id)}
        for item in items
    ]
