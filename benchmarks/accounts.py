"""What an engine says of its streams on its status topic."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticStatus
from processes import ENGINE

from dyknow_stream_processing.ros.runtime import STATUS

if TYPE_CHECKING:
    from processes import Client

_ACCOUNT = re.compile(r'(?P<samples>\d+) samples, .*dropped: (?P<drops>.*)')


@dataclass(frozen=True, slots=True)
class Account:
    """How many samples came out of a stream, and how many were dropped and counted."""

    samples: int
    dropped: int

    @property
    def total(self) -> int:
        """What went in."""
        return self.samples + self.dropped


class Accounts:
    """The latest accounts of all streams, by name."""

    def __init__(self, client: Client) -> None:
        self.streams: dict[str, Account] = {}
        client.node.create_subscription(DiagnosticStatus, f'{ENGINE}/status', self._take, STATUS)

    @property
    def samples(self) -> int:
        """Of all streams."""
        return sum(each.samples for each in self.streams.values())

    @property
    def dropped(self) -> int:
        """In all streams."""
        return sum(each.dropped for each in self.streams.values())

    def _take(self, status: Any) -> None:
        self.streams = {
            each.key: Account(int(found['samples']), _sum(found['drops']))
            for each in status.values
            if (found := _ACCOUNT.fullmatch(each.value))
        }


def _sum(drops: str) -> int:
    return sum(map(int, re.findall(r'\d+', drops)))
