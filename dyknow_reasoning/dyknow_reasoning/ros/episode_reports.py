"""Reports on the formulas of a group that are asked at every state, on the topic `~/episodes`."""

from __future__ import annotations

from typing import Any, Final

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_common.ros import DyKnowNode
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.ros.result_messages import summary_to_message

PERIOD_NS: Final = SECOND_NS
"""The time after which a report is published again."""

_SHORTEST_NS: Final = 100 * NANOSECONDS['ms']
"""The shortest time between two reports on a formula: changes in between are one report."""


class EpisodeReports:
    """Publishes a report when an episode begins or ends, and each second.

    Args:
        node: the engine.
        group_id: of the group.
        group: its formulas.
        publisher: of FormulaEpisodes.
    """

    def __init__(
        self, node: DyKnowNode, group_id: int, group: FormulaGroup, publisher: Any
    ) -> None:
        self._node = node
        self._group_id = group_id
        self._group = group
        self._publisher = publisher
        self._published: dict[int, int] = {}
        self._changed: set[int] = set()

    def publish_changes(self) -> None:
        """Publish the reports that have changed, unless they were published just now."""
        formulas = self._group.standing.formulas
        if not (formulas or self._published):
            return
        self._changed.update(self._group.standing.changed())
        now = self._wall_time()
        self._published = {each: self._published.get(each, 0) for each in formulas}
        for formula_id, published in self._published.items():
            due = _SHORTEST_NS if formula_id in self._changed else PERIOD_NS
            if now - published >= due:
                self._publish(formula_id)
                self._published[formula_id] = now
                self._changed.discard(formula_id)

    def _publish(self, formula_id: int) -> None:
        name = self._group.formulas[formula_id].name
        message = summary_to_message(self._group.standing.summary(formula_id))
        message.formula_group_id, message.formula_id = self._group_id, formula_id
        message.formula_name = name
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def _wall_time(self) -> int:
        return int(self._node.wall_clock.now().nanoseconds)
