"""Triggers in a node: they follow the answers and reports of a FormulaClient."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from typing import Any, Final, Self

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.task import Future

from dyknow_common import SECOND_NS, DyKnowError, one_line, round_duration, round_time
from dyknow_common.ros import DiagnosticsPublisher, NodeAdapter, RCLError
from dyknow_configuration import RequestedFormula, Trigger
from dyknow_coordinator import Answer, Progress
from dyknow_reactions.ros.triggers import targets
from dyknow_reactions.ros.triggers.actions import ACTIONS, TriggerAction, check_action
from dyknow_reactions.ros.triggers.targets import (
    present_target_faults,
    target_of,
    triggers_of,
    type_conflicts,
)
from dyknow_reactions.triggers import (
    FormulaEvents,
    TriggerAttempt,
    TriggerReport,
    TriggerRuns,
    TriggerState,
    TriggerUse,
)

REPORT_PERIOD_S: Final = 1.0
"""The time between two reports on /diagnostics."""


class Triggers:
    """Runs the triggers of formulas, and reports on /diagnostics how they went.

    The callbacks of a client are passed on:

        triggers = Triggers(node, robot.formulas)
        for formula in robot.formulas:
            client.monitor(
                formula.closed_text,
                every_state=formula.every_state,
                margin=formula.margin,
                on_feedback=partial(triggers.on_progress, formula),
                on_verdict=partial(triggers.on_answer, formula),
            )

    Nothing waits: attempts end in callbacks of the node, or with the timeouts of their triggers.
    Targets that are not there, such as services, are logged once after DISCOVERY_S.

    Args:
        node: any node.
        formulas: the formulas with their triggers.
        logs_targets: False if the caller reports targets that are not there.

    Raises:
        ConfigurationError: for a type, a field or a command that does not exist, with the place in
            the file.
    """

    def __init__(
        self, node: Node, formulas: Sequence[RequestedFormula], *, logs_targets: bool = True
    ) -> None:
        self._node = node
        target = partial(target_of, node)
        self._runs = TriggerRuns(formulas, target)
        self._adapter = NodeAdapter(node)
        self._events = [(each, FormulaEvents(each)) for each in formulas]
        self._pending: dict[TriggerAttempt, Callable[[], str]] = {}
        # A multi-threaded executor may run several callbacks at once.
        self._lock = threading.RLock()
        self._actions: dict[int, TriggerAction] = {}
        self._wakeup: Future = Future()
        self._timer: Any = None
        self._diagnostics: Any = None
        try:
            self._create_actions(formulas, target)
        except DyKnowError:
            self.close()
            raise
        if self._runs.uses:
            self._diagnostics = DiagnosticsPublisher(node)
            clock = self._adapter.wall_clock
            self._timer = node.create_timer(REPORT_PERIOD_S, self._publish, clock=clock)
        if self._runs.uses and logs_targets:
            discovery = self._adapter.deadlines.after(targets.DISCOVERY_S)
            discovery.add_done_callback(lambda _: self._report_targets(triggers_of(formulas)))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def uses(self) -> tuple[TriggerUse, ...]:
        """The outcome of each use of a trigger."""
        return self._runs.uses

    @property
    def is_idle(self) -> bool:
        """True if nothing runs or waits."""
        return self._runs.is_idle

    def on_progress(self, formula: RequestedFormula, progress: Progress) -> None:
        """Receive a report on the evaluation of a formula."""
        with self._lock:
            for report in self._events_of(formula).on_progress(progress, self._now()):
                self._start(report)

    def on_answer(self, formula: RequestedFormula, answer: Answer) -> None:
        """Receive the answer to a formula, or the error that has interrupted it."""
        with self._lock:
            for report in self._events_of(formula).on_answer(answer, self._now()):
                self._start(report)

    def close(self) -> None:
        """Give up what runs, kill the commands, and release everything."""
        with self._lock:
            for give_up in self._pending.values():
                give_up()
            self._pending.clear()
            for action in self._actions.values():
                action.close()
            self._actions.clear()
            if self._timer is not None:
                self._node.destroy_timer(self._timer)
                self._diagnostics.destroy()
            self._adapter.close()

    def _create_actions(
        self, formulas: Sequence[RequestedFormula], name_of: Callable[[Trigger], str]
    ) -> None:
        for error in check_triggers(formulas, name_of=name_of):
            raise error
        for each in triggers_of(formulas):
            try:
                self._actions[id(each)] = ACTIONS[each.kind](self._adapter, each)
            except RCLError as error:
                raise each.error(one_line(error)) from None

    def _report_targets(self, triggers: Sequence[Trigger]) -> None:
        """Log the targets that nobody offers, or that have another type."""
        if not self._actions:
            return  # Closed meanwhile.
        logger = self._node.get_logger()
        for fault in present_target_faults(self._node, triggers):
            if fault.is_missing:
                logger.warning(f'trigger: {fault.warning}')
            else:
                logger.error(f'trigger: {fault.warning}')

    def _events_of(self, formula: RequestedFormula) -> FormulaEvents:
        return next(events for each, events in self._events if each is formula)

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)

    def _wall_time(self) -> int:
        return int(self._adapter.wall_clock.now().nanoseconds)

    def _start(self, report: TriggerReport) -> None:
        for use in self._runs.start(report, self._wall_time()):
            self._node.get_logger().warning(f'trigger: {use.name}: {use.text}')
        self._begin()

    def _begin(self) -> None:
        """Begin the attempts that are due, now and later."""
        with self._lock:
            if not self._actions:
                return
            for attempt in self._runs.begin(self._wall_time()):
                self._attempt(attempt)
            self._wakeup.cancel()
            if (due := self._runs.next_due) is not None:
                self._begin_after(max(0, due - self._wall_time()) / SECOND_NS)

    def _begin_after(self, delay_s: float) -> None:
        self._wakeup = self._adapter.deadlines.after(delay_s)
        self._wakeup.add_done_callback(self._on_wakeup)

    def _on_wakeup(self, wakeup: Future) -> None:
        if not wakeup.cancelled():
            self._begin()

    def _attempt(self, attempt: TriggerAttempt) -> None:
        trigger = attempt.use.trigger
        limit = self._adapter.deadlines.after(trigger.timeout / SECOND_NS)
        number = attempt.number
        limit.add_done_callback(lambda _: self._expire(attempt, number))
        self._pending[attempt] = lambda: ''
        try:
            give_up = self._actions[id(trigger)].begin(
                attempt.report, lambda failure: self._end(attempt, failure)
            )
        except Exception as error:  # noqa: BLE001 - a trigger must not end the monitor
            self._end(attempt, str(error))
            return
        if attempt in self._pending:
            self._pending[attempt] = give_up

    def _expire(self, attempt: TriggerAttempt, number: int) -> None:
        with self._lock:
            give_up = self._pending.get(attempt)
            # A later attempt of the run has a limit of its own.
            if give_up is not None and attempt.number == number:
                limit = round_duration(attempt.use.trigger.timeout)
                self._end(attempt, f'{give_up()} within {limit}')

    def _end(self, attempt: TriggerAttempt, failure: str) -> None:
        with self._lock:
            if self._pending.pop(attempt, None) is None:
                return
            self._runs.end(attempt, self._wall_time(), failure)
            self._log(attempt.use)
            # Not at once: another attempt would begin within the callback of this one.
            self._wakeup.cancel()
            self._begin_after(0.0)

    def _log(self, use: TriggerUse) -> None:
        logger, text = self._node.get_logger(), f'trigger: {use.name}: {use.text}'
        # A logger of rclpy has one severity for each call in the code.
        if use.state is TriggerState.OK:
            logger.info(text)
        elif use.state is TriggerState.WARN:
            logger.warning(text)
        else:
            logger.error(text)

    def _publish(self) -> None:
        self._diagnostics.publish(self._status(use) for use in self._runs.uses)

    def _status(self, use: TriggerUse) -> DiagnosticStatus:
        numbers = {'runs': use.runs, 'failures': use.failures, 'ignored events': use.ignored}
        now = self._wall_time()
        entries = [(f'{round_time(now - time)} ago', text) for time, text in use.log]
        values = [*numbers.items(), *entries]
        return DiagnosticStatus(
            level=bytes([use.state]),
            name=f'{self._node.get_fully_qualified_name()}: {use.name}',
            message=use.text,
            values=[KeyValue(key=key, value=str(value)) for key, value in values],
        )


def check_triggers(
    formulas: Sequence[RequestedFormula],
    others: Sequence[Trigger] = (),
    name_of: Callable[[Trigger], str] = attrgetter('target'),
) -> list[DyKnowError]:
    """Return the faults of triggers: their types, fields and commands; needs no node.

    Args:
        formulas: with triggers.
        others: triggers that none of these has.
        name_of: returns the name of the target of a trigger.
    """
    triggers = [*triggers_of(formulas), *others]
    found: list[DyKnowError] = [*type_conflicts(triggers, name_of)]
    for trigger in triggers:
        try:
            check_action(trigger)
        except DyKnowError as error:
            found.append(error)
    return found
