"""Streams that fall silent, and topics that nobody publishes any more."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from dyknow_common import SECOND_NS
from dyknow_coordinator.grounding.known_streams import suspects
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.evaluation_group import EvaluationGroup, EvaluationGroups

PERIOD: Final = 1.0
"""Seconds between two looks."""


class SilenceMonitor:
    """Has streams replaced of which nothing comes, where others carry the same.

    A stream without constraints breaks none by silence: where nothing can replace it, it is waited
    for, and operators are warned.

    Args:
        limit: seconds of silence.
    """

    def __init__(
        self, facilities: CoordinatorContext, groups: EvaluationGroups, limit: float
    ) -> None:
        self._facilities = facilities
        self._groups = groups
        self._limit = limit
        self._seen: dict[str, int] = {}
        facilities.node.create_timer(PERIOD, self._look, clock=facilities.node.wall_clock)

    def _look(self) -> None:
        groups, now = self._groups.running(), self._facilities.node.now()
        names = [group.states.stream for group in groups]
        self._seen = {name: self._seen.get(name, now) for name in names}
        for group in groups:
            known = self._facilities.streams.known
            for topic in self._silent_topics(group):
                silent = suspects(group.states.chosen, topic, known)
                group.states.replace_silent(
                    silent, f"nothing has come of topic '{topic}' for {self._limit:g} s"
                )

    def _silent_topics(self, group: EvaluationGroup) -> Iterator[str]:
        """The topics of which nothing has come for a while, or since the stream was made."""
        stream = self._facilities.streams.known.get(group.states.stream)
        if stream is not None:
            seen = self._seen[stream.name]
            oldest = self._facilities.node.now() - round(self._limit * SECOND_NS)
            yield from (
                topic for topic, latest in stream.received.items() if max(latest, seen) < oldest
            )
