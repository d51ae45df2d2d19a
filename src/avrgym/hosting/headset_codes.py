"""Short codes that open a participant's page on a headset. A headset has no keyboard for a long link.

A code has eight digits, is valid for ``CODE_VALIDITY_S``, and can be used once. Wrong codes are limited to 60 per
minute over all addresses. With 100 valid codes, a random guess then succeeds after 8 days on average. The limit for a
single address is lower.
"""

import threading
import time
from collections.abc import Callable

from avrgym.vr.server.session_links import (
    CodeError,
    TooManyWrongCodesError,
    WrongCodeLimit,
    generate_random_digits,
)

NUM_CODE_DIGITS = 8
CODE_VALIDITY_S = 300.0
MAX_WRONG_CODES_PER_MINUTE = 60


class HeadsetCodes:
    """The valid codes, and the participant's token of each code. Thread-safe."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._codes: dict[str, tuple[str, float]] = {}
        self._wrong_codes = WrongCodeLimit(MAX_WRONG_CODES_PER_MINUTE, 60.0)
        self._lock = threading.Lock()

    def create_code(self, token: str) -> str:
        """Returns a new code for a token. Earlier codes of this token become invalid."""
        with self._lock:
            now_s = self._clock()
            self._codes = {
                code: (other, until_s)
                for code, (other, until_s) in self._codes.items()
                if until_s > now_s and other != token
            }
            code = generate_random_digits(NUM_CODE_DIGITS)
            while code in self._codes:
                code = generate_random_digits(NUM_CODE_DIGITS)
            self._codes[code] = token, now_s + CODE_VALIDITY_S
            return code

    def exchange_code(self, digits: str) -> str:
        """Returns the token of a code. The code cannot be used again.

        Raises:
            TooManyWrongCodesError: if too many wrong codes were entered recently.
            CodeError: for a code that is wrong, used or expired.
        """
        with self._lock:
            now_s = self._clock()
            if self._wrong_codes.is_reached(now_s):
                raise TooManyWrongCodesError("too many wrong codes; wait a minute, or open your link")
            token, until_s = self._codes.pop(digits, ("", 0.0))
            if token and until_s > now_s:
                return token
            self._wrong_codes.count_wrong_code(now_s)
        raise CodeError("this code is wrong, used or expired; your page shows the current one")
