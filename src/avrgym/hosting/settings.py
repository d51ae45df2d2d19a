"""Settings of a hosted study: the optional file ``host.toml`` in the study's folder."""

from pathlib import Path
from typing import Annotated
from urllib.parse import urlsplit

import msgspec

from avrgym.study.design.toml_validation import StructByKeyPath, ValidationError, parse_toml, read_text
from avrgym.study.plan.hosted_assessment import HOST_SETTINGS_FILE

SingleLineText = Annotated[str, msgspec.Meta(max_length=500)]
Minutes = Annotated[float, msgspec.Meta(gt=0, le=480)]


class FinalPage(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Last page of a participant: completion code, and address to which the page redirects. Both may be empty."""

    code: SingleLineText = ""
    redirect: SingleLineText = ""


class RecruitmentLinkParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Names of the link parameters with ids of a recruitment service. Default: the names of Prolific."""

    participant: SingleLineText = "PROLIFIC_PID"
    study: SingleLineText = "STUDY_ID"
    session: SingleLineText = "SESSION_ID"


class HostSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of a hosted study.

    ``session_minutes``: maximum duration of a session. ``absence_minutes``: a session ends if the participant is
    disconnected for this time. ``headset_check``: sessions start with a headset check. ``completed``, ``screened_out``
    and ``withdrawn``: last page of a participant that completed the study, was excluded, or withdrew.
    """

    session_minutes: Minutes = 90.0
    absence_minutes: Minutes = 10.0
    headset_check: bool = True
    completed: FinalPage = FinalPage()
    screened_out: FinalPage = FinalPage()
    withdrawn: FinalPage = FinalPage()
    parameters: RecruitmentLinkParameters = RecruitmentLinkParameters()


FINAL_PAGE_NAMES = ("completed", "screened_out", "withdrawn")
_TABLES: StructByKeyPath = {
    **{(name,): FinalPage for name in FINAL_PAGE_NAMES},
    ("parameters",): RecruitmentLinkParameters,
}


def read_host_settings(folder: Path) -> HostSettings:
    """Returns the settings of the study in a folder; the defaults without a file.

    Raises:
        DesignError: for an invalid file.
    """
    path = folder / HOST_SETTINGS_FILE
    if not path.is_file():
        return HostSettings()
    return parse_toml(read_text(path), str(path), HostSettings, _TABLES, _check)


def _check(settings: HostSettings) -> None:
    for name in FINAL_PAGE_NAMES:
        redirect: str = getattr(settings, name).redirect
        if redirect and urlsplit(redirect).scheme != "https":
            raise ValidationError(
                (name, "redirect"), f"{redirect!r} is not allowed; allowed: an https address"
            )
