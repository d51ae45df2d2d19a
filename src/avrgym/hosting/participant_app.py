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

from avrgym.hosting.data_requests import (
    DATA_COPY_REQUESTED_EVENT,
    DELETION_REQUESTED_EVENT,
    find_requesting_participants,
)
from avrgym.hosting.headset_codes import HeadsetCodes
from avrgym.hosting.host_state import HostState
from avrgym.hosting.participant_tokens import ParticipantTokens
from avrgym.hosting.public_links import make_participant_link
from avrgym.hosting.rate_limits import RateLimits, find_client_address
from avrgym.hosting.session_pages import add_session_pages
from avrgym.hosting.session_pool import SessionPool
from avrgym.hosting.settings import HostSettings
from avrgym.hosting.stages import (
    SAFETY_CONFIRMED_EVENT,
    ConsentStage,
    InclusionStage,
    ReadyForSessionStage,
    SafetyStage,
    Stage,
    WaitingStage,
    encode_stage,
    find_stage,
    record_participant_event,
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
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.sessions.session_threads import repeat_interrupted
from avrgym.study.storage.state_transitions import LostConnectionError, StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.texts.interface_texts import read_texts
from avrgym.vr.server.authentication import SameOriginMiddleware
from avrgym.vr.server.request_body import (
    EmptyRequest,
    decode_json_body,
    make_error_handler,
    make_json_response,
)
from avrgym.vr.server.session_links import CodeError, TooManyWrongCodesError
from avrgym.vr.server.web_server import STATIC_FOLDER, make_page_endpoint

MAX_REQUEST_BODY_BYTES = 1 << 13
MAX_ADDRESS_BURST_REQUESTS, MAX_ADDRESS_REQUESTS_PER_MINUTE = 30, 30.0
"""Limits of requests without a participant's token, for each address. Several people may share an address."""
MAX_PARTICIPANT_BURST_REQUESTS, MAX_PARTICIPANT_REQUESTS_PER_MINUTE = 60, 120.0
"""Limits of requests with a participant's token, for each participant."""
STUDY_CLOSED_TEXT = "this study accepts no new participants now"

Token = Annotated[str, msgspec.Meta(max_length=128)]
RecruitmentServiceId = Annotated[str, msgspec.Meta(max_length=120)]
Age = Annotated[int, msgspec.Meta(ge=0, le=130)]


class InvitationRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to read an invitation. ``token``: the token in the invitation's link."""

    token: Token


class EnrolmentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
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


class HeadsetCodeRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to use a headset code. ``code``: the digits; spaces are ignored."""

    code: Annotated[str, msgspec.Meta(max_length=40)]


@dataclass(frozen=True)
class ParticipantRequestContext:
    """The objects that handlers of participants' requests use. ``public_url``: the public origin of the study."""

    store: StudyStore
    settings: HostSettings
    pool: SessionPool
    state: HostState
    headset_codes: HeadsetCodes
    public_url: str

    def find_stage(self, pseudonym: str) -> Stage:
        """Returns the participant's stage: their next step in the study."""
        return find_stage(self.store, self.settings, self.pool, pseudonym, is_open=self.state.is_study_open)

    def check_stage(self, pseudonym: str, *allowed: type[Stage]) -> Stage:
        """Returns the participant's stage. Raises ``StudyError`` if it is not in ``allowed``."""
        stage = self.find_stage(pseudonym)
        if not isinstance(stage, allowed):
            raise StudyError("this step is not possible now; reload the page to see the current step")
        return stage


def _decide(own: ParticipantRequestContext, pseudonym: str, decision: ConsentRequest) -> None:
    stage = own.check_stage(pseudonym, ConsentStage)
    assert isinstance(stage, ConsentStage)
    if (decision.version, decision.sha256) != (stage.version, stage.sha256):
        raise StudyError("the consent text has changed; reload the page to read the current text")
    if decision.agreed:
        record_consent(own.store, pseudonym)
    elif own.store.read_participant(pseudonym).state == "enrolled":
        withdraw_participant(own.store, pseudonym, "did not consent")
    else:
        decline_consent(own.store, pseudonym)


def _include(own: ParticipantRequestContext, pseudonym: str, inclusion: InclusionRequest) -> None:
    own.check_stage(pseudonym, InclusionStage)
    record_inclusion_answers(own.store, pseudonym, inclusion.answers)


def _confirm_safety(own: ParticipantRequestContext, pseudonym: str, _: EmptyRequest) -> None:
    own.check_stage(pseudonym, SafetyStage)
    record_participant_event(own.store, pseudonym, SAFETY_CONFIRMED_EVENT)


def _wait(own: ParticipantRequestContext, pseudonym: str, _: EmptyRequest) -> None:
    stage = own.check_stage(pseudonym, ReadyForSessionStage, WaitingStage)
    if isinstance(stage, ReadyForSessionStage) and not own.state.is_study_open:
        raise StudyError("the study starts no new sessions now; come back later")
    own.pool.join_waiting_list(pseudonym)


def _leave(own: ParticipantRequestContext, pseudonym: str, _: EmptyRequest) -> None:
    own.pool.leave_waiting_list(pseudonym)


def _withdraw(own: ParticipantRequestContext, pseudonym: str, _: EmptyRequest) -> None:
    own.pool.leave_waiting_list(pseudonym)
    withdraw_participant(own.store, pseudonym, "on the participant's page")


def _request_deletion(own: ParticipantRequestContext, pseudonym: str, _: EmptyRequest) -> None:
    own.pool.leave_waiting_list(pseudonym)
    if own.store.read_participant(pseudonym).state not in ("withdrawn", "excluded"):
        withdraw_participant(own.store, pseudonym, "on the participant's page")
    record_participant_event(own.store, pseudonym, DELETION_REQUESTED_EVENT)


def _request_copy(own: ParticipantRequestContext, pseudonym: str, _: EmptyRequest) -> None:
    if pseudonym not in find_requesting_participants(own.store, DATA_COPY_REQUESTED_EVENT):
        record_participant_event(own.store, pseudonym, DATA_COPY_REQUESTED_EVENT)


PARTICIPANT_ACTIONS: dict[
    str, tuple[type[msgspec.Struct], Callable[[ParticipantRequestContext, str, Any], None]]
] = {
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


def make_participant_app(
    own: ParticipantRequestContext,
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
        proxies: addresses of reverse proxies, see ``find_client_address``.
    """
    by_address = RateLimits(MAX_ADDRESS_BURST_REQUESTS, MAX_ADDRESS_REQUESTS_PER_MINUTE)
    by_participant = RateLimits(MAX_PARTICIPANT_BURST_REQUESTS, MAX_PARTICIPANT_REQUESTS_PER_MINUTE)
    app = FastAPI(openapi_url=None)
    app.add_middleware(SameOriginMiddleware, origins=origins)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts)
    app.add_exception_handler(InvitationError, _refuse_invitation)
    app.add_exception_handler(StudyError, make_error_handler(409))
    app.add_exception_handler(LostConnectionError, make_error_handler(503))
    app.add_exception_handler(OSError, make_error_handler(507))

    def limited(request: Request) -> None:
        if not by_address.allows(find_client_address(request.scope, proxies)):
            raise HTTPException(429, "too many requests; wait a minute")

    def participant(request: Request) -> str:
        caller = tokens.authenticate_request(request.headers)
        if caller is None:
            limited(request)
            raise HTTPException(401, "invalid token; open your personal link to the study")
        if not by_participant.allows(caller.user_name):
            raise HTTPException(429, "too many requests; wait a minute")
        return caller.user_name

    @app.post("/api/invitation", dependencies=[Depends(limited)])
    async def read_invitation(request: Request) -> Response:
        given = await decode_json_body(request, InvitationRequest, MAX_REQUEST_BODY_BYTES)
        await run_in_threadpool(find_valid_invitation, own.store, given.token)
        _check_open(own.state)
        return make_json_response({"title": own.store.design.title, "languages": _languages(own.store)})

    @app.post("/api/participants", dependencies=[Depends(limited)])
    async def take_part(request: Request) -> Response:
        given = await decode_json_body(request, EnrolmentRequest, MAX_REQUEST_BODY_BYTES)
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
        await run_in_threadpool(tokens.token_reader.poll)
        return make_json_response({"token": token, "link": make_participant_link(own.public_url, token)})

    @app.post("/api/headset", dependencies=[Depends(limited)])
    async def exchange_code(request: Request) -> Response:
        entered = await decode_json_body(request, HeadsetCodeRequest, MAX_REQUEST_BODY_BYTES)
        try:
            return make_json_response(
                {"token": own.headset_codes.exchange_code("".join(entered.code.split()))}
            )
        except TooManyWrongCodesError as error:
            raise HTTPException(429, str(error)) from None
        except CodeError as error:
            raise HTTPException(403, str(error)) from None

    @app.get("/api/stage")
    def read_stage(request: Request, pseudonym: Annotated[str, Depends(participant)]) -> Response:
        return make_json_response(repeat_interrupted(lambda: _progress(own, pseudonym)))

    @app.post("/api/code")
    def read_code(request: Request, _: Annotated[str, Depends(participant)]) -> Response:
        token = request.headers["authorization"].partition(" ")[2]
        return make_json_response({"code": own.headset_codes.create_code(token)})

    for name, (kind, act) in PARTICIPANT_ACTIONS.items():
        app.post(f"/api/{name}")(_endpoint(own, participant, kind, act))
    add_session_pages(app, own.pool)
    app.get("/")(make_page_endpoint("participate.html"))
    app.mount("/assets", StaticFiles(directory=STATIC_FOLDER / "assets"))
    app.get("/favicon.svg")(make_page_endpoint("favicon.svg"))
    app.get("/api/settings")(lambda: make_json_response(msgspec.to_builtins(own.settings.parameters)))
    return app


def _progress(own: ParticipantRequestContext, pseudonym: str) -> dict[str, Any]:
    """Returns title, stage and texts for a participant's page. A waiting participant counts as present."""
    if own.pool.find_waiting_list_place(pseudonym) is not None:
        own.pool.join_waiting_list(pseudonym)
    texts = read_texts(own.store.read_participant(pseudonym).language or "en", own.store.folder)
    language = {"language": texts.language, "direction": texts.direction, "texts": dict(texts.page)}
    return {
        "title": own.store.design.title,
        "stage": encode_stage(own.find_stage(pseudonym)),
        "language": language,
    }


def _check_open(state: HostState) -> None:
    if not state.is_study_open:
        raise InvitationError("closed", STUDY_CLOSED_TEXT)


def _languages(store: StudyStore) -> list[dict[str, str]]:
    found = (read_texts(language, store.folder) for language in store.design.languages)
    return [{"language": each.language, "name": each.name} for each in found]


async def _refuse_invitation(_: Request, error: Exception) -> Response:
    assert isinstance(error, InvitationError)
    return make_json_response({"detail": str(error), "reason": error.reason}, 403)


def _endpoint(
    own: ParticipantRequestContext,
    participant: Callable[[Request], str],
    kind: type[msgspec.Struct],
    act: Callable[[ParticipantRequestContext, str, Any], None],
) -> Callable[..., Awaitable[Response]]:
    async def endpoint(request: Request) -> Response:
        pseudonym = await run_in_threadpool(participant, request)
        body = await decode_json_body(request, kind, MAX_REQUEST_BODY_BYTES)
        await run_in_threadpool(repeat_interrupted, lambda: act(own, pseudonym, body))
        return Response(status_code=204)

    return endpoint
