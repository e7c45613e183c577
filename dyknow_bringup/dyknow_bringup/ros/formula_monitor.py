"""Monitor formulas with the stream reasoning coordinator, all at once."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path

from dyknow_bringup.monitored_formula import (
    HOLDS,
    NOT_CONNECTED,
    UNDECIDED,
    VIOLATED,
    WAITING,
    MonitoredFormula,
)
from dyknow_bringup.resources import formulas_path
from dyknow_common import (
    SECOND_NS,
    DyKnowError,
    ExitCode,
    near_time,
    round_time,
    with_readable_times,
)
from dyknow_common.ros import DyKnowNode, run
from dyknow_configuration import RequestedFormula, Severity, read_formulas, read_robot
from dyknow_coordinator import Answer, Progress, Retries, StandingVerdicts
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_reactions.ros.triggers import Triggers

RETRIED = (ExitCode.UNAVAILABLE, ExitCode.NOT_FOUND)
"""Errors worth retrying while the other nodes are still starting."""

_OTHER_FILE = '; does the system run with the file of this formula, as by "dyknow up robot.yaml"?'
"""A hint in errors: a formula that lint finds correct may be wrong for another ontology."""

START_UP_NS = 10 * SECOND_NS
"""Time that the other nodes may take to start after the coordinator."""

NOT_ACCEPTED = 'the coordinator has not accepted it yet'


class MonitorNode(DyKnowNode):
    """A node that keeps the outcomes of formulas.

    Args:
        name: the name of the node.
        on_change: called with every formula whose outcome has changed; None: it is logged.
    """

    def __init__(self, name: str, on_change: Callable[[MonitoredFormula], None] | None) -> None:
        super().__init__(name)
        self.coordinator = self.parameter(
            'coordinator', 'stream_reasoning_coordinator', 'Name of the coordinator node.'
        )
        self.formulas: list[MonitoredFormula] = []
        self._hint = ''
        """Is added to an error that a name is not found."""
        self._on_change = on_change or self.log

    @property
    def is_connected(self) -> bool:
        """True if the coordinator has accepted each formula once."""
        return all(each.outcome != NOT_CONNECTED for each in self.formulas)

    @property
    def idle(self) -> list[MonitoredFormula]:
        """The formulas that never had a state, and have no error that says why."""
        return [each for each in self.formulas if not (each.has_states or each.is_decided)]

    def explain_wait(self, hint: str) -> None:
        """Report the formulas that are not connected, with what to do."""
        for each in self.formulas:
            if each.outcome == NOT_CONNECTED:
                self.explain(each, f'{NOT_ACCEPTED}{hint}')

    def log(self, monitored: MonitoredFormula) -> None:
        """Log the outcome of a formula: an alarm with the severity of the formula."""
        logger, now = self.get_logger(), self.now()
        text = f'{monitored.name}: {monitored.outcome}'
        text += '' if monitored.known_at is None else f' at {near_time(monitored.known_at, now)}'
        reason = with_readable_times(monitored.explanation, now=now)
        text += f': {reason}' if reason else ''
        # A formula that is not violated in its time ends with TIMEOUT. A logger of rclpy has one
        # severity for each call in the code.
        if monitored.outcome in {'true', HOLDS, UNDECIDED, ExitCode.TIMEOUT.name}:
            logger.info(text)
        elif monitored.formula.severity is Severity.ERROR and monitored.is_decided:
            logger.error(text)
        else:
            logger.warning(text)

    def note_progress(
        self, monitored: MonitoredFormula, progress: Progress, *, is_past: bool = False
    ) -> None:
        """Note a report on an evaluation that goes on; with `is_past`, its episodes are older."""
        monitored.margin, monitored.presumably_false = progress.margin, progress.presumably_false
        monitored.probability = progress.probability
        monitored.has_states |= progress.states_progressed > 0
        self.explain(monitored, progress.waits_for)
        outcome, verdicts = UNDECIDED, progress.episodes
        if verdicts is not None:
            self._follow(monitored, verdicts, is_past=is_past)
            is_known = verdicts.holds or verdicts.is_violated
            outcome = (VIOLATED if verdicts.is_violated else HOLDS) if is_known else UNDECIDED
        if progress.waits_for and outcome != VIOLATED:
            outcome = WAITING  # What held may not hold any more, or not for all objects.
        if progress.states_progressed and monitored.outcome != outcome:
            self.set_outcome(monitored, outcome, progress.waits_for)

    def note_answer(
        self, monitored: MonitoredFormula, answer: Answer, *, is_past: bool = False
    ) -> None:
        """Note the end of an evaluation; with `is_past`, its verdict and episodes are older."""
        monitored.margin, monitored.probability = answer.margin or monitored.margin, None
        if answer.episodes is not None:
            self._follow(monitored, answer.episodes, is_past=is_past)
        if answer.error is not None:
            hint = self._hint if answer.error.code is ExitCode.NOT_FOUND else ''
            reason, *place = answer.error.message.split('\n', 1)
            text = '\n'.join([f'{reason}{hint}', *place])
            self.set_outcome(monitored, answer.error.code.name, text)
            return
        monitored.has_states = True
        known_at = answer.decided_at if is_past else None
        self.set_outcome(
            monitored, answer.verdict.name.lower(), answer.explanation, known_at=known_at
        )

    def explain(self, monitored: MonitoredFormula, reason: str) -> None:
        """Note why a formula has no state, and report it until it has one."""
        is_news = reason not in {'', monitored.waits_for}
        monitored.waits_for = reason
        if is_news and monitored.outcome in {NOT_CONNECTED, WAITING}:
            monitored.explanation = reason
            self._on_change(monitored)

    def _follow(
        self, monitored: MonitoredFormula, verdicts: StandingVerdicts, *, is_past: bool
    ) -> None:
        """Set the outcome at each begin and end of an episode."""
        before, monitored.verdicts = monitored.verdicts, verdicts.known_after(monitored.verdicts)
        for episode, has_ended in verdicts.changes(before):
            monitored.margin = episode.worst or monitored.margin
            if has_ended:
                known_at = max(episode.end, episode.decided_at) if is_past else None
                self.set_outcome(monitored, HOLDS, episode.past_text, known_at=known_at)
            else:
                begun = f'from {round_time(episode.begin)} on: {episode.text}'
                known_at = episode.decided_at if is_past else None
                self.set_outcome(monitored, VIOLATED, begun, known_at=known_at)

    def set_outcome(
        self,
        monitored: MonitoredFormula,
        outcome: str,
        explanation: str,
        *,
        known_at: int | None = None,
    ) -> None:
        """Note an outcome, with its reason, and when it was known, in nanoseconds; None: now."""
        has_changed = outcome != monitored.outcome
        monitored.outcome, monitored.explanation = outcome, explanation
        monitored.has_failed |= outcome in {'false', VIOLATED}
        if has_changed:
            monitored.known_at = None if outcome == UNDECIDED else known_at or self.now()
            self._on_change(monitored)


class FormulaMonitor(MonitorNode):
    """A client that monitors each formula by a MonitorFormula action, and keeps its outcome.

    Args:
        formulas: the formulas to monitor; the caller checks the targets of their triggers. None:
            the formulas in the file that the parameter `robot` or `formulas` names.
        on_change: called with every formula whose outcome has changed; None: it is logged.
        name: the name of the node.
        retries: True to monitor a formula again after an error, until it has a verdict; this always
            applies to formulas of the parameter `robot`. While nodes are missing, a formula that
            never had a state is monitored again in any case.
    """

    def __init__(
        self,
        formulas: Sequence[RequestedFormula] | None = None,
        on_change: Callable[[MonitoredFormula], None] | None = None,
        *,
        name: str = 'formula_monitor',
        retries: bool = False,
    ) -> None:
        super().__init__(name, on_change)
        robot = self.parameter('robot', '', 'robot.yaml whose formulas are monitored.')
        path = self.parameter(
            'formulas', str(formulas_path()), 'YAML file with the formulas, without a robot.'
        )
        self._timeout = self.parameter(
            'timeout', 86_400.0, 'Seconds after which the monitoring of a formula ends.', (0.1, 1e9)
        )
        is_of_file = formulas is None
        if formulas is None:
            formulas = read_robot(Path(robot)).formulas if robot else read_formulas(Path(path))
            retries = retries or bool(robot)
        else:
            self._hint = _OTHER_FILE
        self._triggers = Triggers(self, formulas, logs_targets=is_of_file)
        self.formulas = [MonitoredFormula(formula) for formula in formulas]
        self._retries = retries
        self._is_cancelled = False
        self._restarting: set[int] = set()
        self._retries_of: defaultdict[int, Retries] = defaultdict(Retries)
        self._client = FormulaClient(self, self.coordinator)
        self._retry_until: int | None = None
        self._monitors: dict[int, Monitor] = {}
        for index in range(len(self.formulas)):
            self._start(index)

    @property
    def is_running(self) -> bool:
        """True if the coordinator monitors all formulas."""
        return all(monitor.accepted.done() for monitor in self._monitors.values())

    @property
    def has_ended(self) -> bool:
        """True if the monitoring of all formulas has ended, and their triggers have."""
        has_ended = all(monitor.outcome.done() for monitor in self._monitors.values())
        return has_ended and not self._restarting and self._triggers.is_idle

    def cancel_all(self) -> None:
        """Cancel the monitoring of all formulas."""
        self._is_cancelled, self._retry_until = True, 0
        self._restarting.clear()
        for monitor in self._monitors.values():
            monitor.cancel()

    def destroy_node(self) -> None:
        """Cancel the evaluations and destroy the node."""
        self._is_cancelled = True
        self._client.close()
        self._triggers.close()
        super().destroy_node()

    def _start(self, index: int) -> None:
        monitored = self.formulas[index]
        monitored.waits_for = NOT_ACCEPTED
        monitored.verdicts = StandingVerdicts()
        monitor = self._monitors[index] = self._client.monitor(
            monitored.formula.closed_text,
            on_verdict=lambda answer: self._on_verdict(index, answer),
            on_feedback=lambda progress: self._on_progress(index, progress),
            name=monitored.name,
            every_state=monitored.formula.every_state,
            restart_on_change=True,
            margin=monitored.formula.margin,
            record=monitored.formula.record,
            timeout=self._timeout,
            wait=self._timeout,
        )
        monitor.accepted.add_done_callback(lambda _: self._on_accept(monitored))

    def _on_accept(self, monitored: MonitoredFormula) -> None:
        if self._is_cancelled:
            return
        monitored.waits_for = ''
        if monitored.outcome == NOT_CONNECTED:
            monitored.outcome, monitored.explanation = WAITING, ''
        if self._retry_until is None:
            self._retry_until = self.now() + START_UP_NS

    def _on_progress(self, index: int, progress: Progress) -> None:
        monitored = self.formulas[index]
        self._triggers.on_progress(monitored.formula, progress)
        if progress.states_progressed:
            self._retries_of[index].note_progress()
        self.note_progress(monitored, progress)

    def _on_verdict(self, index: int, answer: Answer) -> None:
        monitored, error = self.formulas[index], answer.error
        is_starting = (
            error is not None
            and error.code in RETRIED
            and not monitored.has_states
            and self.now() < (self._retry_until or 0)
        )
        if not is_starting:
            self._triggers.on_answer(monitored.formula, answer)
        if error is None or not (is_starting or self._has_cancelled(error)):
            self.note_answer(monitored, answer)
        if error is not None and (is_starting or self._is_retried(monitored, error.code)):
            self._restarting.add(index)
            delay = self._retries_of[index].delay(error.code, counts=not is_starting)
            due = self.deadlines.after(delay / SECOND_NS)
            due.add_done_callback(lambda _: self._restart(index))

    def _has_cancelled(self, error: DyKnowError) -> bool:
        return self._is_cancelled and error.code is ExitCode.CANCELLED

    def _is_retried(self, monitored: MonitoredFormula, code: ExitCode) -> bool:
        is_late = code is ExitCode.UNAVAILABLE and not monitored.has_states
        is_retried = self._retries and code is not ExitCode.CANCELLED
        return not self._is_cancelled and (is_late or is_retried)

    def _restart(self, index: int) -> None:
        if index in self._restarting:
            self._restarting.remove(index)
            self._start(index)


def main() -> int:
    """Run the executable formula_monitor."""
    return run(FormulaMonitor)
