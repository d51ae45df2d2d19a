"""Drafts of data protection documents (impact assessment and record of processing), filled in from the design.

Articles refer to Regulation (EU) 2016/679 (GDPR). Facts that are not in the design are marked as gaps. The
controller completes the drafts.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path

from avrgym.commands.respondents import CAREGIVER_RESPONDENT
from avrgym.study.design.design import Design
from avrgym.study.design.design_description import describe_procedure
from avrgym.study.plan.hosted_assessment import (
    HOSTED_STUDY_DATA,
    HOSTED_STUDY_RISKS,
    HOSTED_STUDY_SAFEGUARDS,
    is_hosted_study,
)
from avrgym.study.plan.preregistration import format_bullet_list, format_markdown, write_draft
from avrgym.study.storage.store import StudyStore

DATA_PROTECTION_FOLDER = "data-protection"
PLACEHOLDER_FORMAT = "**[TO FILL IN: {}]**"
DRAFT_NOTICE = (
    "A draft from the study's design, by AVR Gym. Fill in the gaps in brackets. The controller completes it, consults "
    "the data protection officer (Article 35(2)) and is responsible for it."
)
SECURITY_MEASURES = (
    "Pseudonyms: names and contacts are only in the folder `private`, separate from recordings and answers.",
    "Only the account that owns the study can read its files and folders.",
    "The server requires a token for each role; on a network it uses TLS only.",
    "A hash chain and checksums reveal changes of database and recordings by other programs.",
    "An audit log contains views, exports and deletions with the person.",
    "Deletion of one participant on request, with the database's backups, and deletion by schedule.",
    "Exports contain no names, and free text only on request.",
)
"""Security measures of AVR Gym."""


def write_data_protection_drafts(store: StudyStore) -> list[Path]:
    """Write both drafts into the study's folder. Returns their paths. Edited drafts are never overwritten.

    Raises:
        StudyError: if a draft exists with another text.
        OSError: if a draft cannot be written.
    """
    design, folder = store.design, store.folder / DATA_PROTECTION_FOLDER
    folder.mkdir(mode=0o700, exist_ok=True)
    title, hosted = design.title, is_hosted_study(store)
    drafts = {
        "impact-assessment.md": format_markdown(
            f"{title}: data protection impact assessment", DRAFT_NOTICE, _assessment(design, hosted=hosted)
        ),
        "record-of-processing.md": format_markdown(
            f"{title}: record of processing activities", DRAFT_NOTICE, _record(design, hosted=hosted)
        ),
    }
    return [write_draft(folder / name, text) for name, text in drafts.items()]


def _assessment(design: Design, *, hosted: bool) -> Mapping[str, Mapping[str, str]]:
    """Returns the texts of the impact assessment, by section and heading. Article 35(7) requires most of them."""
    return {
        "Whether an assessment is needed (Article 35(1) and (3))": {
            "Why": "Movements of head and hands may identify a person even without a name. "
            + _health(design)
            + " "
            + _fill_in(
                "whether the processing is likely to result in a high risk, and whether your authority lists it"
            ),
        },
        "Description of the processing (Article 35(7)(a))": {
            "What happens": f"{describe_procedure(design)} {design.participants} participants are planned.",
            "Purposes": _fill_in("the research question, and the interest pursued"),
            "Legal basis": _fill_in(
                "for example consent, Article 6(1)(a); for data on health Article 9(2)(a) or (j)"
            ),
            "Data": format_bullet_list(_data(design, hosted=hosted)),
            "Recipients": _recipients(design),
            "Storage": _storage(design),
            "Retention": _retention(design),
        },
        "Necessity and proportionality (Article 35(7)(b))": {
            "Data minimisation (Article 5(1)(c))": "Participants answer only the questions of the design. "
            + _fill_in("why the study needs each kind of data"),
            "Information and consent (Articles 7 and 13)": f"Consent text, version {design.consent.version}: "
            f"{' '.join(design.consent.text.split())} {_fill_in('where the full information is')}",
            "Rights (Articles 15 to 22)": "Access and portability: `avrgym study participant-data`. Erasure: "
            "`avrgym study delete-participant`. Withdrawal at any time: on the dashboard, or `avrgym study withdraw`. "
            + _fill_in("the contact for participants, and limits of these rights in research, Article 89"),
        },
        "Risks to participants (Article 35(7)(c))": {
            "Identification by movements": _risk(),
            "Disclosure of names": _risk(),
            "Disclosure of data on health": _risk(),
            "Loss of data": _risk(),
            **(HOSTED_STUDY_RISKS if hosted else {}),
            "Other risks": _fill_in("what else may harm participants"),
        },
        "Measures (Article 35(7)(d))": {
            "By this program": format_bullet_list(_measures(hosted=hosted)),
            "By the institution": _fill_in(
                "encryption of disks, access to rooms, backups, training of staff"
            ),
        },
        "Advice and decision": {
            "Data protection officer (Article 35(2))": _fill_in("name, advice and date"),
            "Views of participants (Article 35(9))": _fill_in(
                "the consulted participants or representatives, or why there are none"
            ),
            "Residual risk, and prior consultation (Article 36)": _fill_in(
                "the decision and the responsible person"
            ),
        },
    }


def _record(design: Design, *, hosted: bool) -> Mapping[str, Mapping[str, str]]:
    """Returns the texts of the record of processing that Article 30(1) requires, by section and heading."""
    return {
        "Record (Article 30(1))": {
            "(a) Controller, joint controllers, data protection officer": _fill_in("names and contacts"),
            "(b) Purposes": _fill_in("the research question") + f" The study: {design.title}.",
            "(c) Categories of people": f"{design.participants} participants of a study; experimenters, "
            "in its log; representatives and "
            "caregivers, if any. "
            + _fill_in("how they are recruited, and whether any of them are vulnerable"),
            "(c) Categories of data": format_bullet_list(_data(design, hosted=hosted)),
            "(d) Recipients": _recipients(design),
            "(e) Transfers to third countries": _fill_in(
                "none, or the countries and the safeguards of Article 46"
            ),
            "(f) Time limits for erasure": _retention(design),
            "(g) Security measures (Article 32(1))": (
                f"{format_bullet_list(_measures(hosted=hosted))}\n\n{_fill_in('measures of the institution')}"
            ),
        }
    }


def _measures(*, hosted: bool) -> tuple[str, ...]:
    return (*SECURITY_MEASURES, *(HOSTED_STUDY_SAFEGUARDS if hosted else ()))


def _data(design: Design, *, hosted: bool) -> Iterable[str]:
    """Yields a sentence for each kind of data that this study collects."""
    yield "Identity: name and contact, where they were given."
    yield "Body model (woman or man), age where it was given, language, torso height."
    yield "Answers to inclusion questions: " + " ".join(each.text for each in design.inclusion)
    if design.ask_functioning:
        yield "Data on health (Article 9(1)): functioning, assistive devices, diagnosis, where not declined."
    yield (
        "Data on health (Article 9(1)), because they reveal impairments: input profile (column input_method, arms that "
        "do not move, stops) and preferences for the robot."
    )
    if any(CAREGIVER_RESPONDENT in each.moments for each in design.questionnaires):
        yield "Answers of caregivers to their own questions, under the pseudonym of the participant."
    yield "Consent of a representative and answers by a proxy, where a participant cannot give them alone."
    yield "Movements of head and hands during each trial, at the rate of tracking."
    names = ", ".join(each.name for each in design.questionnaires)
    yield f"Answers with response times: {names or 'no questionnaires'}."
    if design.streams.receive:
        yield f"Signals of other devices: {', '.join(design.streams.receive)}."
    yield "Times of sessions, stops and interruptions; notes of experimenters; adverse events."
    yield from HOSTED_STUDY_DATA if hosted else ()
    yield "No camera picture and no sound is recorded."


def _health(design: Design) -> str:
    return (
        "Inclusion questions, input profiles (input_method), adverse events"
        + (", signals of other devices" if design.streams.receive else "")
        + " and movements of people with impairments may be data on health (Article 9(1))."
    )


def _storage(design: Design) -> str:
    place = "a PostgreSQL database" if design.database.url else "the file `study.db` in the study's folder"
    return f"Rows in {place}, recordings as files in the study's folder. " + _fill_in(
        "computers, rooms and backups, and processors with their contracts (Article 28)"
    )


def _recipients(design: Design) -> str:
    about = design.reporting.data_availability
    return f"Data availability: {about or _fill_in('recipients, data and format')}"


def _retention(design: Design) -> str:
    retention = design.retention
    periods = {
        "Names and contacts": (retention.identities_months, "months"),
        "Recordings": (retention.recordings_years, "years"),
        "All data of participants": (retention.data_years, "years"),
    }
    end = f"the study's end ({retention.ended_on})" if retention.ended_on else "the study's end"
    return format_bullet_list(
        f"{what}: "
        + (
            _fill_in("period, also under [retention] in study.toml")
            if period is None
            else f"{period} {unit} after {end}."
        )
        for what, (period, unit) in periods.items()
    )


def _risk() -> str:
    return _fill_in("likelihood, severity, and which measure reduces it")


def _fill_in(what: str) -> str:
    return PLACEHOLDER_FORMAT.format(what)
