"""What an engine says of its streams on its topic `streams`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dyknow_interfaces.msg import StreamStatusArray
from processes import ENGINE, Client

from dyknow_common.ros import LATCHED


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
        client.node.create_subscription(StreamStatusArray, f'{ENGINE}/streams', self._take, LATCHED)

    @property
    def samples(self) -> int:
        """Of all streams."""
        return sum(each.samples for each in self.streams.values())

    @property
    def dropped(self) -> int:
        """In all streams."""
        return sum(each.dropped for each in self.streams.values())

    def _take(self, report: Any) -> None:
        self.streams = {
            each.name: Account(each.samples, sum(drop.count for drop in each.drops))
            for each in report.streams
        }
