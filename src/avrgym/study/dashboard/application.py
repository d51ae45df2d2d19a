"""Web application (JSON) of the experimenter's dashboard.

Each route requires the experimenter's token as ``Authorization: Bearer``. Routes accept names and contacts, but never
return them.
"""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol

import msgspec
from fastapi import Depends, FastAPI, HTTPException, Request, Response
from fastapi.concurrency import run_in_threadpool

from avrgym.commands.preferences import DEFAULT_PREFERENCES, change_preferences
from avrgym.commands.respondents import PARTICIPANT_RESPONDENT
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Sex
from avrgym.policies.trained_policies import PolicyError
from avrgym.recording.input_profile import InputProfile
from avrgym.study.dashboard.caregiver_application import make_caregiver_app
from avrgym.study.dashboard.displayed_data import (
    make_displayed_participant,
    make_displayed_results,
    make_session_access,
    make_study_overview,
)
from avrgym.study.dashboard.request_log import VIEW_RESULTS_ACTION, DashboardLog
from avrgym.study.people.adverse_events import AdverseEventDetails, record_adverse_event
from avrgym.study.people.furniture import read_own_furniture, record_own_furniture
from avrgym.study.people.identities import PossibleDuplicateError
from avrgym.study.people.input_profiles import make_input_profile, set_input_profile
from avrgym.study.people.participant_respondents import set_respondent
from avrgym.study.people.participants import (
    add_note,
    decline_consent,
    edit_note,
    enrol_participant,
    record_consent,
    record_inclusion_answers,
    set_identity,
    withdraw_participant,
)
from avrgym.study.people.preferences import read_latest_preferences, record_preferences
from avrgym.study.storage.free_text import MAX_LINE_LENGTH, MAX_NOTE_LENGTH
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.server.authentication import AuthenticatedClient, Tokens
from avrgym.vr.server.request_body import (
    EmptyRequest,
    decode_json_body,
    make_error_handler,
    make_json_response,
)
from avrgym.vr.server.session_links import SessionLinks

MAX_REQUEST_BODY_BYTES = 1 << 16

SingleLineText = Annotated[str, msgspec.Meta(max_length=MAX_LINE_LENGTH)]
NoteText = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_NOTE_LENGTH)]


class LiveSessions(Protocol):
    """The live sessions of this server. At most one session is running."""

    @property
    def running_participant(self) -> str | None:
        """Pseudonym of the running session's participant; ``None`` without a session."""
        ...

    @property
    def furniture(self) -> RealFurniture:
        """The real seat and bed for the next session."""
        ...

    def begin_session(self, pseudonym: str, furniture: RealFurniture | None = None) -> None:
        """Start a participant's session. Raises ``StudyError`` or ``PolicyError`` if it cannot start."""
        ...

    def withdraw_participant(self, pseudonym: str, reason: str) -> None:
        """Stop the robot and the recording of the running session. Then store the withdrawal and its reason."""
        ...

    @property
    def participant_links(self) -> SessionLinks:
        """The session links. Only the link of the running session is valid."""
        ...

    @property
    def caregiver_links(self) -> SessionLinks:
        """The links of caregivers; the latest is valid until the next session begins."""
        ...

    @property
    def caregiver_session_id(self) -> int | None:
        """The id of the session that the caregiver's link opens; ``None`` before the first session of this server."""
        ...

    def change_input_profile(self, pseudonym: str, profile: InputProfile) -> None:
        """Change and store the input profile of the running session's participant."""
        ...

    def renew_session_link(self, pseudonym: str) -> None:
        """Create a new link for the participant's running session. The earlier link becomes invalid."""
        ...


@dataclass(frozen=True)
class Dashboard:
    """The study that a dashboard displays.

    ``live_sessions``: the live sessions of this server; ``None`` if it runs none. ``experimenter_name``: name of the
    experimenter.
    """

    store: StudyStore
    live_sessions: LiveSessions | None
    experimenter_name: str = ""

    @property
    def running_participant(self) -> str | None:
        """Pseudonym of the running session's participant; ``None`` without a session."""
        return self.live_sessions.running_participant if self.live_sessions else None

    @property
    def furniture(self) -> RealFurniture:
        """The real seat and bed for the next session."""
        return self.live_sessions.furniture if self.live_sessions else self.store.design.furniture


class EnrolmentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to enrol a new participant.

    ``sex``: body model. ``confirm_duplicate``: enrol although another participant has the same name or contact.
    ``input``: fields of ``recording.input_profile``; ``None`` for two controllers.
    """

    sex: Sex
    age_years: int | None = None
    language: SingleLineText = ""
    name: SingleLineText = ""
    contact: SingleLineText = ""
    confirm_duplicate: bool = False
    input: dict[str, Any] | None = None


class IdentityRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to store name and contact of a participant in the identity file.

    ``confirm_duplicate``: store them although another participant has the same name or contact.
    """

    name: SingleLineText
    contact: SingleLineText
    confirm_duplicate: bool = False


class ConsentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A decision about the consent text. ``version``: the version that the person read.

    ``role``: one of ``CONSENT_ROLES``.
    """

    version: str
    role: str = PARTICIPANT_RESPONDENT


class InclusionRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The participant's answer (yes or no) to each inclusion question, by id."""

    answers: dict[str, bool]


class InputProfileRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to change the participant's input profile. ``profile``: fields of ``recording.input_profile``."""

    profile: dict[str, Any]


class RespondentRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to change the respondent of questionnaires. ``respondent``: one of ``PARTICIPANT_RESPONDENTS``."""

    respondent: str


class PreferencesRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to change preferences for the robot. ``changes``: texts ``name=value``, see ``change_preferences``."""

    changes: list[SingleLineText]


class WithdrawalRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to withdraw a participant and stop a running session. The reason may be empty."""

    reason: SingleLineText = ""


class NoteRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to add an experimenter's note about a participant. The text may have several lines."""

    text: NoteText


class NoteEditRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to replace the text of a note. ``id``: id of the note."""

    id: int
    text: NoteText


class AdverseEventRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A report of a new adverse event, or a follow-up of the adverse event with number ``follows``."""

    report: AdverseEventDetails
    follows: int | None = None


class SessionStartRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request to start a session. ``furniture`` replaces the furniture of the previous session.

    ``own``: the furniture belongs to the participant and is stored for their later sessions.
    """

    furniture: RealFurniture | None = None
    own: bool = False


def _enrol(dashboard: Dashboard, new: EnrolmentRequest) -> dict[str, str]:
    pseudonym = enrol_participant(
        dashboard.store,
        new.sex,
        age_years=new.age_years,
        language=new.language,
        name=new.name,
        contact=new.contact,
        confirm_duplicate=new.confirm_duplicate,
        input_profile=None if new.input is None else make_input_profile(new.input),
    )
    return {"participant": pseudonym}


def _identify(dashboard: Dashboard, pseudonym: str, identification: IdentityRequest) -> None:
    set_identity(
        dashboard.store,
        pseudonym,
        identification.name,
        identification.contact,
        confirm_duplicate=identification.confirm_duplicate,
    )


def _consent(dashboard: Dashboard, pseudonym: str, agreement: ConsentRequest) -> None:
    _check_version(dashboard, agreement)
    record_consent(dashboard.store, pseudonym, agreement.role)


def _decline(dashboard: Dashboard, pseudonym: str, refusal: ConsentRequest) -> None:
    _check_version(dashboard, refusal)
    decline_consent(dashboard.store, pseudonym, refusal.role)


def _check_version(dashboard: Dashboard, agreement: ConsentRequest) -> None:
    present = dashboard.store.design.consent.version
    if agreement.version != present:
        raise StudyError(
            f"the displayed consent text has version {agreement.version!r}, but the current version is {present!r}; "
            "reload the page"
        )


def _include(dashboard: Dashboard, pseudonym: str, inclusion: InclusionRequest) -> None:
    record_inclusion_answers(dashboard.store, pseudonym, inclusion.answers)


def _change_input(dashboard: Dashboard, pseudonym: str, new: InputProfileRequest) -> None:
    profile = make_input_profile(new.profile)
    if dashboard.live_sessions is not None and dashboard.live_sessions.running_participant == pseudonym:
        dashboard.live_sessions.change_input_profile(pseudonym, profile)
    else:
        set_input_profile(dashboard.store, pseudonym, profile)


def _change_respondent(dashboard: Dashboard, pseudonym: str, new: RespondentRequest) -> None:
    set_respondent(dashboard.store, pseudonym, new.respondent)


def _change_preferences(dashboard: Dashboard, pseudonym: str, new: PreferencesRequest) -> None:
    before = read_latest_preferences(dashboard.store, pseudonym) or DEFAULT_PREFERENCES
    try:
        preferences = change_preferences(before, new.changes)
    except ValueError as error:
        raise StudyError(str(error)) from None
    record_preferences(dashboard.store, pseudonym, preferences)


def _withdraw(dashboard: Dashboard, pseudonym: str, withdrawal: WithdrawalRequest) -> None:
    if dashboard.live_sessions is not None and dashboard.live_sessions.running_participant == pseudonym:
        dashboard.live_sessions.withdraw_participant(pseudonym, withdrawal.reason)
    else:
        withdraw_participant(dashboard.store, pseudonym, withdrawal.reason)


def _note(dashboard: Dashboard, pseudonym: str, note: NoteRequest) -> None:
    running = dashboard.running_participant == pseudonym
    session = dashboard.store.read_sessions(pseudonym)[-1].id if running else None
    add_note(dashboard.store, pseudonym, note.text, session)


def _edit_note(dashboard: Dashboard, pseudonym: str, note: NoteEditRequest) -> None:
    edit_note(dashboard.store, pseudonym, note.id, note.text)


def _report(dashboard: Dashboard, pseudonym: str, new: AdverseEventRequest) -> None:
    record_adverse_event(
        dashboard.store, pseudonym, new.report, follows=new.follows, recorded_by=dashboard.experimenter_name
    )


def _begin(dashboard: Dashboard, pseudonym: str, start: SessionStartRequest) -> None:
    if dashboard.live_sessions is None:
        raise StudyError("this server runs no sessions; `avrgym serve --study DIR` runs them")
    stored = read_own_furniture(dashboard.store, pseudonym)
    given = start.furniture
    if given is None or not (start.own or stored):
        dashboard.live_sessions.begin_session(pseudonym, given)
        return
    if given != stored:
        record_own_furniture(dashboard.store, pseudonym, given)
    dashboard.live_sessions.begin_session(pseudonym)


def _renew_link(dashboard: Dashboard, pseudonym: str, _: EmptyRequest) -> None:
    if dashboard.live_sessions is None:
        raise StudyError("this server runs no sessions; `avrgym serve --study DIR` runs them")
    dashboard.live_sessions.renew_session_link(pseudonym)


PARTICIPANT_ACTIONS: Mapping[str, tuple[type[msgspec.Struct], Callable[[Dashboard, str, Any], None]]] = {
    "identity": (IdentityRequest, _identify),
    "consent": (ConsentRequest, _consent),
    "declined-consent": (ConsentRequest, _decline),
    "inclusion": (InclusionRequest, _include),
    "input": (InputProfileRequest, _change_input),
    "respondent": (RespondentRequest, _change_respondent),
    "preferences": (PreferencesRequest, _change_preferences),
    "withdrawal": (WithdrawalRequest, _withdraw),
    "notes": (NoteRequest, _note),
    "edited-notes": (NoteEditRequest, _edit_note),
    "adverse-events": (AdverseEventRequest, _report),
    "sessions": (SessionStartRequest, _begin),
    "links": (EmptyRequest, _renew_link),
}
"""Actions on a participant: type of the request body and function, by the last part of the action's route."""
AUDIT_LOG_ACTION_NAMES = {
    "identity": "change identity",
    "input": "change input",
    "respondent": "change respondent",
    "preferences": "record preferences",
    "withdrawal": "withdraw",
    "notes": "add note",
    "edited-notes": "edit note",
    "adverse-events": "record adverse event",
    "sessions": "begin session",
    "links": "make link",
}
"""Names of actions in the audit log, if they differ from the last part of the route."""


def make_dashboard_app(
    store: StudyStore,
    tokens: Tokens,
    live: LiveSessions | None = None,
    addresses: Callable[[str], Sequence[str]] = lambda link: (f"/#token={link}",),
    caregiver_addresses: Callable[[str], Sequence[str]] = lambda link: (f"/caregiver#token={link}",),
) -> FastAPI:
    """Returns the web application of a study, to be mounted at ``/study``.

    Args:
        store: the study. All views and actions are added to the study's audit log.
        tokens: the server's tokens; only tokens of experimenters are accepted.
        live: the live sessions of this server; without them, no session can be started.
        addresses: returns the addresses of the participant's page for a link.
        caregiver_addresses: returns the addresses of the caregiver's page for a link.
    """

    def experimenter_only(request: Request) -> None:
        caller = tokens.authenticate_request(request.headers)
        if caller is None or caller.role != "experimenter":
            raise HTTPException(
                401, "invalid token; open the experimenter's address, which the server printed"
            )
        request.state.caller = caller

    dashboard, log = Dashboard(store, live), DashboardLog(store)
    app = FastAPI(openapi_url=None, dependencies=[Depends(experimenter_only)])
    app.add_exception_handler(StudyError, make_error_handler(409))
    app.add_exception_handler(PossibleDuplicateError, make_error_handler(409, confirm="duplicate"))
    app.add_exception_handler(PolicyError, make_error_handler(409))
    app.add_exception_handler(OSError, make_error_handler(507))

    @app.get("/overview")
    def read_overview(request: Request) -> Response:
        log.log_page_view(_caller(request), "view dashboard")
        link = (
            make_session_access(dashboard.live_sessions.participant_links, addresses)
            if dashboard.live_sessions
            else None
        )
        own = dashboard.live_sessions.caregiver_links.current_link_token if dashboard.live_sessions else None
        caregiver = tuple(caregiver_addresses(own)) if own else ()
        furniture, name = dashboard.furniture, _caller(request).user_name
        return make_json_response(
            make_study_overview(store, dashboard.running_participant, furniture, name, link, caregiver)
        )

    @app.get("/results")
    def read_results(request: Request) -> Response:
        log.log_page_view(_caller(request), VIEW_RESULTS_ACTION)
        return make_json_response(make_displayed_results(store))

    @app.get("/participants/{pseudonym}")
    def read_participant(pseudonym: str, request: Request) -> Response:
        view = make_displayed_participant(store, pseudonym)
        log.log_page_view(_caller(request), "view participant", pseudonym)
        return make_json_response(view)

    def logged(caller: AuthenticatedClient, new: EnrolmentRequest) -> dict[str, str]:
        with log.log_command(caller, "enrol", None) as entry:
            enrolled = _enrol(dashboard, new)
            entry.pseudonym = enrolled["participant"]
        return enrolled

    @app.post("/participants")
    async def enrol_somebody(request: Request) -> Response:
        return make_json_response(
            await run_in_threadpool(
                logged,
                _caller(request),
                await decode_json_body(request, EnrolmentRequest, MAX_REQUEST_BODY_BYTES),
            )
        )

    if live is not None:
        app.mount("/care", make_caregiver_app(store, tokens, live))
    for name, (kind, act) in PARTICIPANT_ACTIONS.items():
        endpoint = _endpoint(dashboard, log, AUDIT_LOG_ACTION_NAMES.get(name, name), kind, act)
        app.post(f"/participants/{{pseudonym}}/{name}")(endpoint)
    return app


def _endpoint(
    dashboard: Dashboard,
    log: DashboardLog,
    name: str,
    kind: type[msgspec.Struct],
    act: Callable[[Dashboard, str, Any], None],
) -> Callable[..., Awaitable[Response]]:
    def logged(caller: AuthenticatedClient, pseudonym: str, body: Any) -> None:
        with log.log_command(caller, name, pseudonym):
            act(replace(dashboard, experimenter_name=caller.user_name), pseudonym, body)

    async def endpoint(pseudonym: str, request: Request) -> Response:
        await run_in_threadpool(
            logged, _caller(request), pseudonym, await decode_json_body(request, kind, MAX_REQUEST_BODY_BYTES)
        )
        return Response(status_code=204)

    return endpoint


def _caller(request: Request) -> AuthenticatedClient:
    return request.state.caller
