"""Links of participants, and short codes for headsets.

A link is a random token in the address of the participant's page. Each session has its own link, which expires with the
session. Only its checksum is stored. Headsets have no keyboard, so their page also accepts a code of six digits. A code
can be used once, within some minutes. The number of wrong codes per minute is limited.
"""

import hashlib
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from avrgym.vr.protocol.messages import Language

LINK_TOKEN_BYTES = 16
NUM_CODE_DIGITS = 6
CODE_VALIDITY_S = 300.0
MAX_WRONG_CODES, WRONG_CODE_WINDOW_S = 10, 60.0
"""Maximum number of wrong codes in this time in seconds. With this limit, guessing a code takes three weeks on
average."""


class CodeError(ValueError):
    """Raised if a code is wrong, used or expired."""


class TooManyWrongCodesError(CodeError):
    """Raised if too many wrong codes were entered recently."""


class WrongCodeLimit:
    """Limits the number of wrong codes in a time window. Not thread-safe."""

    def __init__(self, max_codes: int, window_s: float) -> None:
        self._times_s: deque[float] = deque(maxlen=max_codes)
        self._window_s = window_s

    def is_reached(self, now_s: float) -> bool:
        """Returns whether the maximum number of wrong codes was entered within the window."""
        return len(self._times_s) == self._times_s.maxlen and now_s - self._times_s[0] < self._window_s

    def count_wrong_code(self, now_s: float) -> None:
        """Count a wrong code that was entered at the time ``now_s``."""
        self._times_s.append(now_s)


def generate_random_digits(length: int) -> str:
    """Returns ``length`` random decimal digits from a cryptographic generator."""
    return f"{secrets.randbelow(10**length):0{length}}"


def generate_link_token() -> str:
    """Returns a new link: a random token of 128 bits."""
    return secrets.token_urlsafe(LINK_TOKEN_BYTES)


def compute_token_sha256(token: str) -> str:
    """Returns the SHA-256 checksum of a link or another token. Only checksums are stored."""
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).hexdigest()


@dataclass(frozen=True)
class _CurrentLink:
    """The link of the current session, and the language of its participant."""

    link: str
    sha256: str
    language: Language


@dataclass
class _Code:
    digits: str
    created_s: float = field(default_factory=lambda: time.monotonic())

    def is_younger_than(self, seconds: float) -> bool:
        return time.monotonic() - self.created_s < seconds


class SessionLinks:
    """The link of the current session (if there is a session), and expired links. Thread-safe.

    ``on_expiry`` is called when a link expires, in the thread that calls ``expire_link``.
    """

    def __init__(self, ended: Mapping[str, Language] | None = None) -> None:
        """Start without a current link.

        ``ended``: participants' languages, by the checksum of their expired link.
        """
        self.on_expiry: Callable[[], None] = lambda: None
        self._ended = dict(ended or {})
        self._open: _CurrentLink | None = None
        self._codes: list[_Code] = []
        self._wrong_codes = WrongCodeLimit(MAX_WRONG_CODES, WRONG_CODE_WINDOW_S)
        self._lock = threading.Lock()

    @property
    def current_link_token(self) -> str | None:
        """The link of the current session; ``None`` between sessions."""
        return None if self._open is None else self._open.link

    def set_link_token(self, link: str, language: Language) -> None:
        """Set the link of a new session, or a new link of this session. The previous link expires."""
        self.expire_link()
        self._open = _CurrentLink(link, compute_token_sha256(link), language)

    def expire_link(self) -> None:
        """Make the link of the current session and its codes expire."""
        with self._lock:
            ended, self._open, self._codes = self._open, None, []
        if ended is not None:
            self._ended[ended.sha256] = ended.language
            self.on_expiry()

    def is_current_link_token(self, token: str) -> bool:
        """Returns whether a token is the link of the current session."""
        present = self._open
        return present is not None and secrets.compare_digest(compute_token_sha256(token), present.sha256)

    def find_expired_link_language(self, token: str) -> Language | None:
        """Returns the language of the participant of an expired link; ``None`` for an unknown token."""
        return self._ended.get(compute_token_sha256(token))

    def get_or_create_code(self) -> str | None:
        """Returns a code that is valid for at least another ``CODE_VALIDITY_S`` / 2; ``None`` between sessions."""
        with self._lock:
            if self._open is None:
                return None
            self._codes = [each for each in self._codes if each.is_younger_than(CODE_VALIDITY_S)]
            if not self._codes or not self._codes[-1].is_younger_than(CODE_VALIDITY_S / 2):
                self._codes.append(_Code(generate_random_digits(NUM_CODE_DIGITS)))
            return self._codes[-1].digits

    def exchange_code(self, digits: str) -> str:
        """Returns the link for a code. The code cannot be used again.

        Raises:
            TooManyWrongCodesError: if too many wrong codes were entered recently.
            CodeError: for a code that is wrong, used or expired.
        """
        with self._lock:
            now_s = time.monotonic()
            if self._wrong_codes.is_reached(now_s):
                raise TooManyWrongCodesError(
                    f"{MAX_WRONG_CODES} wrong codes in {WRONG_CODE_WINDOW_S:g} s; wait, or open the link"
                )
            for code in self._codes:
                right = secrets.compare_digest(code.digits.encode(), digits.encode("utf-8", "surrogatepass"))
                if right and code.is_younger_than(CODE_VALIDITY_S) and self._open is not None:
                    self._codes.remove(code)
                    return self._open.link
            self._wrong_codes.count_wrong_code(now_s)
            raise CodeError("this code is wrong, used or expired; the dashboard shows the current one")
