"""Results of formulas, and reports on undecided ones, as messages."""

from __future__ import annotations

from typing import Any, Final

from builtin_interfaces.msg import Time
from dyknow_interfaces.msg import FormulaEpisodes, FormulaProgress, ProbabilityInterval
from dyknow_interfaces.msg import FormulaResult as FormulaResultMessage

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_common.ros import (
    DyKnowNode,
    nanoseconds_to_time,
    to_message,
)
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.results import FormulaResult

PERIOD_NS: Final = SECOND_NS
"""The time after which a report is published again."""

_SHORTEST_NS: Final = 100 * NANOSECONDS['ms']
"""The shortest time between two reports on a formula: changes in between are one report."""


def result_to_message(result: FormulaResult, group_id: int, stamp: Time) -> FormulaResultMessage:
    """Return the message of a result of a formula in a group."""
    message = FormulaResultMessage(formula_group_id=group_id, formula_name=result.name)
    message.header.stamp = stamp
    return to_message(result, message)


def progress_to_message(
    group: FormulaGroup, formula_id: int, latest: int | None
) -> FormulaProgress:
    """Return a report on an undecided formula, without the numbers of its group and its states.

    Args:
        group: the group of the formula.
        formula_id: the id of the formula.
        latest: the valid time of its latest state in nanoseconds; None before the first.
    """
    message = FormulaProgress(
        formula_id=formula_id,
        latest_valid_time=nanoseconds_to_time(latest or 0),
        residual_formula=group.residual(formula_id),
        presumably_false=group.presumably_false(formula_id),
    )
    if margin := group.margin(formula_id):
        to_message(margin, message.margin)
    if probability := group.probability(formula_id):
        message.probability = [to_message(probability, ProbabilityInterval())]
    return message


class EpisodeReports:
    """Publishes a report when an episode begins or ends, and each second.

    Args:
        node: the engine.
        group_id: the id of the group.
        group: the formulas of the group.
        publisher: the publisher of FormulaEpisodes.
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
                self.publish(self.report(formula_id))
                self._published[formula_id] = now
                self._changed.discard(formula_id)

    def report(self, formula_id: int) -> FormulaEpisodes | None:
        """Return the present report on a formula; None if it is not asked at every state."""
        if formula_id not in self._group.standing.formulas:
            return None
        message = to_message(self._group.standing.summary(formula_id), FormulaEpisodes())
        message.formula_group_id, message.formula_id = self._group_id, formula_id
        message.formula_name = self._group.formulas[formula_id].name
        return message

    def publish(self, report: FormulaEpisodes | None) -> None:
        """Publish a report, if there is one."""
        if report is not None:
            report.header.stamp = self._node.get_clock().now().to_msg()
            self._publisher.publish(report)

    def _wall_time(self) -> int:
        return int(self._node.wall_clock.now().nanoseconds)
