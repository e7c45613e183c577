"""Evaluations as somebody sees them who looks on, or who asks for one by the action."""

from __future__ import annotations

import re
from typing import Any

from dyknow_interfaces.action import MonitorFormula
from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray, ExitStatus, StreamSpec
from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    FormulaGroupExtractSymbols,
    RemoveSemanticSpecification,
    StreamCreateFromSpec,
    StreamDestroy,
)
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile

from dyknow_common.ros import nanoseconds_to_duration, time_to_nanoseconds
from system import LIMIT, POLL, Client, System

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
COORDINATOR = 'stream_reasoning_coordinator'

BATTERY_PERIOD = 'sample_period = 200 ms, sample_period_deviation = 50 ms'
BATTERY_TIMING = f'max_delay = 1 s, {BATTERY_PERIOD}'
"""The constraints on the fleet's batteries."""


class Evaluations:
    """The reports of a system's coordinator on its evaluations, and their remains."""

    def __init__(self, system: System) -> None:
        self._system = system
        self.reported: list[Any] = []
        """Those of the last report."""
        # By name and time of the request; the coordinator forgets them after a while.
        self._ended: dict[tuple[str, int], Any] = {}
        self._subscription = system.client.node.create_subscription(
            EvaluationStatusArray, f'{COORDINATOR}/evaluations', self._hear, LATCHED
        )

    def close(self) -> None:
        """Listen no more."""
        self._system.client.node.destroy_subscription(self._subscription)

    @property
    def running(self) -> list[Any]:
        """Those that have not ended."""
        return [each for each in self.reported if each.phase != EvaluationStatus.ENDED]

    @property
    def latest(self) -> Any:
        """The one that was asked for last."""
        return self.reported[-1]

    def ended(self, name: str) -> list[Any]:
        """Those of a name that have ended."""
        return [each for (ended, _), each in self._ended.items() if ended == name]

    def told(self) -> str:
        """Return the last report, and the ends of earlier evaluations, for people."""
        return '\n'.join(map(_summary, [*self._ended.values(), *self.running])) or 'nothing'

    def wait_for(self, count: int) -> list[Any]:
        """Waits until so many are past their grounding; those."""
        self._system.client.spin_until(
            lambda: [each.phase for each in self.running] == [EvaluationStatus.RUNNING] * count,
            f'{count} evaluations that run',
            instead=self.told,
        )
        return self.running

    def wait_for_state(self, count: int = 1) -> list[Any]:
        """Waits until so many run, and each has had a state."""
        self._system.client.spin_until(
            lambda: (
                len(self.running) == count and all(each.states_progressed for each in self.running)
            ),
            f'states of {count} evaluations',
            instead=self.told,
        )
        return self.running

    def wait_for_event(self, *words: str) -> None:
        """Waits until an evaluation tells of an event with these words."""
        self._system.client.spin_until(
            lambda: any(
                all(word in event for word in words)
                for each in self.running
                for event in each.events
            ),
            f'an event with {words}',
            instead=self.told,
        )

    def groups(self) -> set[int]:
        """The formula groups of the reasoning engine; asking for none of them keeps none alive."""
        answer = self._system.client.call(
            FormulaGroupExtractSymbols,
            'stream_reasoning_engine/formula_group_extract_symbols',
            formula_group_id=0,
        )
        assert answer.exit_status.code == ExitStatus.NOT_FOUND
        _, _, known = answer.exit_status.message.partition('there are:')
        return {int(number) for number in re.findall(r'\d+', known)}

    def wait_for_nothing(self) -> None:
        """Waits until nothing is evaluated, and nothing is left of what was."""
        wait = self._system.client.spin_until
        wait(lambda: not self.running, 'nothing is evaluated', instead=self.told)
        wait(lambda: not self.groups(), 'no formula group is left', pause=POLL)
        wait(
            lambda: not any('states_' in name for name in self._system.streams()),
            'no stream of states is left',
            pause=POLL,
        )

    def _hear(self, report: Any) -> None:
        self.reported = list(report.evaluations)
        for each in self.reported:
            if each.phase == EvaluationStatus.ENDED:
                self._ended[each.name, time_to_nanoseconds(each.started)] = each


def _summary(status: Any) -> str:
    fields = ('name', 'phase', 'states_progressed', 'verdict', 'explanation', 'events')
    values = ', '.join(f'{field} {getattr(status, field)!r}' for field in fields)
    return f'{values}, {status.exit_status.message!r}'


class Monitored:
    """A formula that is evaluated for a client of the action."""

    def __init__(self, client: Client, formula: str, timeout: float = LIMIT, **fields: Any) -> None:
        self.feedback: list[Any] = []
        self.status: int | None = None
        """The status of the goal, once it has ended."""
        self._client = client
        self._action = ActionClient(client.node, MonitorFormula, f'{COORDINATOR}/monitor_formula')
        client.spin_until(self._action.server_is_ready, 'the action')
        accepted = self._action.send_goal_async(
            MonitorFormula.Goal(
                formula=formula, timeout=nanoseconds_to_duration(round(timeout * 1e9)), **fields
            ),
            feedback_callback=lambda message: self.feedback.append(message.feedback),
        )
        client.spin_until(accepted.done, 'the goal is accepted')
        self._handle: Any = accepted.result()
        assert self._handle.accepted
        self._result = self._handle.get_result_async()

    @property
    def events(self) -> list[str]:
        """All that it has been told."""
        return [event for each in self.feedback for event in each.events]

    def told(self) -> object:
        """Its answer, or its last feedback until there is one."""
        return self._result.result() if self._result.done() else self.feedback[-1:]

    def cancel(self) -> None:
        """Wants no answer any more."""
        self._handle.cancel_goal_async()

    def end(self) -> Any:
        """Wants no answer any more, and waits for the end; the result."""
        self.cancel()
        return self.result()

    def result(self) -> Any:
        """Waits for the answer."""
        result = self._client.result(self._result, 'the result')
        self._action.destroy()
        self.status = result.status
        return result.result


class Spares:
    """Additional streams, and what they mean, until they are cleared away."""

    def __init__(self, system: System) -> None:
        self._system = system
        self._made: list[str] = []
        self._annotated: list[str] = []

    def make(self, name: str, specification: str) -> None:
        """Has a stream made."""
        self._succeed(
            StreamCreateFromSpec,
            'stream_manager/stream_create_from_spec',
            spec=StreamSpec(name=name, specification=specification),
        )
        self._made.append(name)

    def annotate(self, name: str, meaning: str) -> None:
        """Says what a stream carries."""
        self._succeed(
            AddSemanticSpecification,
            'stream_semantics_manager/add_semantic_specification',
            ssl_statement=f'stream {name} contains {meaning};',
        )
        self._annotated.append(name)

    def forget(self, name: str) -> None:
        """Says that a stream carries nothing of interest."""
        self._succeed(
            RemoveSemanticSpecification,
            'stream_semantics_manager/remove_semantic_specification',
            stream_name=name,
        )
        self._annotated.remove(name)

    def power(
        self, name: str, vehicle: str, of: str, timing: str = '', battery: str = BATTERY_TIMING
    ) -> None:
        """Has the power of a vehicle made of the battery of another.

        Args:
            name: of the stream.
            vehicle: whose battery is read.
            of: whose power it is.
            timing: what the annotation promises.
            battery: the constraints of the battery that is read.
        """
        self.make(
            name,
            'compunit power: float electrical_power((voltage: float, current: float));'
            f'stream {name}_battery = select voltage, current from "/{vehicle}/battery" '
            f'with {battery};'
            f'sink electrical_power({name}_battery)',
        )
        self.annotate(name, f'Power[{of}] = power' + (f' with {timing}' if timing else ''))

    def clear(self) -> None:
        """Ends them all, as soon as no states are made of them any more."""
        for name in list(self._annotated):
            self.forget(name)
        while self._made:
            self._system.client.spin_until(self._end_last, 'a stream can be ended', pause=POLL)

    def _end_last(self) -> bool:
        service = 'stream_manager/stream_destroy'
        answer = self._system.client.call(StreamDestroy, service, stream_name=self._made[-1])
        if answer.exit_status.code == ExitStatus.SUCCESS:
            self._made.pop()
            return True
        assert 'made from it' in answer.exit_status.message, answer
        return False

    def _succeed(self, service_type: Any, service: str, **fields: Any) -> None:
        status = self._system.client.call(service_type, service, **fields).exit_status
        assert status.code == ExitStatus.SUCCESS, status.message
