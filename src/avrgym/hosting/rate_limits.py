"""Limits on the number of requests by address or participant."""

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable

from starlette.datastructures import Headers
from starlette.types import Scope

MAX_STORED_KEYS = 10_000
"""Maximum number of stored keys. Above it, the key with the oldest request is removed."""


class RateLimits:
    """Token bucket for each key (an address or a pseudonym). Thread-safe."""

    def __init__(self, burst: int, per_minute: float, clock: Callable[[], float] = time.monotonic) -> None:
        """``burst``: maximum number of requests without a pause. ``per_minute``: maximum long-term rate."""
        self._burst, self._per_s, self._clock = float(burst), per_minute / 60.0, clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def allows(self, key: str) -> bool:
        """Count a request. Returns whether it is allowed."""
        now_s = self._clock()
        with self._lock:
            left, seen_s = self._buckets.pop(key, (self._burst, now_s))
            left = min(left + (now_s - seen_s) * self._per_s, self._burst)
            allowed = left >= 1.0
            self._buckets[key] = left - allowed, now_s
            if len(self._buckets) > MAX_STORED_KEYS:
                self._buckets.popitem(last=False)
            return allowed


def find_client_address(scope: Scope, proxies: Iterable[str]) -> str:
    """Returns the client's address of a request.

    If the connection comes from a reverse proxy in ``proxies``, the header ``X-Forwarded-For`` is used. The result is
    the last address in this header that is not a proxy. Clients can forge all earlier addresses.
    """
    known = set(proxies)
    address = (scope.get("client") or ("",))[0]
    if address not in known:
        return address
    forwarded = Headers(scope=scope).get("x-forwarded-for", "")
    others = [each.strip() for each in forwarded.split(",") if each.strip() not in {"", *known}]
    return others[-1] if others else address
