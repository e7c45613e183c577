"""Decides which requests are served: from pages of this server, and not too many.

A page of another site, open in the operator's browser, can send requests to this server, too. It
cannot hide where it comes from:

- A request across sites has its site in `Origin`, which differs from `Host`.
- A name that an attacker lets point to 127.0.0.1 (DNS rebinding) is in `Host`. Only names of this
  machine, and addresses, are accepted there.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from ipaddress import ip_address
from typing import Final
from urllib.parse import urlsplit

_POLICY: Final = (
    "default-src 'none'",
    "script-src 'self'",
    # plotly sets styles of its elements.
    "style-src 'self' 'unsafe-inline'",
    "img-src 'self' data:",
    "connect-src 'self'",
    "base-uri 'none'",
    "form-action 'none'",
    "frame-ancestors 'none'",
)

HEADERS: Final[Mapping[str, str]] = {
    'Content-Security-Policy': '; '.join(_POLICY),
    'X-Content-Type-Options': 'nosniff',
    'X-Frame-Options': 'DENY',
    'Referrer-Policy': 'no-referrer',
    'Cross-Origin-Opener-Policy': 'same-origin',
    'Cross-Origin-Resource-Policy': 'same-origin',
    'Cache-Control': 'no-cache',
    'Server': 'dyknow',
}
"""The headers of all responses."""


def is_own_host(host: str, names: Collection[str]) -> bool:
    """Return True if a header `Host` names this machine, by an address or one of its names."""
    try:
        name = urlsplit(f'//{host}').hostname or ''
    except ValueError:
        return False
    return name in names or _is_address(name)


def is_same_origin(origin: str | None, host: str) -> bool:
    """Return True if a request was sent by a page of this server, or by no page at all."""
    if origin is None:
        return True
    try:
        parts = urlsplit(origin)
    except ValueError:
        return False
    return parts.scheme in {'http', 'https'} and parts.netloc.lower() == host.lower()


def is_loopback(host: str) -> bool:
    """Return True if only this machine can reach an address or name that a server listens on."""
    return host == 'localhost' or (_is_address(host) and ip_address(host).is_loopback)


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


class RateLimit:
    """A limit of the number of requests: a bucket of tokens that fills at a constant rate.

    Args:
        rate: requests per second in the long run.
        burst: requests at once.
    """

    def __init__(self, rate: float, burst: int) -> None:
        self._rate = rate
        self._burst = float(burst)
        self._tokens = self._burst
        self._latest = 0.0

    def allows(self, now: float) -> bool:
        """Return whether a request at a time in seconds is within the limit, and count it."""
        elapsed = max(now - self._latest, 0.0)
        self._latest = now
        self._tokens = min(self._tokens + elapsed * self._rate, self._burst)
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True
