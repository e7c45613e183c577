"""Margins of formulas that real nodes evaluate."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf
from typing import Any

import pytest
from dyknow_interfaces.msg import EvaluationStatusArray, FormulaProgress
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.node import Node

from dyknow_common import ExitCode, Margin, Verdict
from dyknow_common.ros import LATCHED
from dyknow_coordinator import Answer, Progress
from dyknow_coordinator.ros import FormulaClient
from system import ALWAYS, Batteries, System

COORDINATOR = '/stream_reasoning_coordinator'


@pytest.fixture
def client(system: System, batteries: Batteries) -> Iterator[FormulaClient]:  # noqa: ARG001
    system.wait_for_streams()
    with FormulaClient(system.client.node) as found:
        yield found
    system.wait_for_streams()


@pytest.fixture
def seen(system: System) -> Iterator[list[Any]]:
    """The margins that a plot of the progress of formulas shows."""
    node: Node = system.client.node
    found: list[Any] = []
    topic = '/stream_reasoning_engine/progress'
    subscription = node.create_subscription(
        FormulaProgress, topic, lambda message: found.append(message.margin), 10
    )
    yield found
    node.destroy_subscription(subscription)


def test_a_monitor_reports_the_margin(
    system: System, batteries: Batteries, client: FormulaClient, seen: list[Any]
) -> None:
    told: list[Progress] = []
    statuses: list[Any] = []
    node = system.client.node
    subscription = node.create_subscription(
        EvaluationStatusArray, f'{COORDINATOR}/evaluations', statuses.append, LATCHED
    )
    monitor = client.monitor(ALWAYS, on_feedback=told.append, margin=True)
    calm = Margin(-inf, 50.0, 'W')
    system.client.spin_until(
        lambda: any(each.margin and each.margin.upper == 50.0 for each in told), 'a margin'
    )
    margin = next(each.margin for each in told if each.margin and each.margin.upper == 50.0)
    assert (margin.lower, margin.upper, margin.unit) == (calm.lower, calm.upper, calm.unit)
    assert margin.atom in {f'Power[{u}] < 150' for u in batteries.power}
    system.client.spin_until(lambda: any(each.upper == 50.0 for each in seen), 'a plot')
    batteries.power['uav2'] = 142.5
    system.client.spin_until(
        lambda: bool(told) and told[-1].margin == Margin(-inf, 7.5, 'W', 'Power[uav2] < 150'),
        'a smaller margin',
    )
    system.client.spin_until(
        lambda: any(
            each.margin.upper == 7.5 and each.margin.unit == 'W'
            for array in statuses
            for each in array.evaluations
        ),
        'the status',
    )
    batteries.power['uav2'] = 160.0
    system.client.spin_until(monitor.outcome.done, 'the verdict')
    answer: Answer = monitor.outcome.result()
    assert answer.verdict is Verdict.FALSE
    assert answer.margin == Margin(-inf, -10.0, 'W', 'Power[uav2] < 150')
    node.destroy_subscription(subscription)


def test_the_margin_of_a_formula_that_was_not_decided(
    system: System, client: FormulaClient
) -> None:
    told: list[Progress] = []
    monitor = client.monitor(ALWAYS, on_feedback=told.append, margin=True)
    system.client.spin_until(
        lambda: any(each.margin and each.margin.upper == 50.0 for each in told), 'a margin'
    )
    monitor.cancel()
    system.client.spin_until(monitor.outcome.done, 'the end')
    answer: Answer = monitor.outcome.result()
    assert answer.error is not None
    assert answer.error.code is ExitCode.CANCELLED
    assert answer.margin is not None
    assert (answer.margin.upper, answer.margin.unit) == (50.0, 'W')


@pytest.mark.usefixtures('client')
@pytest.mark.parametrize('margin', [True, False])
def test_an_answer_has_the_margin_if_it_is_asked_for(system: System, margin: bool) -> None:  # noqa: FBT001
    response = system.client.call(
        EvaluateFormula,
        f'{COORDINATOR}/evaluate_formula',
        formula='Power[uav1] < 150',
        margin=margin,
    )
    assert response.verdict == 1
    found = response.margin
    expected = (50.0, 50.0, 'W', 'Power[uav1] < 150') if margin else (0.0, 0.0, '', '')
    assert (found.lower, found.upper, found.unit, found.atom) == expected
