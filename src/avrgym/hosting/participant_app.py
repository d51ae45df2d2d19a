"""Web application of the public server: the participant's page, its requests, and the pages of sessions.

The page sends an invitation's token in the body of a request, and the participant's token as ``Authorization: Bearer``.
Addresses, logs and cookies therefore contain no tokens, and other pages cannot send requests for the participant. This
server has no page for experimenters.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Annotated, Any

import msgspec
from fastapi import Depends, FastAPI, HTTPException, Request, Response
from fastapi.concurrency import run_in_threadpool
from fastapi.staticfiles import StaticFiles
from starlette.middleware.trustedhost import TrustedHostMiddleware

from avrgym.hosting.addresses import participant_link
from avrgym.hosting.data_requests import COPY_REQUESTED_EVENT, DELETION_REQUESTED_EVENT, requested
from avrgym.hosting.headset_codes import HeadsetCodes
from avrgym.hosting.host_state import HostState
from avrgym.hosting.participant_tokens import ParticipantTokens
from avrgym.hosting.rate_limits import RateLimits, client_address
from avrgym.hosting.session_pages import add_session_pages
from avrgym.hosting.session_pool import SessionPool
from avrgym.hosting.settings import HostSettings
from avrgym.hosting.stages import (
    SAFETY_CONFIRMED_EVENT,
    ConsentStage,
    InclusionStage,
    ReadyStage,
    SafetyStage,
    Stage,
    WaitingStage,
    record_participant_event,
    stage_of,
    to_json,
)
from avrgym.models.human import Sex
from avrgym.study.people.invitations import (
    InvitationError,
    RecruitmentServiceIds,
    enrol_with_invitation,
    find_valid_invitation,
)
from avrgym.study.people.participants import (
    decline_consent,
    record_consent,
    record_inclusion,
    withdraw,
)
from avrgym.study.sessions.threads import repeat_interrupted
from avrgym.study.storage.states import LostConnectionError, StudyError
from avrgym.study.storage.store import Store
from avrgym.texts.interface_texts import read_texts
from avrgym.vr.server.authentication import SameOriginMiddleware
from avrgym.vr.server.request_body import EmptyRequest, decode_json_body, json_response, make_error_handler
from avrgym.vr.server.session_links import CodeError, TooManyWrongCodesError
from avrgym.vr.server.web_server import STATIC_FOLDER, make_page_endpoint

MAX_BODY_BYTES = 1 << 13
BURST_PER_ADDRESS, REQUESTS_PER_MINUTE = 30, 30.0
"""Limits of requests without a participant's token, for each address. Several people may share an address."""
BURST_PER_PARTICIPANT, PARTICIPANT_REQUESTS_PER_MINUTE = 60, 120.0
"""Limits of requests with a participant's token, for each participant."""
STUDY_CLOSED_TEXT = "this study accepts no new participants now"

Token = Annotated[str, msgspec.Meta(max_length=128)]
RecruitmentServiceId = Annotated[str, msgspec.Meta(max_length=120)]
Age = Annotated[int, msgspec.Meta(ge=0, le=130)]


class InvitationRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to read an invitation. ``token``: the token in the invitation's link."""

    token: Token


class Enrolment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to enrol with an invitation. ``participant``, ``study``, ``session``: ids of a recruitment service."""

    token: Token
    sex: Sex
    age_years: Age | None = None
    language: Annotated[str, msgspec.Meta(max_length=35)] = ""
    participant: RecruitmentServiceId = ""
    study: RecruitmentServiceId = ""
    session: RecruitmentServiceId = ""


class ConsentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The participant's decision about the displayed consent text. ``version`` and ``sha256`` identify the text."""

    version: str
    sha256: str
    agreed: bool


class InclusionRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The answer (yes or no) to each inclusion question, by id."""

    answers: dict[str, bool]


class EnteredCode(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to use a headset code. ``code``: the digits; spaces are ignored."""

    code: Annotated[str, msgspec.Meta(max_length=40)]


@dataclass(frozen=True)
class Participation:
    """The objects that handlers of participants' requests use. ``origin``: the public origin of the study."""

    store: Store
    settings: HostSettings
    pool: SessionPool
    state: HostState
    codes: HeadsetCodes
    origin: str

    def stage(self, pseudonym: str) -> Stage:
        """Returns the participant's stage: their next step in the study."""
        return stage_of(self.store, self.settings, self.pool, pseudonym, is_open=self.state.is_open)

    def check_stage(self, pseudonym: str, *allowed: type[Stage]) -> Stage:
        """Returns the participant's stage. Raises ``StudyError`` if it is not in ``allowed``."""
        stage = self.stage(pseudonym)
        if not isinstance(stage, allowed):
            raise StudyError("this step is not possible now; reload the page to see the current step")
        return stage


def _decide(own: Participation, pseudonym: str, decision: ConsentRequest) -> None:
    stage = own.check_stage(pseudonym, ConsentStage)
    assert isinstance(stage, ConsentStage)
    if (decision.version, decision.sha256) != (stage.version, stage.sha256):
        raise StudyError("the consent text has changed; reload the page to read the current text")
    if decision.agreed:
        record_consent(own.store, pseudonym)
    elif own.store.participant(pseudonym).state == "enrolled":
        withdraw(own.store, pseudonym, "did not consent")
    else:
        decline_consent(own.store, pseudonym)


def _include(own: Participation, pseudonym: str, inclusion: InclusionRequest) -> None:
    own.check_stage(pseudonym, InclusionStage)
    record_inclusion(own.store, pseudonym, inclusion.answers)


def _confirm_safety(own: Participation, pseudonym: str, _: EmptyRequest) -> None:
    own.check_stage(pseudonym, SafetyStage)
    record_participant_event(own.store, pseudonym, SAFETY_CONFIRMED_EVENT)


def _wait(own: Participation, pseudonym: str, _: EmptyRequest) -> None:
    stage = own.check_stage(pseudonym, ReadyStage, WaitingStage)
    if isinstance(stage, ReadyStage) and not own.state.is_open:
        raise StudyError("the study starts no new sessions now; come back later")
    own.pool.join(pseudonym)


def _leave(own: Participation, pseudonym: str, _: EmptyRequest) -> None:
    own.pool.leave(pseudonym)


def _withdraw(own: Participation, pseudonym: str, _: EmptyRequest) -> None:
    own.pool.leave(pseudonym)
    withdraw(own.store, pseudonym, "on the participant's page")


def _request_deletion(own: Participation, pseudonym: str, _: EmptyRequest) -> None:
    own.pool.leave(pseudonym)
    if own.store.participant(pseudonym).state not in ("withdrawn", "excluded"):
        withdraw(own.store, pseudonym, "on the participant's page")
    record_participant_event(own.store, pseudonym, DELETION_REQUESTED_EVENT)


def _request_copy(own: Participation, pseudonym: str, _: EmptyRequest) -> None:
    if pseudonym not in requested(own.store, COPY_REQUESTED_EVENT):
        record_participant_event(own.store, pseudonym, COPY_REQUESTED_EVENT)


ACTIONS: dict[str, tuple[type[msgspec.Struct], Callable[[Participation, str, Any], None]]] = {
    "consent": (ConsentRequest, _decide),
    "inclusion": (InclusionRequest, _include),
    "safety": (EmptyRequest, _confirm_safety),
    "waiting-list": (EmptyRequest, _wait),
    "leave": (EmptyRequest, _leave),
    "withdrawal": (EmptyRequest, _withdraw),
    "deletion": (EmptyRequest, _request_deletion),
    "copy": (EmptyRequest, _request_copy),
}
"""Actions of a participant: type of the request body and function, by the last part of the route."""


def participant_app(
    own: Participation,
    tokens: ParticipantTokens,
    hosts: list[str],
    origins: frozenset[str],
    proxies: tuple[str, ...] = (),
) -> FastAPI:
    """Returns the web application of the public server.

    Args:
        own: the study, its sessions and settings.
        tokens: the tokens of participants.
        hosts: allowed host names of requests.
        origins: allowed origins of pages.
        proxies: addresses of reverse proxies, see ``client_address``.
    """
    by_address = RateLimits(BURST_PER_ADDRESS, REQUESTS_PER_MINUTE)
    by_participant = RateLimits(BURST_PER_PARTICIPANT, PARTICIPANT_REQUESTS_PER_MINUTE)
    app = FastAPI(openapi_url=None)
    app.add_middleware(SameOriginMiddleware, origins=origins)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts)
    app.add_exception_handler(InvitationError, _refuse_invitation)
    app.add_exception_handler(StudyError, make_error_handler(409))
    app.add_exception_handler(LostConnectionError, make_error_handler(503))
    app.add_exception_handler(OSError, make_error_handler(507))

    def limited(request: Request) -> None:
        if not by_address.allows(client_address(request.scope, proxies)):
            raise HTTPException(429, "too many requests; wait a minute")

    def participant(request: Request) -> str:
        caller = tokens.client_of_request(request.headers)
        if caller is None:
            limited(request)
            raise HTTPException(401, "invalid token; open your personal link to the study")
        if not by_participant.allows(caller.experimenter_name):
            raise HTTPException(429, "too many requests; wait a minute")
        return caller.experimenter_name

    @app.post("/api/invitation", dependencies=[Depends(limited)])
    async def read_invitation(request: Request) -> Response:
        given = await decode_json_body(request, InvitationRequest, MAX_BODY_BYTES)
        await run_in_threadpool(find_valid_invitation, own.store, given.token)
        _check_open(own.state)
        return json_response({"title": own.store.design.title, "languages": _languages(own.store)})

    @app.post("/api/participants", dependencies=[Depends(limited)])
    async def take_part(request: Request) -> Response:
        given = await decode_json_body(request, Enrolment, MAX_BODY_BYTES)
        _check_open(own.state)
        _, token = await run_in_threadpool(
            enrol_with_invitation,
            own.store,
            given.token,
            given.sex,
            age_years=given.age_years,
            language=given.language,
            service=RecruitmentServiceIds(given.participant, given.study, given.session),
        )
        await run_in_threadpool(tokens.participants.poll)
        return json_response({"token": token, "link": participant_link(own.origin, token)})

    @app.post("/api/headset", dependencies=[Depends(limited)])
    async def exchange_code(request: Request) -> Response:
        entered = await decode_json_body(request, EnteredCode, MAX_BODY_BYTES)
        try:
            return json_response({"token": own.codes.exchange("".join(entered.code.split()))})
        except TooManyWrongCodesError as error:
            raise HTTPException(429, str(error)) from None
        except CodeError as error:
            raise HTTPException(403, str(error)) from None

    @app.get("/api/stage")
    def read_stage(request: Request, pseudonym: Annotated[str, Depends(participant)]) -> Response:
        return json_response(repeat_interrupted(lambda: _progress(own, pseudonym)))

    @app.post("/api/code")
    def read_code(request: Request, _: Annotated[str, Depends(participant)]) -> Response:
        token = request.headers["authorization"].partition(" ")[2]
        return json_response({"code": own.codes.new(token)})

    for name, (kind, act) in ACTIONS.items():
        app.post(f"/api/{name}")(_endpoint(own, participant, kind, act))
    add_session_pages(app, own.pool)
    app.get("/")(make_page_endpoint("participate.html"))
    app.mount("/assets", StaticFiles(directory=STATIC_FOLDER / "assets"))
    app.get("/favicon.svg")(make_page_endpoint("favicon.svg"))
    app.get("/api/settings")(lambda: json_response(msgspec.to_builtins(own.settings.parameters)))
    return app


def _progress(own: Participation, pseudonym: str) -> dict[str, Any]:
    """Returns title, stage and texts for a participant's page. A waiting participant counts as present."""
    if own.pool.place(pseudonym) is not None:
        own.pool.join(pseudonym)
    texts = read_texts(own.store.participant(pseudonym).language or "en", own.store.folder)
    language = {"language": texts.language, "direction": texts.direction, "texts": dict(texts.page)}
    return {"title": own.store.design.title, "stage": to_json(own.stage(pseudonym)), "language": language}


def _check_open(state: HostState) -> None:
    if not state.is_open:
        raise InvitationError("closed", STUDY_CLOSED_TEXT)


def _languages(store: Store) -> list[dict[str, str]]:
    found = (read_texts(language, store.folder) for language in store.design.languages)
    return [{"language": each.language, "name": each.name} for each in found]


async def _refuse_invitation(_: Request, error: Exception) -> Response:
    assert isinstance(error, InvitationError)
    return json_response({"detail": str(error), "reason": error.reason}, 403)


def _endpoint(
    own: Participation,
    participant: Callable[[Request], str],
    kind: type[msgspec.Struct],
    act: Callable[[Participation, str, Any], None],
) -> Callable[..., Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        pseudonym = await run_in_threadpool(participant, request)
        body = await decode_json_body(request, kind, MAX_BODY_BYTES)
        await run_in_threadpool(repeat_interrupted, lambda: act(own, pseudonym, body))
        return Response(status_code=204)

    return endpoint
