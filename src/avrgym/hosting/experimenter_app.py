"""Web application of the experimenter's server: state of all sessions, commands to sessions, and participants.

This server has a separate port, and listens only on a loopback address. Each request needs an experimenter's token.
"""

from collections.abc import Awaitable, Callable
from typing import Annotated, Any

import msgspec
import sqlalchemy as sa
from fastapi import Depends, FastAPI, HTTPException, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.staticfiles import StaticFiles
from starlette.middleware.trustedhost import TrustedHostMiddleware

from avrgym.hosting.data_requests import DATA_COPY_REQUESTED_EVENT, find_requesting_participants
from avrgym.hosting.host_state import HostState
from avrgym.hosting.session_pages import add_session_pages
from avrgym.hosting.session_pool import HostedSession, SessionPool
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.dashboard.request_log import DashboardLog
from avrgym.study.dashboard.study_tokens import StudyTokens
from avrgym.study.storage.free_text import MAX_LINE_LENGTH
from avrgym.study.storage.remote_recordings import read_object_store_error
from avrgym.study.storage.schema import PARTICIPANT_TABLE
from avrgym.study.storage.state_transitions import PARTICIPANT_TRANSITIONS, StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.headset_check import MAX_LATENCY_MS
from avrgym.vr.protocol.messages import ExperimenterCommandName
from avrgym.vr.server.authentication import AuthenticatedClient, SameOriginMiddleware
from avrgym.vr.server.request_body import (
    EmptyRequest,
    decode_json_body,
    make_error_handler,
    make_json_response,
)
from avrgym.vr.server.web_server import STATIC_FOLDER, make_page_endpoint

MAX_REQUEST_BODY_BYTES = 1 << 13
SESSION_COMMANDS: tuple[ExperimenterCommandName, ...] = ("stop", "pause", "continue", "end")


class StudyOpeningRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to open or close the study for new participants and sessions."""

    is_open: bool


class MessageRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to show a message on the page of a session's participant."""

    text: Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_LINE_LENGTH)]


def make_experimenter_app(
    store: StudyStore, pool: SessionPool, state: HostState, tokens: StudyTokens, hosts: list[str]
) -> FastAPI:
    """Returns the web application. ``hosts``: allowed host names of requests."""

    def experimenter(request: Request) -> AuthenticatedClient:
        caller = tokens.authenticate_request(request.headers)
        if caller is None or caller.role != "experimenter":
            raise HTTPException(401, "invalid token; open the experimenter's address, which the host printed")
        return caller

    log = DashboardLog(store)
    app = FastAPI(openapi_url=None)
    app.add_middleware(SameOriginMiddleware)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts)
    app.add_exception_handler(StudyError, make_error_handler(409))
    app.add_exception_handler(OSError, make_error_handler(507))

    @app.get("/api/sessions")
    def read_sessions(caller: Annotated[AuthenticatedClient, Depends(experimenter)]) -> Response:
        log.log_page_view(caller, "view sessions")
        return make_json_response(describe_sessions(store, pool, state))

    def logged(caller: AuthenticatedClient, session_id: str, name: str, act: Callable[[], None]) -> None:
        session = pool.find_session(session_id)
        with log.log_command(caller, name, session.pseudonym if session else None):
            act()

    @app.post("/api/door")
    async def change_door(
        request: Request, caller: Annotated[AuthenticatedClient, Depends(experimenter)]
    ) -> Response:
        change = await decode_json_body(request, StudyOpeningRequest, MAX_REQUEST_BODY_BYTES)
        name = "open door" if change.is_open else "close door"
        await run_in_threadpool(logged, caller, "", name, lambda: state.set_study_open(change.is_open))
        return Response(status_code=204)

    @app.post("/api/sessions/{session_id}/message")
    async def send_message(
        session_id: str, request: Request, caller: Annotated[AuthenticatedClient, Depends(experimenter)]
    ) -> Response:
        message = await decode_json_body(request, MessageRequest, MAX_REQUEST_BODY_BYTES)
        await run_in_threadpool(
            logged, caller, session_id, "send message", lambda: pool.send_message(session_id, message.text)
        )
        return Response(status_code=204)

    def endpoint(name: ExperimenterCommandName) -> Callable[..., Awaitable[Response]]:
        async def command(
            session_id: str, request: Request, caller: Annotated[AuthenticatedClient, Depends(experimenter)]
        ) -> Response:
            await decode_json_body(request, EmptyRequest, MAX_REQUEST_BODY_BYTES)
            await run_in_threadpool(
                logged, caller, session_id, f"{name} session", lambda: pool.send_command(session_id, name)
            )
            return Response(status_code=204)

        return command

    for name in SESSION_COMMANDS:
        app.post(f"/api/sessions/{{session_id}}/{name}")(endpoint(name))
    app.mount("/study", make_dashboard_app(store, tokens))
    for path, file in (("/", "host.html"), ("/participants", "dashboard.html")):
        app.get(path)(make_page_endpoint(file))
    add_session_pages(app, pool, "spectator")
    app.mount("/", StaticFiles(directory=STATIC_FOLDER))
    return app


def describe_sessions(store: StudyStore, pool: SessionPool, state: HostState) -> dict[str, Any]:
    """Returns the state of the host and of all sessions, as JSON values for the experimenter's page."""
    numbers = _participants_by_state(store)
    return {
        "title": store.design.title,
        "is_open": state.is_study_open,
        "capacity": pool.max_concurrent_sessions,
        "session_cpu_share": pool.session_cpu_load,
        "missed_share": pool.missed_tick_fraction,
        "waiting": pool.num_waiting_participants,
        "participants": {state: numbers[state] for state in PARTICIPANT_TRANSITIONS if state in numbers},
        "problems": [problem] if (problem := read_object_store_error(store)) else [],
        "copies_requested": find_requesting_participants(store, DATA_COPY_REQUESTED_EVENT),
        "sessions": [describe_session(store, each) for each in pool.sessions],
    }


def _participants_by_state(store: StudyStore) -> dict[str, int]:
    state = PARTICIPANT_TABLE.c.state
    with store.database.read_transaction() as connection:
        found = connection.execute(sa.select(state, sa.func.count()).group_by(state))
        return {name: number for name, number in found}


def describe_session(store: StudyStore, session: HostedSession) -> dict[str, Any]:
    """Returns the state of one session with warnings, as JSON values."""
    report = session.report
    return {
        "id": session.id,
        "participant": session.pseudonym,
        "state": session.state,
        "phase": report.phase,
        "trial": report.trial,
        "trials": report.trials,
        "connected": report.is_connected,
        "paused": report.is_paused,
        "minutes": report.elapsed_s / 60.0,
        "latency_ms": report.latency_ms,
        "untracked_share": report.untracked_fraction,
        "missed_ticks": report.missed_ticks,
        "cpu_share": report.cpu_load,
        "crashes": session.crashes,
        "warnings": find_session_warnings(session, store.design.max_held_share),
    }


def find_session_warnings(session: HostedSession, max_held_share: float) -> list[str]:
    """Returns the warnings about a session: errors, crashes, lost connection, high latency and tracking loss."""
    report = session.report
    found = [report.latest_error] if report.latest_error else []
    if session.crashes:
        found.append(f"the process was replaced {session.crashes} times")
    if session.state == "running" and not report.is_connected:
        found.append("the participant is not connected")
    if report.latency_ms is not None and report.latency_ms > MAX_LATENCY_MS:
        found.append(
            f"the latency is {report.latency_ms:.0f} ms; at most {MAX_LATENCY_MS:.0f} ms are allowed"
        )
    if report.untracked_fraction > max_held_share:
        found.append(f"tracking was lost for {100.0 * report.untracked_fraction:.0f} % of the trials")
    return found
