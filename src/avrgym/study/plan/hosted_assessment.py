"""Texts of the impact assessment for a hosted study: its data, measures, and risks to participants at home.

Likelihood and severity are proposals for a study with the settings of this program; the controller decides.
"""

from collections.abc import Mapping

from avrgym.study.people.invitations import list_invitations
from avrgym.study.storage.store import StudyStore

HOST_SETTINGS_FILE = "host.toml"
"""File of the settings of a hosted study, in the study's folder."""

HOSTED_STUDY_DATA = (
    "Invitation: checksum of its token, label, expiry time, and the time of its use.",
    "Id at a recruitment service, if any: encrypted in the identity file. Ids of study and submission there.",
    "Identification of the headset and its browser, and measurements of the connection.",
    "Addresses of the network are not stored: the server keeps them in memory, to limit the rate of requests.",
)
"""Data of a hosted study, in addition to those of a study in a laboratory."""

HOSTED_STUDY_SAFEGUARDS = (
    "Invitations and participants' own links have 128 random bits and are stored as checksums only.",
    "Tokens are never in a request line, a cookie or a log. Browsers do not send them to other sites.",
    "The public server has no page for experimenters; their server accepts connections of its own computer only.",
    "TLS by a reverse proxy. Requests from pages of other sites are refused, and pages cannot be framed.",
    "Requests are limited by address and by participant; slow and idle connections are closed.",
    "Each study has its own server process, database, tokens and keys: two studies cannot see each other.",
    "Participants withdraw, request a copy of their data and have them deleted on their own page.",
)
"""Security measures of a hosted study, in addition to those of every study."""

HOSTED_STUDY_RISKS: Mapping[str, str] = {
    "Harm at home without an experimenter": "A person stumbles, hits furniture or feels sick. Likelihood: possible. "
    "Severity: limited. Measures: seated posture, a guide to chair and room before each session, headset check, stop "
    "by button or gesture at any time, maximum duration. Residual risk: low for people who can remove the headset.",
    "Another person uses the link": "A household member, or a person who reads the messages, opens the participant's "
    "page. Likelihood: possible. Severity: limited; the page shows no name and no recorded data. Measures: links are "
    "replaced by `avrgym study invitations --new-link`, and codes for headsets are valid once.",
    "Attack from the internet": "A person tries to read or change data, or to stop the service. Likelihood: likely, "
    "because the address is public. Severity: significant. Measures: those of this program above; updates of the "
    "operating system, a firewall that opens the ports of the proxy only, and backups by the institution.",
    "Identification through a recruitment service": "The service knows the person and the time of participation. "
    "Likelihood: certain for the service. Severity: limited. Measures: the service receives a code only, no data; its "
    "id is deleted with the names.",
    "Processing by the provider of the server": "The provider could read disks and memory. Likelihood: remote. "
    "Severity: significant, because recordings can identify people. Measures: a contract (Article 28), a provider "
    "in the European Union, encrypted disks; the key of names is outside the study's folder.",
}
"""Risks of a hosted study by heading: cause, likelihood, severity, measures and residual risk."""


def is_hosted_study(store: StudyStore) -> bool:
    """Returns whether a study has settings of a host, or invitations for participants at home."""
    return (store.folder / HOST_SETTINGS_FILE).is_file() or bool(list_invitations(store))
