"""The stream reasoning engine: evaluates groups of formulas over streams of states (VI-A.6)."""

from __future__ import annotations

from itertools import count
from typing import TYPE_CHECKING, Any, cast

from dyknow_interfaces.msg import FormulaProgress, Sample, Symbol
from dyknow_interfaces.msg import FormulaResult as FormulaResultMessage
from dyknow_interfaces.srv import (
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupEvaluate,
    FormulaGroupExtractSymbols,
)
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dyknow_reasoning import FormulaGroup, FormulaResult, ReasoningError
from dyknow_stream_processing import NANOSECONDS, DyKnowError, ExitCode
from dyknow_stream_processing.ros import (
    LATCHED_HISTORY,
    NO_PUBLISHER_EVENTS,
    NO_SUBSCRIPTION_EVENTS,
    STREAM,
    DyKnowNode,
    fill_exit_status,
    nanoseconds_to_time,
    run,
    sample_fields,
    time_to_nanoseconds,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


class StreamReasoningEngine(DyKnowNode):
    """Serves the formula groups; evaluates them as their states come."""

    def __init__(self) -> None:
        super().__init__('stream_reasoning_engine')
        self._node_limit = self.parameter(
            'node_limit',
            100_000,
            'Most nodes that a formula may grow to by progression before it is given up.',
            (100, 100_000_000),
        )
        period = self.parameter(
            'progress_period',
            1.0,
            'Seconds between two reports on ~/progress, where somebody listens.',
            (0.05, 60.0),
        )
        self._groups: dict[int, Evaluation] = {}
        self._ids = count(_first_id(self.now()))
        self._progress = self.create_publisher(
            FormulaProgress, '~/progress', 100, event_callbacks=NO_PUBLISHER_EVENTS
        )
        self.create_timer(period, self._report_progress, clock=self.wall_clock)
        self.serve(FormulaGroupCreate, self._create)
        self.serve(FormulaGroupAddFormula, self._add_formula)
        self.serve(FormulaGroupExtractSymbols, self._extract_symbols)
        self.serve(FormulaGroupEvaluate, self._evaluate)
        self.serve(FormulaGroupDestroy, self._destroy)

    def _create(self, request: Any, response: Any) -> None:
        group_id = next(self._ids)
        group = FormulaGroup(node_limit=self._node_limit)
        self._groups[group_id] = Evaluation(self, group_id, request.formula_group_name, group)
        response.formula_group_id = group_id

    def _add_formula(self, request: Any, response: Any) -> None:
        group = self._find(request.formula_group_id).group
        response.formula_id = group.add_formula(request.formula_name, request.formula)
        response.canonical_formula = str(group.formulas[response.formula_id])

    def _extract_symbols(self, request: Any, response: Any) -> None:
        symbols = self._find(request.formula_group_id).group.symbols()
        response.symbols = [
            Symbol(kind=int(symbol.kind), name=symbol.name, arguments=list(symbol.arguments))
            for symbol in symbols
        ]

    def _evaluate(self, request: Any, _response: Any) -> None:
        evaluation = self._find(request.formula_group_id)
        domains = {domain.sort: list(domain.objects) for domain in request.domains}
        evaluation.begin(domains, request.state_stream, request.result_topic)

    def _destroy(self, request: Any, _response: Any) -> None:
        self._find(request.formula_group_id).end()
        del self._groups[request.formula_group_id]

    def _find(self, group_id: int) -> Evaluation:
        if group_id not in self._groups:
            known = ', '.join(str(known) for known in self._groups) or 'none'
            raise ReasoningError(
                f'there is no formula group {group_id} (there are: {known})', ExitCode.NOT_FOUND
            )
        return self._groups[group_id]

    def _report_progress(self) -> None:
        if self._progress.get_subscription_count() > 0:
            for evaluation in self._groups.values():
                for report in evaluation.progress_reports():
                    self._progress.publish(report)


def _first_id(now: int) -> int:
    """A number that groups of an engine that had this one's name before are unlikely to have.

    Who asks for a group of the other one gets NOT_FOUND rather than somebody else's group.
    """
    seconds = now // NANOSECONDS['s']
    return seconds % 1_000_000 * 1_000 + 1


class Evaluation:
    """One formula group and the stream of states that it is progressed over."""

    def __init__(self, node: DyKnowNode, group_id: int, name: str, group: FormulaGroup) -> None:
        self.group = group
        self._node = node
        self._id = group_id
        self._name = name
        self._states = 0
        self._latest = 0
        self._next_number: int | None = None
        self._undecided: set[int] = set()
        self._subscription: Any = None
        self._results: Any = None

    def begin(self, domains: dict[str, list[str]], state_stream: str, result_topic: str) -> None:
        """Fixes the domains and listens to the states.

        Raises:
            ReasoningError: when a topic has no valid name or a sort no domain, or the group has
                begun.
        """
        for name, topic in (('state_stream', state_stream), ('result_topic', result_topic)):
            try:
                validate_topic_name(topic)
            except InvalidTopicNameException as error:
                raise ReasoningError(f'{name}: {error}') from None
        self.group.begin(domains)
        self._results = self._node.create_publisher(
            FormulaResultMessage,
            result_topic,
            LATCHED_HISTORY,
            event_callbacks=NO_PUBLISHER_EVENTS,
        )
        self._undecided = set(self.group.formulas)
        self._publish(self.group.decided_at_once())
        self._subscription = self._node.create_subscription(
            Sample,
            state_stream,
            # rclpy is typed as if no callback could ask for the message's info.
            cast('Any', self._progress),
            STREAM,
            event_callbacks=NO_SUBSCRIPTION_EVENTS,
        )

    def end(self) -> None:
        """Frees what listens and publishes."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._node.destroy_publisher(self._results)

    def progress_reports(self) -> Iterable[Any]:
        """How far each undecided formula has come."""
        for formula_id in self._undecided:
            yield FormulaProgress(
                formula_group_id=self._id,
                formula_id=formula_id,
                states_progressed=self._states,
                latest_valid_time=nanoseconds_to_time(self._latest),
                residual_formula=self.group.residual(formula_id),
            )

    def _progress(self, message: Any, info: Mapping[str, int | None]) -> None:
        if not self._undecided:
            return
        if (lost := self._states_lost(info.get('publication_sequence_number'))) is not None:
            self._fail_all(lost)
            return
        self._states += 1
        self._latest = time_to_nanoseconds(message.valid_time)
        try:
            fields = sample_fields(message)
        except DyKnowError as error:
            self._fail_all(error)
            return
        self._publish(self.group.progress(self._latest, fields))

    def _states_lost(self, number: int | None) -> DyKnowError | None:
        """A verdict would be a guess if a state were missing, or came from another publisher."""
        if number is None:
            return None  # Not all middleware numbers its messages.
        expected, self._next_number = self._next_number, number + 1
        if expected in {None, number}:
            return None
        return ReasoningError(
            f'states were lost: number {expected} of the state stream should have come, and '
            f'number {number} came',
            ExitCode.UNAVAILABLE,
        )

    def _fail_all(self, error: DyKnowError) -> None:
        failure = ReasoningError(error.message, error.code)
        self._publish(self.group.fail(failure, self._latest))

    def _publish(self, results: Iterable[FormulaResult]) -> None:
        for result in results:
            self._undecided.discard(result.formula_id)
            self._results.publish(self._message(result))

    def _message(self, result: FormulaResult) -> Any:
        message = FormulaResultMessage(
            formula_group_id=self._id,
            formula_id=result.formula_id,
            formula_name=result.name,
            verdict=int(result.verdict),
            explanation=result.explanation,
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        if result.decided_at is not None:
            message.decided_at = nanoseconds_to_time(result.decided_at)
        if result.error is not None:
            fill_exit_status(message.exit_status, result.error)
        return message


def main() -> int:
    """The executable stream_reasoning_engine."""
    return run(StreamReasoningEngine)
