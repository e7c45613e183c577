"""Counts of samples that an engine reports on its topic `streams`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from dyknow_interfaces.msg import StreamStatusArray
from processes import ENGINE, Client

from dyknow_common.ros import LATCHED


@dataclass(frozen=True, slots=True)
class SampleCounts:
    """Samples that a stream emitted, and those that it dropped and counted."""

    samples: int
    dropped: int

    @property
    def total(self) -> int:
        """The samples that the stream received."""
        return self.samples + self.dropped


class StreamCounts:
    """The latest counts of all streams, by name."""

    def __init__(self, client: Client) -> None:
        self.streams: dict[str, SampleCounts] = {}
        client.node.create_subscription(
            StreamStatusArray, f'{ENGINE}/streams', self._on_report, LATCHED
        )

    @property
    def samples(self) -> int:
        """The samples that all streams emitted."""
        return sum(each.samples for each in self.streams.values())

    @property
    def dropped(self) -> int:
        """The samples that all streams dropped."""
        return sum(each.dropped for each in self.streams.values())

    def _on_report(self, report: Any) -> None:
        self.streams = {
            each.name: SampleCounts(each.samples, sum(drop.count for drop in each.drops))
            for each in report.streams
        }
