"""The node of `dyknow guard`: passes messages on while formulas hold, else a safe message.

A guard depends on its own process alone: it reads the states of its formulas, decides itself, and
counts silence by the monotonic clock. `Gate` decides whether messages pass; this module tells it
what happens, and does what follows at once: a state with which the gate closes is followed by the
safe message in the same callback.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from dyknow_interfaces.msg import EvaluationStatusArray, GuardStatus, Heartbeat
from std_srvs.srv import Trigger

from dyknow_common import DyKnowError, with_readable_times
from dyknow_common.executables import ERROR, describe
from dyknow_common.ros import (
    HEARTBEAT,
    LATCHED,
    DiagnosticsPublisher,
    DyKnowNode,
    RemoteNode,
    Throttle,
    is_time_simulated,
    only_owner,
    run,
    topic_fault,
)
from dyknow_configuration import RequestedGuard, read_robot
from dyknow_coordinator.ros import FormulaClient
from dyknow_reactions.errors import ReactionError
from dyknow_reactions.guard.command_formulas import (
    CommandFormula,
    CommandFormulas,
    CommandStates,
)
from dyknow_reactions.guard.gate import ClockJumps, Gate, GateReports, GateState
from dyknow_reactions.guard.watched_formula import WatchedStates
from dyknow_reactions.ros.guard.formula_states import FormulaStates, StateServices
from dyknow_reactions.ros.guard.passage import Passage
from dyknow_reasoning import asked_of_each_state, parse_formula
from dyknow_stream_processing.ros import PAUSES

WATCHED: Final = ('stream_reasoning_coordinator', 'stream_reasoning_engine', 'stream_manager')
"""The nodes without which no formula is evaluated, or its states are not replaced.

The engines that make the states are not among them: they give signs of life by the states.
"""

TICK_S: Final = 0.02
"""The time between two looks at what may have become too old."""

REPORT_PERIOD_S: Final = 1.0
REFUSALS_PERIOD_S: Final = 1.0
"""The time between two log messages about refused commands."""


class GuardNode(DyKnowNode):
    """A guard of a robot.yaml. Its topic `~/status` has a GuardStatus."""

    def __init__(self) -> None:
        super().__init__('guard')
        path = self.parameter('robot', '', 'robot.yaml with the guard.')
        name = self.parameter('guard', '', 'Name of the guard; empty for the only one of the file.')
        robot = read_robot(Path(path))
        self._guard = chosen_guard(robot.guards, name, path)
        self._passed = self._refused = 0
        self._last_sent = 0
        self._reported: tuple[GateState, str] | None = None
        self._refusals = Throttle(REFUSALS_PERIOD_S)
        self._jumps = ClockJumps()
        PAUSES.start()
        topic = self._guard.input
        self._commands: dict[str, CommandFormula] = {
            each.name: CommandFormula(each.closed_text, topic, robot.units)
            for each in self._guard.formulas
            if each.reads(topic)
        }
        self._check_topics([each for each in robot.guards if each != self._guard])
        self._tried = CommandFormulas(self._commands)
        self._passage = self._make_passage()
        self._gate = self._make_gate()
        self._publisher = self.create_publisher(GuardStatus, '~/status', LATCHED)
        self._diagnostics = DiagnosticsPublisher(self)
        self._watch_formulas()
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_timer(TICK_S, self._tick, clock=self.wall_clock)
        self.create_timer(REPORT_PERIOD_S, self._report, clock=self.wall_clock)

    def _make_passage(self) -> Passage:
        try:
            return Passage(self, self._guard, self._tried.paths, self._on_message)
        except DyKnowError as error:
            place = f"{self._guard.place}: the guard '{self._guard.name}'"
            raise ReactionError(f'{place}: {error.message}') from None

    def _make_gate(self) -> Gate:
        """Return the gate; a guard whose formulas are about commands alone needs no states."""
        asked = [
            each.name
            for each in self._guard.formulas
            if each.name not in self._commands or self._commands[each.name].state_formula
        ]
        return Gate(
            asked,
            WATCHED if asked else (),
            self._guard.timeout,
            latch=self._guard.latch,
            block=self._passage.obstacle,
        )

    def _check_topics(self, others: Sequence[RequestedGuard]) -> None:
        """Refuse names of topics that are the same in this namespace."""

        def resolved(name: str, *, only_expand: bool = False) -> str:
            if topic_fault(self, name):
                return name
            return str(self.resolve_topic_name(name, only_expand=only_expand))

        for name, each in self._guard.other_names_of_input(resolved):
            raise ReactionError(
                f"{self._guard.place}: the formula '{name}' names the input as '{each}'; "
                f"write '{self._guard.input}'"
            )
        if conflict := self._guard.conflict_with(others, resolved):
            raise ReactionError(f"{self._guard.place}: the guard '{self._guard.name}': {conflict}")
        for name, each in self._guard.topics_of_formulas():
            if (effective := resolved(each)) != resolved(each, only_expand=True):
                self.get_logger().warning(
                    f"the formula '{name}' names {each}, which is evaluated by other nodes; the "
                    f'remap to {effective} has no effect on it here'
                )

    def _watch_formulas(self) -> None:
        services = StateServices(self, FormulaClient(self), RemoteNode(self, 'ontology_manager'))
        self._client, self._states = services.client, list[FormulaStates]()
        reports = GateReports(
            self._gate, self._now, lambda valid: max(self.now() - valid, 0), self._settle
        )
        for each in self._guard.formulas:
            command = self._commands.get(each.name)
            title = f'{self.get_fully_qualified_name()}: {each.name}'
            if command is None:
                watched = WatchedStates(each.name, reports)
                text = str(asked_of_each_state(parse_formula(each.text, each.constants)))
                self._states.append(FormulaStates(services, text, title, watched, every_state=True))
            elif command.state_formula:
                tried = CommandStates(each.name, command, reports)
                self._states.append(
                    FormulaStates(services, command.state_formula, title, tried, every_state=False)
                )
        if not self._states:
            return
        topic = 'stream_reasoning_coordinator/evaluations'
        self.create_report_subscription(EvaluationStatusArray, topic, self._on_evaluations)
        for name in WATCHED:
            self.create_subscription(
                Heartbeat,
                f'{name}/_pulse',
                partial(self._on_pulse, name),
                HEARTBEAT,
                refusal=only_owner,
                callback_group=self.reentrant,
            )

    def _now(self) -> int:
        """Return the monotonic time, after a look whether the process was stopped before."""
        now = time.monotonic_ns()
        if PAUSES.unsettled_for(now) is not None:
            self._gate.interrupt(now, 'the guard itself was stopped or had no processor')
        return now

    def _on_message(self, data: bytes, info: Mapping[str, Any]) -> None:
        now = self._now()
        if not self._gate.passes(now, age=age_of(info)):
            self._refused += 1
            self._send_safe(now)
            self._settle(now)
        elif self._tried and (reason := self._refusal(data, now)):
            self._refused += 1
            self._send_safe(now)
            if self._refusals.is_due():
                self.get_logger().warning(f'refused a message: {reason}')
        else:
            self._passage.send(data)
            self._passed += 1

    def _refusal(self, data: bytes, now: int) -> str:
        """Return why a message would violate a formula; empty if it may pass."""
        try:
            return self._tried.refusal(self._passage.values(data), now)
        except Exception as error:  # noqa: BLE001 - of the decoder
            return f'it cannot be read: {error}'

    def _on_pulse(self, node: str, _message: object, info: Mapping[str, Any]) -> None:
        age, now = age_of(info), self._now()
        self._gate.note_node(node, now, age=age)
        self._settle(now)

    def _on_evaluations(self, message: Any) -> None:
        for each in self._states:
            each.note_evaluations(message.evaluations)

    def _tick(self) -> None:
        now = self._now()
        if self._jumps.has_jumped(self.now(), now, is_simulated=is_time_simulated(self)):
            self._gate.interrupt(now, 'the clock of the guard has jumped')
        self._gate.block(now, self._passage.obstacle)
        self._settle(now)
        if self._gate.state is not GateState.OPEN and now - self._last_sent >= self._guard.period:
            self._send_safe(now)

    def _settle(self, now: int) -> None:
        """Do what follows from a change of the gate."""
        state = self._gate.state
        if self._reported == (state, self._gate.reason):
            return
        has_closed = self._reported is not None and self._reported[0] is GateState.OPEN
        if has_closed and state is not GateState.OPEN:
            self._send_safe(now)
        has_changed = self._reported is None or self._reported[0] is not state
        self._reported = state, self._gate.reason
        self._publish_state()
        if has_changed and state is GateState.OPEN:
            self.get_logger().info('open')
        elif has_changed:
            self.get_logger().warning(self._closed_text())

    def _send_safe(self, now: int) -> None:
        self._passage.send_safe()
        self._last_sent = now

    def _report(self) -> None:
        # It opens as of this time: the messages of a new subscription come later, and pass.
        now = self._now()
        self._passage.refresh()
        self._gate.block(now, self._passage.obstacle)
        self._settle(now)
        self._publish_state()
        self._publish_diagnostics()

    def _publish_state(self) -> None:
        status = GuardStatus(
            name=self._guard.name,
            state=int(self._gate.state),
            reason=self._gate.reason,
            passed=self._passed,
            refused=self._refused,
        )
        status.header.stamp = self.get_clock().now().to_msg()
        self._publisher.publish(status)

    def _publish_diagnostics(self) -> None:
        level, text = DiagnosticStatus.OK, 'open'
        if self._gate.state is not GateState.OPEN:
            level, text = DiagnosticStatus.ERROR, self._closed_text()
        elif self._passage.bypass:  # Who can publish the output beside the guard.
            level, text = DiagnosticStatus.WARN, self._passage.bypass
        counts = {
            'input': self._passage.input,
            'output': self._passage.output,
            'passed': str(self._passed),
            'refused': str(self._refused),
        }
        values = [KeyValue(key=key, value=value) for key, value in counts.items()]
        name = self.get_fully_qualified_name()
        status = DiagnosticStatus(level=level, name=name, message=text, values=values)
        self._diagnostics.publish([status])

    def _closed_text(self) -> str:
        return f'{self._gate.state.name.lower()}: {with_readable_times(self._gate.reason)}'

    def _reset(self, _request: Any, response: Any) -> Any:
        now = self._now()
        response.success = self._gate.reset(now)
        response.message = self._gate.reason or 'open'
        self._settle(now)
        return response

    def destroy_node(self) -> None:
        """Cancel the evaluations, and destroy the node."""
        self._client.close()
        super().destroy_node()


def chosen_guard(guards: tuple[RequestedGuard, ...], name: str, path: str) -> RequestedGuard:
    """Return the guard of a name, or the only one.

    Raises:
        ReactionError: if there is no such guard, or a choice.
    """
    names = ', '.join(each.name for each in guards) or 'none'
    found = [each for each in guards if each.name == name or not name]
    if len(found) != 1:
        wanted = f"there is no guard '{name}'" if name else 'name one of the guards'
        raise ReactionError(f'{path}: {wanted} (there are: {names})')
    return found[0]


def age_of(info: Mapping[str, Any]) -> int:
    """Return the time since the middleware received a message, in nanoseconds.

    A busy process may take messages late; until then they wait in a queue.
    """
    received = info.get('received_timestamp') or 0
    return max(time.time_ns() - received, 0) if received else 0


def main() -> int:
    """Run the executable guard."""
    return run(GuardNode)


def guard(options: argparse.Namespace) -> int:
    """Run a guard until SIGINT or SIGTERM."""
    path = str(options.robot.resolve())
    chosen = chosen_guard(read_robot(options.robot).guards, options.name, path)
    parameters = {'robot': path, 'guard': chosen.name, 'use_sim_time': options.use_sim_time}
    arguments = ['--ros-args']
    for name, value in parameters.items():
        arguments += ['-p', f'{name}:={value}']
    # The command line prevails: the last value of a parameter counts, and the first remap.
    arguments += ['--', *sys.argv, '--ros-args', '-r', f'__node:={chosen.name}']
    if options.namespace:
        arguments += ['-r', f'__ns:=/{options.namespace.strip("/")}']
    return run(GuardNode, arguments=arguments, failure=ERROR)


def add_guard_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=guard)
    describe(
        parser,
        'Run a guard of a robot.yaml: messages pass from its input to its output while its '
        'formulas hold. "dyknow up robot.yaml" starts all guards of the file.',
        ('dyknow guard robot.yaml', 'dyknow guard robot.yaml base_guard --namespace /robot1'),
        '0 after a stop by a signal, 2 for an error',
    )
    parser.add_argument('robot', type=Path, help='robot.yaml, which describes the guard')
    parser.add_argument(
        'name', nargs='?', default='', help='of the guard; may be left out for the only one'
    )
    parser.add_argument('--namespace', default='', help='of the guard (default: none)')
    parser.add_argument('--use-sim-time', action='store_true', help='take time from /clock')
