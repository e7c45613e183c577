"""The stream reasoning engine: evaluates formula groups over state streams (VI-A.6)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import count
from time import monotonic, perf_counter
from typing import Any, Final

from dyknow_interfaces.msg import FormulaEpisodes, FormulaProgress, UnknownFeature
from dyknow_interfaces.srv import (
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupEvaluate,
    FormulaGroupExtractSymbols,
    FormulaGroupRemoveFormula,
)

from dyknow_common import SECOND_NS, ExitCode, check_name, listed, shortened
from dyknow_common.ros import (
    LATCHED_HISTORY,
    LONG_TIMEOUT_S,
    REPORTS,
    Background,
    DyKnowNode,
    ParameterLimits,
    run,
    time_to_nanoseconds,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.notes import notes_on
from dyknow_reasoning.progression.sizes import FormulaLimits
from dyknow_reasoning.progression.unknown_features import UnknownFeatures
from dyknow_reasoning.ros.group_evaluation import HEAVY_TEXT, GroupEvaluation

SUPERVISION_PERIOD_S = 0.2
_DELAY_S = 1.0
"""The time without supervision after which requests may wait that were sent meanwhile."""

_REPORTING_S = 0.02
"""The time of reports after which the node does other work."""

_IDLE_S = 1.0
"""The time without a request after which a group that nobody evaluates may be destroyed."""


class StreamReasoningEngine(DyKnowNode):
    """The node that has the formula groups and evaluates them."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_engine')
        self._limits = ParameterLimits(self, LIMITS, ReasoningError)
        period = self.parameter(
            'progress_period',
            1.0,
            'Seconds between two reports on ~/progress, if the topic has subscribers.',
            (0.05, 60.0),
        )
        self._violation_patience = self.changing_parameter(
            'violation_patience',
            5.0,
            'Seconds that a group waits for other states after a constraint violation.',
            (0.0, 3600.0),
        )
        self._orphan_limit = self.changing_parameter(
            'orphan_limit',
            2 * LONG_TIMEOUT_S,  # A coordinator may wait for another node meanwhile.
            'Seconds without a request and without a subscriber to the results after which a group '
            'is destroyed; 0: never.',
            (0.0, 86_400.0),
        )
        self._groups: dict[int, GroupEvaluation] = {}
        self._background = Background(self)
        self._is_reporting = False
        self._supervised_at = monotonic()
        self._ids = count(_first_id(self.started_at))
        self._progress = self.create_publisher(FormulaProgress, '~/progress', REPORTS)
        self._episodes = self.create_publisher(FormulaEpisodes, '~/episodes', LATCHED_HISTORY)
        self.create_timer(period, self._report_progress, clock=self.wall_clock)
        self.create_timer(SUPERVISION_PERIOD_S, self._supervise_groups, clock=self.wall_clock)
        self.serve(FormulaGroupCreate, self._create)
        self.serve(FormulaGroupAddFormula, self._add_formula)
        self.serve(FormulaGroupRemoveFormula, self._remove_formula)
        self.serve(FormulaGroupExtractSymbols, self._extract_symbols)
        self.serve(FormulaGroupEvaluate, self._evaluate)
        self.serve(FormulaGroupDestroy, self._destroy)

    def _create(self, request: Any, response: Any) -> None:
        check_name(request.formula_group_name, ReasoningError, 'formula_group_name: the name')
        self._make_room()
        group_id = next(self._ids)
        self._groups[group_id] = GroupEvaluation(
            self,
            group_id,
            request.formula_group_name,
            FormulaGroup(limits_of_group(self._limits)),
            self._background,
            self._progress,
            self._episodes,
        )
        response.formula_group_id = group_id

    def _make_room(self) -> None:
        """Destroy the group that has waited for its evaluation for longest if there are too many.

        Raises:
            ReasoningError: if there are too many other groups.
        """
        idle = {number: each for number, each in self._groups.items() if not each.has_begun}
        if len(idle) >= self._limits['idle_group_limit']:
            oldest = max(idle, key=lambda number: idle[number].idle_s)
            if idle[oldest].idle_s < _IDLE_S:
                self._limits.check(
                    'idle_group_limit', len(idle) + 1, 'groups that nobody evaluates'
                )
            self._abandon(oldest, 'nobody evaluates it, and there are too many such groups')
        self._limits.check('group_limit', len(self._groups) + 1, 'formula groups')

    async def _add_formula(self, request: Any, response: Any) -> None:
        evaluation = self._find(request.formula_group_id)
        check_name(request.formula_name, ReasoningError, 'formula_name: the name')
        formulas = sum(len(each.group.formulas) for each in self._groups.values())
        self._limits.check('formula_limit', formulas + 1, 'formulas')
        self._check_parts(1)
        response.formula_id = await evaluation.add_formula(
            request.formula_name,
            request.formula,
            margin=request.margin,
            every_state=request.every_state,
            since=time_to_nanoseconds(request.since) or None,
        )
        response.canonical_formula = str(evaluation.group.formulas[response.formula_id])
        self.spawn(self._log_notes, request.formula)

    async def _log_notes(self, formula: str) -> None:
        is_long = len(formula) > HEAVY_TEXT
        for note in await self._background.run(partial(notes_on, formula), is_long=is_long):
            self.get_logger().warning(f"{note}; it is in '{shortened(formula)}'")

    async def _remove_formula(self, request: Any, _response: Any) -> None:
        until = time_to_nanoseconds(request.until)
        await self._find(request.formula_group_id).remove_formula(request.formula_id, until)

    async def _extract_symbols(self, request: Any, response: Any) -> None:
        response.symbols = await self._find(request.formula_group_id).symbols()

    async def _evaluate(self, request: Any, _response: Any) -> None:
        evaluation = self._find(request.formula_group_id)
        domains = {domain.sort: domain.objects for domain in request.domains}
        arguments = domains, request.state_stream, request.result_topic
        if evaluation.has_begun and not request.state_stream:
            await evaluation.set_standby(request.standby)
        elif request.standby:
            raise ReasoningError(
                'standby: the group must be evaluated before it can have one; then name it in a '
                'request without state_stream'
            )
        elif evaluation.has_begun:
            await evaluation.change_stream(
                *arguments,
                gap=request.gap,
                doubtful_from=time_to_nanoseconds(request.doubtful_from),
            )
        else:
            self._check_parts(evaluation.group.parts_for(domains))
            await evaluation.begin(*arguments, _unknown_features(request.unknown))

    def _check_parts(self, more: int) -> None:
        parts = sum(each.parts for each in self._groups.values()) + more
        self._limits.check('total_part_limit', parts, 'parts of formulas in all groups')

    def _destroy(self, request: Any, _response: Any) -> None:
        self._find(request.formula_group_id).destroy()
        del self._groups[request.formula_group_id]

    def _find(self, group_id: int) -> GroupEvaluation:
        if group_id not in self._groups:
            known = listed(self._groups) or 'none'
            raise ReasoningError(
                f'there is no formula group {group_id} (there are: {known})', ExitCode.NOT_FOUND
            )
        found = self._groups[group_id]
        found.note_request()
        return found

    def _supervise_groups(self) -> None:
        was_delayed = monotonic() - self._supervised_at > _DELAY_S
        self._supervised_at = monotonic()
        orphan_limit = self._orphan_limit()
        for group_id, evaluation in list(self._groups.items()):
            if was_delayed:
                evaluation.note_request()
            else:
                evaluation.change_if_due()
            evaluation.fail_after_pause(self._violation_patience())
            evaluation.report_episodes()
            if orphan_limit and evaluation.is_orphan(orphan_limit):
                reason = (
                    f'it had no request and no subscriber to its results for {orphan_limit:g} s'
                )
                self._abandon(group_id, reason)

    def _abandon(self, group_id: int, reason: str) -> None:
        evaluation = self._groups.pop(group_id)
        evaluation.destroy()
        name = shortened(evaluation.name)
        self.get_logger().warning(f"the formula group {group_id}, '{name}', is destroyed: {reason}")

    def _report_progress(self) -> None:
        if self._progress.get_subscription_count() > 0 and not self._is_reporting:
            self._is_reporting = True
            self.spawn(self._report_all)

    async def _report_all(self) -> None:
        begun = perf_counter()
        try:
            for evaluation in list(self._groups.values()):
                for report in await evaluation.progress_reports():
                    self._progress.publish(report)
                if perf_counter() - begun > _REPORTING_S:
                    await self.deadlines.after(0.0)
                    begun = perf_counter()
        finally:
            self._is_reporting = False


def _first_id(started_at: int) -> int:
    """Return a first group id that differs from the ids of an earlier engine of the same name.

    A request for a group of that engine must fail, not reach another group.
    """
    seconds = started_at // SECOND_NS
    return seconds % 1_000_000 * 1_000 + 1


def _unknown_features(messages: Sequence[UnknownFeature]) -> UnknownFeatures:
    """Return the features that may be unknown; raise ReasoningError for invalid bounds."""
    for each in messages:
        if not each.lower <= each.upper:
            raise ReasoningError(
                f"unknown: the bounds of '{each.name}' are {each.lower:g} and {each.upper:g}; give "
                'the least value first'
            )
    return UnknownFeatures({each.name: (each.lower, each.upper) for each in messages})


_OF_GROUP: Final = {
    'object_limit': (10_000, 'Sorts and objects for which a formula group is evaluated.'),
    'instance_limit': (10_000, 'Instances of a formula: choices of objects for its variables.'),
    'instance_part_limit': (20_000, 'Parts of a formula for one choice of objects.'),
    'part_limit': (200_000, 'Parts of all formulas of a group for all choices of objects.'),
    'node_limit': (
        100_000,
        'Maximum number of nodes that a formula may grow to by progression before it fails.',
    ),
    'possibility_limit': (
        1000,
        'Cases of unknown values at a state that make a difference to a formula.',
    ),
}
LIMITS: Final = _OF_GROUP | {
    'group_limit': (1000, 'Formula groups.'),
    'idle_group_limit': (
        500,
        'Formula groups that nobody evaluates; one more replaces the oldest of them.',
    ),
    'formula_limit': (5000, 'Formulas in all groups.'),
    'total_part_limit': (1_000_000, 'Parts of the formulas of all groups.'),
}


def limits_of_group(limits: ParameterLimits) -> FormulaLimits:
    """Return the limits of a new group from the limits of the engine."""
    return FormulaLimits(**{name: limits[name] for name in _OF_GROUP})


def main() -> int:
    """Run the executable stream_reasoning_engine."""
    return run(StreamReasoningEngine)
