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

from avrgym.hosting.data_requests import COPY_REQUESTED_EVENT, requested
from avrgym.hosting.host_state import HostState
from avrgym.hosting.session_pages import add_session_pages
from avrgym.hosting.session_pool import HostedSession, SessionPool
from avrgym.study.dashboard.application import dashboard_app
from avrgym.study.dashboard.request_log import DashboardLog
from avrgym.study.dashboard.tokens import StudyTokens
from avrgym.study.storage.free_text import MAX_LINE_LENGTH
from avrgym.study.storage.remote_recordings import object_store_problem
from avrgym.study.storage.schema import PARTICIPANT_TABLE
from avrgym.study.storage.states import PARTICIPANT_TRANSITIONS, StudyError
from avrgym.study.storage.store import Store
from avrgym.vr.headset_check import MAX_LATENCY_MS
from avrgym.vr.protocol.messages import CommandName
from avrgym.vr.server.authentication import AuthenticatedClient, SameOriginMiddleware
from avrgym.vr.server.request_body import EmptyRequest, decode_json_body, json_response, make_error_handler
from avrgym.vr.server.web_server import STATIC_FOLDER, make_page_endpoint

MAX_BODY_BYTES = 1 << 13
COMMANDS: tuple[CommandName, ...] = ("stop", "pause", "continue", "end")


class AdmissionRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to open or close the study for new participants and sessions."""

    is_open: bool


class MessageRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to show a message on the page of a session's participant."""

    text: Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_LINE_LENGTH)]


def experimenter_app(
    store: Store, pool: SessionPool, state: HostState, tokens: StudyTokens, hosts: list[str]
) -> FastAPI:
    """Returns the web application. ``hosts``: allowed host names of requests."""

    def experimenter(request: Request) -> AuthenticatedClient:
        caller = tokens.client_of_request(request.headers)
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
        log.log_view(caller, "view sessions")
        return json_response(sessions_view(store, pool, state))

    def logged(caller: AuthenticatedClient, session_id: str, name: str, act: Callable[[], None]) -> None:
        session = pool.find(session_id)
        with log.log_command(caller, name, session.pseudonym if session else None):
            act()

    @app.post("/api/door")
    async def change_door(
        request: Request, caller: Annotated[AuthenticatedClient, Depends(experimenter)]
    ) -> Response:
        change = await decode_json_body(request, AdmissionRequest, MAX_BODY_BYTES)
        name = "open door" if change.is_open else "close door"
        await run_in_threadpool(logged, caller, "", name, lambda: state.set_open(change.is_open))
        return Response(status_code=204)

    @app.post("/api/sessions/{session_id}/message")
    async def send_message(
        session_id: str, request: Request, caller: Annotated[AuthenticatedClient, Depends(experimenter)]
    ) -> Response:
        message = await decode_json_body(request, MessageRequest, MAX_BODY_BYTES)
        await run_in_threadpool(
            logged, caller, session_id, "send message", lambda: pool.message(session_id, message.text)
        )
        return Response(status_code=204)

    def endpoint(name: CommandName) -> Callable[..., Awaitable[Response]]:
        async def command(
            session_id: str, request: Request, caller: Annotated[AuthenticatedClient, Depends(experimenter)]
        ) -> Response:
            await decode_json_body(request, EmptyRequest, MAX_BODY_BYTES)
            await run_in_threadpool(
                logged, caller, session_id, f"{name} session", lambda: pool.command(session_id, name)
            )
            return Response(status_code=204)

        return command

    for name in COMMANDS:
        app.post(f"/api/sessions/{{session_id}}/{name}")(endpoint(name))
    app.mount("/study", dashboard_app(store, tokens))
    for path, file in (("/", "host.html"), ("/participants", "dashboard.html")):
        app.get(path)(make_page_endpoint(file))
    add_session_pages(app, pool, "spectator")
    app.mount("/", StaticFiles(directory=STATIC_FOLDER))
    return app


def sessions_view(store: Store, pool: SessionPool, state: HostState) -> dict[str, Any]:
    """Returns the state of the host and of all sessions, as JSON values for the experimenter's page."""
    numbers = _participants_by_state(store)
    return {
        "title": store.design.title,
        "is_open": state.is_open,
        "capacity": pool.capacity,
        "session_cpu_share": pool.session_cpu_share,
        "missed_share": pool.missed_share,
        "waiting": pool.waiting,
        "participants": {state: numbers[state] for state in PARTICIPANT_TRANSITIONS if state in numbers},
        "problems": [problem] if (problem := object_store_problem(store)) else [],
        "copies_requested": requested(store, COPY_REQUESTED_EVENT),
        "sessions": [session_view(store, each) for each in pool.sessions],
    }


def _participants_by_state(store: Store) -> dict[str, int]:
    state = PARTICIPANT_TABLE.c.state
    with store.database.read_transaction() as connection:
        found = connection.execute(sa.select(state, sa.func.count()).group_by(state))
        return {name: number for name, number in found}


def session_view(store: Store, session: HostedSession) -> dict[str, Any]:
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
        "paused": report.paused,
        "minutes": report.seconds / 60.0,
        "latency_ms": report.latency_ms,
        "untracked_share": report.untracked_share,
        "missed_ticks": report.missed_ticks,
        "cpu_share": report.cpu_share,
        "crashes": session.crashes,
        "warnings": session_warnings(session, store.design.max_held_share),
    }


def session_warnings(session: HostedSession, max_held_share: float) -> list[str]:
    """Returns the warnings about a session: errors, crashes, lost connection, high latency and tracking loss."""
    report = session.report
    found = [report.problem] if report.problem else []
    if session.crashes:
        found.append(f"the process was replaced {session.crashes} times")
    if session.state == "running" and not report.is_connected:
        found.append("the participant is not connected")
    if report.latency_ms is not None and report.latency_ms > MAX_LATENCY_MS:
        found.append(
            f"the latency is {report.latency_ms:.0f} ms; at most {MAX_LATENCY_MS:.0f} ms are allowed"
        )
    if report.untracked_share > max_held_share:
        found.append(f"tracking was lost for {100.0 * report.untracked_share:.0f} % of the trials")
    return found
