"""Private ROS domains: each is used by one test process of this machine at a time.

A domain's number fixes the UDP ports of its participants: two tests in one domain would receive
each other's messages. A process reserves a domain by the port of its last possible participant,
which it holds until it ends. Processes that reserve nothing are found by the ports of the first
participants.
"""

from __future__ import annotations

import socket
from collections import OrderedDict

USABLE_DOMAINS = range(1, 102)
"""All but the default, 0; higher ones have ports that Linux gives to outgoing connections."""

MAX_PARTICIPANTS = 20
"""Participants of a domain whose ports are checked."""

MAX_RESERVED = 8
"""Domains that one process cycles through: many processes test at the same time."""

_FIRST_PORT = 7410
_PORTS_OF_A_DOMAIN = 250
_LAST_PARTICIPANT = 119

_reserved: OrderedDict[int, socket.socket] = OrderedDict()
_rows: list[object] = []


def reserve_domain() -> int:
    """Return a domain in which no participant runs, reserved until this process ends.

    A domain that this process has used before is returned again only after seven others.
    """
    if len(_reserved) >= MAX_RESERVED:
        for domain in _reserved:
            if _is_unused(domain):
                _reserved.move_to_end(domain)
                return domain
    for domain in USABLE_DOMAINS:
        if domain in _reserved:
            continue
        reservation = _bound(_port(domain, _LAST_PARTICIPANT))
        if reservation is not None:
            if _is_unused(domain):
                _reserved[domain] = reservation
                return domain
            reservation.close()
    raise AssertionError('no ROS domain is free')


def reserve_domains(count: int) -> int:
    """Return the first of several domains in a row that nobody uses, reserved as one is."""
    for first in USABLE_DOMAINS[: -count + 1]:
        row = range(first, first + count)
        found = {domain: _bound(_port(domain, _LAST_PARTICIPANT)) for domain in row}
        if None not in found.values() and all(map(_is_unused, row)):
            _rows.append(found)
            return first
        for each in found.values():
            if each is not None:
                each.close()
    raise AssertionError(f'no {count} ROS domains in a row are free')


def _is_unused(domain: int) -> bool:
    for participant in range(MAX_PARTICIPANTS):
        probe = _bound(_port(domain, participant))
        if probe is None:
            return False
        probe.close()
    return True


def _port(domain: int, participant: int) -> int:
    # As the DDS standard has it.
    return _FIRST_PORT + _PORTS_OF_A_DOMAIN * domain + 2 * participant


def _bound(port: int) -> socket.socket | None:
    """Return a socket at a port, or None if another socket has it."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        bound.bind(('', port))
    except OSError:
        bound.close()
        return None
    return bound
