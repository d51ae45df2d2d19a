"""The experimenter's dashboard: what it reads of a study and does to it, as a web application of JSON.

Every route needs the experimenter's token as ``Authorization: Bearer``. Names and contacts go in and never come out.
"""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Protocol, TypeVar

import msgspec
from fastapi import Depends, FastAPI, HTTPException, Request, Response
from fastapi.concurrency import run_in_threadpool

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Sex
from avrgym.policies.trained import PolicyError
from avrgym.study.dashboard.request_log import VIEW_RESULTS, DashboardLog
from avrgym.study.dashboard.views import link_view, overview, participant_view, results_view
from avrgym.study.people.adverse_events import Report, record_adverse_event
from avrgym.study.people.identities import PossibleDuplicate
from avrgym.study.people.participants import (
    add_note,
    decline_consent,
    edit_note,
    enrol,
    record_consent,
    record_inclusion,
    set_identity,
    withdraw,
)
from avrgym.study.storage.free_text import MAX_LINE_LENGTH, MAX_NOTE_LENGTH
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.vr.server.authentication import Caller, Tokens
from avrgym.vr.server.request_body import posted_json
from avrgym.vr.server.session_links import SessionLinks

MAX_BODY_BYTES = 1 << 16

Line = Annotated[str, msgspec.Meta(max_length=MAX_LINE_LENGTH)]
Text = Annotated[str, msgspec.Meta(min_length=1, max_length=MAX_NOTE_LENGTH)]


class LiveSessions(Protocol):
    """The sessions that this server runs, one at a time."""

    @property
    def participant(self) -> str | None:
        """The pseudonym of the participant whose session runs."""
        ...

    @property
    def furniture(self) -> RealFurniture:
        """What participants of the next session really sit and lie on."""
        ...

    def begin(self, pseudonym: str, furniture: RealFurniture | None = None) -> None:
        """Begin or continue a participant's session; ``StudyError`` or ``PolicyError`` when that cannot be."""
        ...

    def withdraw(self, pseudonym: str, reason: str) -> None:
        """Stop robot and recording of the participant whose session runs, then store that they withdrew."""
        ...

    @property
    def links(self) -> SessionLinks:
        """The link of the session that runs."""
        ...

    def renew_link(self, pseudonym: str) -> None:
        """Make a new link for the session of this participant, which runs; the link before has ended."""
        ...


@dataclass(frozen=True)
class Dashboard:
    """A study, the sessions that this server runs, if it runs any, and the experimenter who acts, if they are named."""

    store: Store
    live: LiveSessions | None
    experimenter: str = ""

    @property
    def participant(self) -> str | None:
        """Whose session runs."""
        return self.live.participant if self.live else None

    @property
    def furniture(self) -> RealFurniture:
        """What participants of the next session really sit and lie on."""
        return self.live.furniture if self.live else self.store.design.furniture


class Enrolment(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Somebody new."""

    sex: Sex
    age_years: int | None = None
    language: Line = ""
    name: Line = ""
    contact: Line = ""
    confirm_duplicate: bool = False


class Identification(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Who a participant is."""

    name: Line
    contact: Line
    confirm_duplicate: bool = False


class Agreement(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The version of the consent text that was read, and agreed to or declined."""

    version: str


class InclusionAnswers(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Yes or no to each inclusion question by its id."""

    answers: dict[str, bool]


class Withdrawal(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """That somebody takes part no longer; the reason may be empty."""

    reason: Line = ""


class NewNote(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the experimenter writes down."""

    text: Text


class EditedNote(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a note of this id shall say from now on."""

    id: int
    text: Text


class NewReport(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A report of a new adverse event, or a follow-up of the event with the number in ``follows``."""

    report: Report
    follows: int | None = None


class NewLink(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Request of a new link for the session that runs."""


class SessionStart(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """That a session shall begin or go on, with other furniture than the one before if it is given."""

    furniture: RealFurniture | None = None


def _enrol(board: Dashboard, new: Enrolment) -> dict[str, str]:
    pseudonym = enrol(
        board.store,
        new.sex,
        age_years=new.age_years,
        language=new.language,
        name=new.name,
        contact=new.contact,
        confirm_duplicate=new.confirm_duplicate,
    )
    return {"participant": pseudonym}


def _identify(board: Dashboard, pseudonym: str, who: Identification) -> None:
    set_identity(board.store, pseudonym, who.name, who.contact, confirm_duplicate=who.confirm_duplicate)


def _consent(board: Dashboard, pseudonym: str, agreement: Agreement) -> None:
    _check_version(board, agreement)
    record_consent(board.store, pseudonym)


def _decline(board: Dashboard, pseudonym: str, refusal: Agreement) -> None:
    _check_version(board, refusal)
    decline_consent(board.store, pseudonym)


def _check_version(board: Dashboard, agreement: Agreement) -> None:
    present = board.store.design.consent.version
    if agreement.version != present:
        raise StudyError(
            f"version {agreement.version!r} of the consent text was shown; the study's is {present!r}"
        )


def _include(board: Dashboard, pseudonym: str, inclusion: InclusionAnswers) -> None:
    record_inclusion(board.store, pseudonym, inclusion.answers)


def _withdraw(board: Dashboard, pseudonym: str, withdrawal: Withdrawal) -> None:
    if board.live is not None and board.live.participant == pseudonym:
        board.live.withdraw(pseudonym, withdrawal.reason)
    else:
        withdraw(board.store, pseudonym, withdrawal.reason)


def _note(board: Dashboard, pseudonym: str, note: NewNote) -> None:
    running = board.participant == pseudonym
    session = board.store.sessions(pseudonym)[-1].id if running else None
    add_note(board.store, pseudonym, note.text, session)


def _edit_note(board: Dashboard, pseudonym: str, note: EditedNote) -> None:
    edit_note(board.store, pseudonym, note.id, note.text)


def _report(board: Dashboard, pseudonym: str, new: NewReport) -> None:
    record_adverse_event(
        board.store, pseudonym, new.report, follows=new.follows, recorded_by=board.experimenter
    )


def _begin(board: Dashboard, pseudonym: str, start: SessionStart) -> None:
    if board.live is None:
        raise StudyError("no sessions are run here; `avrgym serve --study DIR` runs them")
    board.live.begin(pseudonym, start.furniture)


def _renew_link(board: Dashboard, pseudonym: str, _: NewLink) -> None:
    if board.live is None:
        raise StudyError("no sessions are run here; `avrgym serve --study DIR` runs them")
    board.live.renew_link(pseudonym)


ACTIONS: Mapping[str, tuple[type[msgspec.Struct], Callable[[Dashboard, str, Any], None]]] = {
    "identity": (Identification, _identify),
    "consent": (Agreement, _consent),
    "declined-consent": (Agreement, _decline),
    "inclusion": (InclusionAnswers, _include),
    "withdrawal": (Withdrawal, _withdraw),
    "notes": (NewNote, _note),
    "edited-notes": (EditedNote, _edit_note),
    "adverse-events": (NewReport, _report),
    "sessions": (SessionStart, _begin),
    "links": (NewLink, _renew_link),
}
"""What is done to a participant, by the last part of the route: what is posted, and what it does."""
LOGGED_AS = {
    "identity": "change identity",
    "withdrawal": "withdraw",
    "notes": "add note",
    "edited-notes": "edit note",
    "adverse-events": "record adverse event",
    "sessions": "begin session",
    "links": "make link",
}
"""The name of an action in the log, where it is not that of the route."""


def dashboard_app(
    store: Store,
    tokens: Tokens,
    live: LiveSessions | None = None,
    addresses: Callable[[str], Sequence[str]] = lambda link: (f"/#token={link}",),
) -> FastAPI:
    """The web application of a study, to be mounted at ``/study``.

    Args:
        store: the study. Its log contains who views what, and each action.
        tokens: those of experimenters open all routes.
        live: the sessions that this server runs; without them only the study itself is led.
        addresses: those of the participant's page with a link, as other devices reach it.
    """

    def experimenter_only(request: Request) -> None:
        caller = tokens.bearer(request.headers)
        if caller is None or caller.role != "experimenter":
            raise HTTPException(401, "this needs the experimenter's address that the server printed")
        request.state.caller = caller

    board, log = Dashboard(store, live), DashboardLog(store)
    app = FastAPI(openapi_url=None, dependencies=[Depends(experimenter_only)])
    app.add_exception_handler(StudyError, _refuse(409))
    app.add_exception_handler(PossibleDuplicate, _refuse(409, confirm="duplicate"))
    app.add_exception_handler(PolicyError, _refuse(409))
    app.add_exception_handler(OSError, _refuse(507))

    @app.get("/overview")
    def read_overview(request: Request) -> Response:
        log.view(_caller(request), "view dashboard")
        link = link_view(board.live.links, addresses) if board.live else None
        return _json(overview(store, board.participant, board.furniture, _caller(request).name, link))

    @app.get("/results")
    def read_results(request: Request) -> Response:
        log.view(_caller(request), VIEW_RESULTS)
        return _json(results_view(store))

    @app.get("/participants/{pseudonym}")
    def read_participant(pseudonym: str, request: Request) -> Response:
        view = participant_view(store, pseudonym)
        log.view(_caller(request), "view participant", pseudonym)
        return _json(view)

    def logged(caller: Caller, new: Enrolment) -> dict[str, str]:
        with log.command(caller, "enrol", None) as entry:
            enrolled = _enrol(board, new)
            entry.participant = enrolled["participant"]
        return enrolled

    @app.post("/participants")
    async def enrol_somebody(request: Request) -> Response:
        return _json(await run_in_threadpool(logged, _caller(request), await _body(request, Enrolment)))

    for name, (kind, act) in ACTIONS.items():
        endpoint = _endpoint(board, log, LOGGED_AS.get(name, name), kind, act)
        app.post(f"/participants/{{pseudonym}}/{name}")(endpoint)
    return app


def _endpoint(
    board: Dashboard,
    log: DashboardLog,
    name: str,
    kind: type[msgspec.Struct],
    act: Callable[[Dashboard, str, Any], None],
) -> Callable[..., Awaitable[Response]]:
    def logged(caller: Caller, pseudonym: str, body: Any) -> None:
        with log.command(caller, name, pseudonym):
            act(replace(board, experimenter=caller.name), pseudonym, body)

    async def endpoint(pseudonym: str, request: Request) -> Response:
        await run_in_threadpool(logged, _caller(request), pseudonym, await _body(request, kind))
        return Response(status_code=204)

    return endpoint


def _caller(request: Request) -> Caller:
    return request.state.caller


B = TypeVar("B", bound=msgspec.Struct)


async def _body(request: Request, kind: type[B]) -> B:
    """What was posted; refusals name fields and never repeat values, which may be names."""
    data = await posted_json(request, MAX_BODY_BYTES)
    try:
        return msgspec.json.decode(data, type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise HTTPException(422, str(error)) from None
    except RecursionError:
        raise HTTPException(422, "nested too deeply") from None


def _json(value: Any) -> Response:
    return Response(msgspec.json.encode(value), media_type="application/json")


def _refuse(status: int, **more: str) -> Callable[[Request, Exception], Response]:
    def refuse(_request: Request, error: Exception) -> Response:
        body = msgspec.json.encode({"detail": str(error), **more})
        return Response(body, status, media_type="application/json")

    return refuse
