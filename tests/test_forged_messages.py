"""Messages of nodes that have no business on a topic, and messages that make no sense.

Neither ends a node, and none becomes an answer; the status of the reader counts them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from dyknow_interfaces.msg import (
    ConstraintViolation,
    ExitStatus,
    Field,
    FormulaResult,
    Heartbeat,
    Sample,
    StreamStatus,
    StreamStatusArray,
)
from rclpy.node import Node
from rclpy.serialization import serialize_message

from dyknow_common.ros import (
    HEARTBEAT,
    LATCHED,
    LATCHED_HISTORY,
    NODE_TYPE,
    STARTED_AT,
    STATUS,
    STREAM,
    VIOLATIONS,
    nanoseconds_to_time,
    time_to_nanoseconds,
)
from evaluations import Evaluations
from system import Batteries, System

COORDINATOR = 'stream_reasoning_coordinator'
REASONER = 'stream_reasoning_engine'
ENGINE = 'stream_processing_engine'
SURGE = 'eventually Power[uav1] > 200'
"""It is undecided until the test lets the power rise, however long the forging takes."""


@contextmanager
def node_named(system: System, name: str) -> Iterator[Node]:
    """A further node of the test, which may have the name of another one."""
    node = Node(name, context=system.client.context)
    try:
        yield node
    finally:
        node.destroy_node()


class Drops:
    """The numbers of messages that nodes say they have dropped, and the reasons for the last."""

    def __init__(self, system: System, *names: str) -> None:
        self.status: dict[str, dict[str, str]] = {name: {} for name in names}
        self._system = system
        for name in names:
            system.client.node.create_subscription(
                DiagnosticStatus, f'/{name}/_status',
                lambda each, name=name: self._hear(name, each), STATUS,
            )  # fmt: skip

    def _hear(self, name: str, status: DiagnosticStatus) -> None:
        self.status[name] = {each.key: each.value for each in status.values}

    def count(self, name: str) -> int:
        """The number that a node has dropped."""
        return int(self.status[name].get('dropped messages', 0))

    def wait_for(self, name: str, reason: str, send: Callable[[], None]) -> None:
        """Sends messages until a node has dropped one for a reason, and waits until it says so."""
        before, sent = self.count(name), time.monotonic()

        def is_counted() -> bool:
            nonlocal sent
            if time.monotonic() > sent:
                send()
                sent = time.monotonic() + 0.3
            reported = self.status[name].get('last dropped', '')
            return self.count(name) > before and reason in reported

        self._system.client.spin_until(is_counted, f'{name} drops it', instead=lambda: self.status)


def results_topic(system: System) -> str:
    """The topic on which the coordinator receives results."""
    names = [name for name, _ in system.client.node.get_topic_names_and_types()]
    return next(name for name in names if name.startswith(f'/{COORDINATOR}/_results_'))


def result(evaluation: Any, verdict: int = FormulaResult.FALSE, code: int = 0) -> FormulaResult:
    """A result for every formula that a group of this test can have."""
    return FormulaResult(
        formula_group_id=evaluation.formula_group_id,
        formula_id=1,
        verdict=verdict,
        exit_status=ExitStatus(code=code),
    )


def assert_goes_on(system: System, batteries: Batteries, answer: Any) -> None:
    """The evaluation of `SURGE` has no answer until there is one."""
    assert not answer.done(), answer.result()
    surge = batteries.change(uav1=240.0)
    found = system.decided(answer, FormulaResult.TRUE)
    assert time_to_nanoseconds(found.decided_at) > surge
    assert 'Power[uav1] = 24' in found.explanation


def test_a_forged_result_is_no_answer(
    system: System, calm: Batteries, evaluations: Evaluations
) -> None:
    drops = Drops(system, COORDINATOR)
    answer = system.ask(SURGE)
    evaluation = evaluations.wait_for_state()[0]
    with node_named(system, 'forger') as forger:
        topic = results_topic(system)
        publisher = forger.create_publisher(FormulaResult, topic, LATCHED_HISTORY)

        def forge() -> None:
            for formula_id in range(5):
                forged = result(evaluation)
                forged.formula_id = formula_id
                publisher.publish(forged)

        drops.wait_for(COORDINATOR, 'it was sent by /forger', forge)
        assert_goes_on(system, calm, answer)


@pytest.mark.parametrize(
    ('verdict', 'code', 'reason'),
    [
        (77, 0, '77 is not a valid Verdict'),
        (FormulaResult.FALSE, 200, '200 is not a valid ExitCode'),
        (FormulaResult.UNDECIDED, 0, 'it has the verdict UNDECIDED'),
        (FormulaResult.TRUE, 1, 'it has the verdict TRUE and the exit code INVALID_ARGUMENT'),
    ],
)
def test_a_result_that_makes_no_sense(
    system: System,
    calm: Batteries,
    evaluations: Evaluations,
    verdict: int,
    code: int,
    reason: str,
) -> None:
    """Sent under the name of the reasoning engine."""
    drops = Drops(system, COORDINATOR)
    answer = system.ask(SURGE)
    evaluation = evaluations.wait_for_state()[0]
    with node_named(system, REASONER) as namesake:
        publisher = namesake.create_publisher(FormulaResult, results_topic(system), LATCHED_HISTORY)
        message = result(evaluation, verdict, code)
        drops.wait_for(COORDINATOR, reason, lambda: publisher.publish(message))
    assert_goes_on(system, calm, answer)


def test_forged_states_and_violations(
    system: System, calm: Batteries, evaluations: Evaluations
) -> None:
    """They would make the formula true, or end it."""
    drops = Drops(system, COORDINATOR, REASONER)
    answer = system.ask(SURGE)
    topic = evaluations.wait_for_state()[0].state_stream
    with node_named(system, 'forger') as forger:
        states = forger.create_publisher(Sample, topic, STREAM)
        violations = forger.create_publisher(ConstraintViolation, f'{topic}/violations', VIOLATIONS)

        def forge_state() -> None:
            stamp = nanoseconds_to_time(forger.get_clock().now().nanoseconds)
            field = Field(type='float', name='Power[uav1]', value='500.0')
            states.publish(Sample(valid_time=stamp, available_time=stamp, fields=[field]))

        def forge_violation() -> None:
            stamp = nanoseconds_to_time(forger.get_clock().now().nanoseconds)
            violations.publish(
                ConstraintViolation(
                    stream_name='x', constraint='max_delay', valid_time=stamp,
                    available_time=stamp, message='forged',
                )
            )  # fmt: skip

        drops.wait_for(REASONER, 'it was sent by /forger', forge_state)
        drops.wait_for(COORDINATOR, 'it was sent by /forger', forge_violation)
        assert_goes_on(system, calm, answer)


def test_a_result_that_cannot_be_decoded(system: System, calm: Batteries) -> None:
    drops = Drops(system, COORDINATOR)
    with node_named(system, REASONER) as namesake:
        publisher = namesake.create_publisher(FormulaResult, results_topic(system), LATCHED_HISTORY)
        # Most bytes are missing.
        message = serialize_message(FormulaResult(explanation='why'))[:12]
        drops.wait_for(COORDINATOR, 'it cannot be decoded', lambda: publisher.publish(message))
    answer = system.evaluate('always[0 s, 500 ms] Power[uav1] < 150')
    assert answer.verdict == FormulaResult.TRUE, answer
    assert calm.power['uav1'] == 100.0


@pytest.mark.parametrize(
    ('sender', 'changes', 'reason'),
    [
        (ENGINE, {'state': 99}, '99 is not a valid StreamState'),
        (ENGINE, {'rate': float('nan')}, 'its rate is nan'),
        ('forger', {}, 'it was sent by /forger'),
    ],
)
def test_reports_of_an_engine(
    system: System, calm: Batteries, sender: str, changes: dict[str, Any], reason: str
) -> None:
    drops = Drops(system, 'stream_manager')
    with node_named(system, sender) as node:
        publisher = node.create_publisher(StreamStatusArray, f'/{ENGINE}/streams', LATCHED)
        report = StreamStatusArray(streams=[StreamStatus(name='forged', **changes)])
        drops.wait_for('stream_manager', reason, lambda: publisher.publish(report))
    assert 'forged' not in system.streams()
    system.wait_for_streams()
    assert calm.power['uav1'] == 100.0


def test_a_forged_start_is_no_restart(
    system: System, calm: Batteries, evaluations: Evaluations
) -> None:
    """A restart of the engine would end the evaluation."""
    drops = Drops(system, COORDINATOR)
    answer = system.ask(SURGE)
    evaluations.wait_for_state()
    with node_named(system, 'forger') as forger:
        heartbeats = forger.create_publisher(Heartbeat, f'/{REASONER}/_heartbeat', HEARTBEAT)
        statuses = forger.create_publisher(DiagnosticStatus, f'/{REASONER}/_status', STATUS)
        later = time.time_ns() + 1_000_000_000

        def forge() -> None:
            heartbeats.publish(Heartbeat(started_at=nanoseconds_to_time(later), node_id=1))
            values = {NODE_TYPE: REASONER, STARTED_AT: str(later)}
            statuses.publish(
                DiagnosticStatus(
                    message='running',
                    values=[KeyValue(key=key, value=value) for key, value in values.items()],
                )
            )

        drops.wait_for(COORDINATOR, 'it was sent by /forger', forge)
        assert_goes_on(system, calm, answer)
