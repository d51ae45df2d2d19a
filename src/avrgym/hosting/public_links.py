"""Public address of a hosted study, and links with tokens. Browsers do not send the fragment with the token."""

from urllib.parse import urlsplit

from avrgym.vr.server.network_addresses import LOOPBACK_HOSTS


def parse_public_address(address: str) -> str:
    """Returns the origin (scheme, host and port) of a public address, without a slash at the end.

    Raises:
        ValueError: for an address with a path or without a host, and for HTTP to another computer.
    """
    try:
        parts = urlsplit(address)
        host, _ = parts.hostname, parts.port
    except ValueError:
        parts, host = urlsplit(""), None
    is_origin = parts.path in ("", "/") and not parts.query and not parts.fragment and not parts.username
    if parts.scheme not in ("https", "http") or not host or not is_origin:
        raise ValueError(f"{address!r} is not a public address; allowed: https://HOST or https://HOST:PORT")
    if parts.scheme == "http" and host not in LOOPBACK_HOSTS:
        raise ValueError(
            f"{address!r} has no TLS; browsers allow VR only on https pages; allowed: https://HOST"
        )
    return f"{parts.scheme}://{parts.netloc.lower()}"


def make_invitation_link(origin: str, token: str) -> str:
    """Returns the address that a person opens to enrol. The fragment contains the invitation's token."""
    return f"{origin}/#invitation={token}"


def make_participant_link(origin: str, token: str) -> str:
    """Returns the address of a participant's page. The fragment contains the participant's token."""
    return f"{origin}/#participant={token}"
