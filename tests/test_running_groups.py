"""Formula groups that are evaluated: formulas come and go, and so do their streams of states.

Which states count is tested without topics: in test_state_line and test_standby_states.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Callable, Iterator, Sequence
from itertools import count
from typing import Any, ClassVar

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import (
    ConstraintViolation,
    Domain,
    ExitStatus,
    Field,
    FormulaProgress,
    FormulaResult,
    Sample,
    UnknownFeature,
)

from dyknow_common.ros import VIOLATIONS
from services import LATCHED, Nodes, assert_refused, nanoseconds, time_of
from system import POLL

ENGINE = 'stream_reasoning_engine'
SECOND = 1_000_000_000
NOBODY = 2_000_000_000
CALM = 'forall u in UAV: always Power[u] < 150'
SOON = 'forall u in UAV: eventually[0 s, 20 s] Power[u] > 150'
VEHICLES = [Domain(sort='UAV', objects=['uav1'])]
NUMBERS = count()


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """The reasoning engine alone, which does not wait for long."""
    limits = {'violation_patience': 1.0, 'orphan_limit': 5.0, 'progress_period': 0.1}
    with Nodes(tmp_path_factory.mktemp('groups'), stream_reasoning_engine=limits) as nodes:
        yield nodes


@pytest.fixture(autouse=True)
def clean(nodes: Nodes) -> Iterator[None]:
    """No group, topic or subscription of a test is left to the next one."""
    yield
    while Group.made:
        nodes.call(ENGINE, srv.FormulaGroupDestroy, formula_group_id=Group.made.pop())
    while States.publishers:
        nodes.client.node.destroy_publisher(States.publishers.pop())
    nodes.stop_collecting()


class States:
    """A stream of states that a test publishes."""

    publishers: ClassVar[list[Any]] = []

    def __init__(self, nodes: Nodes, topic: str = '') -> None:
        self.topic = topic or f'/states/number_{next(NUMBERS)}'
        self._nodes = nodes
        node = nodes.client.node
        self._states = node.create_publisher(Sample, self.topic, 1000)
        self._violations = node.create_publisher(
            ConstraintViolation, f'{self.topic}/violations', VIOLATIONS
        )
        self.publishers.extend((self._states, self._violations))

    @property
    def is_heard(self) -> bool:
        return (
            self._states.get_subscription_count() > 0
            and self._violations.get_subscription_count() > 0
        )

    @property
    def is_left(self) -> bool:
        return (
            self._states.get_subscription_count() == 0
            and self._violations.get_subscription_count() == 0
        )

    def publish(self, powers: dict[int, float]) -> None:
        """The power at each of some seconds."""
        for seconds, power in powers.items():
            field = Field(type='float', name='Power[uav1]', value=str(power))
            self._states.publish(Sample(valid_time=time_of(seconds * SECOND), fields=[field]))

    def break_constraint(self, available_time: int | None = None) -> None:
        now = self._nodes.client.node.get_clock().now().nanoseconds
        available = now if available_time is None else available_time
        self._violations.publish(
            ConstraintViolation(
                stream_name='power',
                valid_time=time_of(12 * SECOND),
                available_time=time_of(available),
                message="stream 'power': no sample after 12 s",
            )
        )


class Group:
    """A formula group, evaluated."""

    made: ClassVar[list[int]] = []

    def __init__(
        self, nodes: Nodes, states: States, *formulas: str, unknown: Sequence[UnknownFeature] = ()
    ) -> None:
        self._nodes = nodes
        made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='power')
        self.number = made.formula_group_id
        self.made.append(self.number)
        self.topic = f'/results/of_{self.number}'
        self.results: list[Any] = nodes.collect(FormulaResult, self.topic, LATCHED)
        self._progress = nodes.collect(FormulaProgress, f'/{ENGINE}/progress')
        self.formulas = [self.add(formula) for formula in formulas]
        self.evaluate(states, domains=VEHICLES, unknown=list(unknown), result_topic=self.topic)
        self.wait(lambda: states.is_heard, 'the states are heard')

    def wait(self, is_so: Callable[[], Any], what: str) -> None:
        self._nodes.client.spin_until(is_so, what)

    def add(self, formula: str, since: int = 0) -> int:
        added = self._nodes.obtain(
            ENGINE,
            srv.FormulaGroupAddFormula,
            formula_group_id=self.number,
            formula_name=formula,
            formula=formula,
            since=time_of(since * SECOND),
        )
        return int(added.formula_id)

    def evaluate(self, states: States, **fields: Any) -> None:
        self._nodes.obtain(
            ENGINE,
            srv.FormulaGroupEvaluate,
            formula_group_id=self.number,
            state_stream=states.topic,
            **fields,
        )

    def progressed(self, formula_id: int, states: int) -> Any:
        """The report that some states have been progressed."""

        def found() -> list[Any]:
            return [
                report for report in self._reports(formula_id) if report.states_progressed == states
            ]

        self.wait(found, f'{states} states')
        return found()[0]

    def last_report(self, formula_id: int) -> Any:
        """The report that no other one follows."""

        def found() -> list[Any]:
            return [each for each in self._reports(formula_id) if each.is_last]

        self.wait(found, 'the last report')
        assert found() == self._reports(formula_id)[-1:]
        return found()[0]

    def events(self, formula_id: int) -> list[str]:
        """All that was reported to have happened."""
        return [event for report in self._reports(formula_id) for event in report.events]

    def _reports(self, formula_id: int) -> list[Any]:
        return [
            report
            for report in self._progress
            if report.formula_group_id == self.number and report.formula_id == formula_id
        ]

    def result(self) -> Any:
        """The only result."""
        self.wait(lambda: self.results, 'the result')
        assert len(self.results) == 1
        return self.results[0]

    def remove(self, formula_id: int) -> Any:
        return self._nodes.call(
            ENGINE,
            srv.FormulaGroupRemoveFormula,
            formula_group_id=self.number,
            formula_id=formula_id,
        ).exit_status


def test_formulas_come_and_go(nodes: Nodes) -> None:
    states = States(nodes)
    group = Group(nodes, states, CALM)
    states.publish({10: 100.0})
    group.progressed(group.formulas[0], 1)
    later = group.add(CALM)
    report = group.progressed(later, 0)
    assert report.residual_formula.startswith('forall u')
    assert report.latest_valid_time.sec == 0
    assert group.remove(group.formulas[0]).code == ExitStatus.SUCCESS
    assert_refused(group.remove(group.formulas[0]), ExitStatus.NOT_FOUND, 'no formula 1')
    states.publish({11: 100.0})
    assert group.progressed(later, 1).latest_valid_time.sec == 11
    states.publish({12: 160.0})
    result = group.result()
    assert (result.formula_id, result.verdict) == (later, FormulaResult.FALSE)
    known = group.add('forall u in UAV: u = u')
    group.wait(lambda: len(group.results) > 1, 'the second result')
    assert group.results[1].formula_id == known
    assert group.results[1].verdict == FormulaResult.TRUE
    assert nanoseconds(group.results[1].decided_at) == 0


def test_a_formula_begins_with_the_first_state_since_a_time(nodes: Nodes) -> None:
    states = States(nodes)
    group = Group(nodes, states, SOON)
    states.publish({10: 100.0})
    group.progressed(group.formulas[0], 1)
    waiting = group.add(CALM, since=12)
    states.publish({11: 160.0})
    group.progressed(group.formulas[0], 2)
    assert group.progressed(waiting, 0).latest_valid_time.sec == 0
    states.publish({12: 100.0})
    assert group.progressed(waiting, 1).latest_valid_time.sec == 12
    states.publish({13: 160.0})
    group.wait(lambda: len(group.results) > 1, 'the second result')
    assert nanoseconds(group.results[1].decided_at) == 13 * SECOND
    assert group.last_report(waiting).states_progressed == 2


def test_a_formula_whose_sort_has_no_domain_is_refused(nodes: Nodes) -> None:
    group = Group(nodes, States(nodes), CALM)
    formula = 'forall b in Boat: always Power[b] < 150'
    answer = nodes.call(
        ENGINE, srv.FormulaGroupAddFormula, formula_group_id=group.number, formula=formula
    )
    assert_refused(answer.exit_status, ExitStatus.INVALID_ARGUMENT, 'Boat', 'UAV')


def test_reports_tell_what_is_presumably_false(nodes: Nodes) -> None:
    states = States(nodes)
    group = Group(nodes, states, CALM, SOON)
    states.publish({10: 100.0})
    calm, soon = (group.progressed(each, 1) for each in group.formulas)
    assert (calm.presumably_false, soon.presumably_false) == (False, True)


def test_the_last_report_on_a_formula_tells_of_all_states(nodes: Nodes) -> None:
    states = States(nodes)
    group = Group(nodes, states, CALM, SOON)
    calm, soon = group.formulas
    states.publish({10: 100.0, 11: 100.0, 12: 160.0})
    group.wait(lambda: len(group.results) > 1, 'both results')
    response = group.add('eventually[0 s, 20 s] Power[uav1] > 150')
    states.publish({13: 100.0, 14: 160.0})
    group.wait(lambda: len(group.results) > 2, 'the third result')
    open_one = group.add('Power[uav1] < 150 -> eventually[0 s, 20 s] Power[uav1] > 150')
    group.add('eventually[0 s, 20 s] Power[uav1] < 50')
    states.publish({15: 100.0, 16: 40.0})
    group.wait(lambda: len(group.results) > 3, 'the fourth result')
    assert group.remove(open_one).code == ExitStatus.SUCCESS
    expected = {
        calm: (3, 12, True),
        soon: (3, 12, False),
        response: (2, 14, False),
        open_one: (2, 16, True),
    }
    for formula, numbers in expected.items():
        last = group.last_report(formula)
        found = last.states_progressed, last.latest_valid_time.sec, last.presumably_false
        assert found == numbers


def test_going_over_loses_no_state(nodes: Nodes) -> None:
    former, new = States(nodes), States(nodes)
    group = Group(nodes, former, CALM, 'always[0 s, 4 s] Power[uav1] < 150')
    former.publish({10: 100.0, 11: 100.0})
    group.progressed(1, 2)
    group.evaluate(new)
    group.wait(lambda: new.is_heard, 'the new states are heard')
    new.publish({13: 999.0, 14: 100.0, 15: 100.0})
    former.publish({12: 100.0})
    assert group.progressed(1, 3).latest_valid_time.sec == 12
    former.publish({13: 100.0})
    group.wait(lambda: former.is_left, 'the former states are left')
    assert group.result().verdict == FormulaResult.TRUE
    assert nanoseconds(group.results[0].decided_at) == 14 * SECOND
    assert 'missing' not in group.results[0].explanation
    assert group.progressed(1, 6).latest_valid_time.sec == 15


def test_going_over_with_a_gap(nodes: Nodes) -> None:
    former, new = States(nodes), States(nodes)
    group = Group(nodes, former, CALM, SOON)
    former.publish({10: 100.0})
    group.progressed(1, 1)
    group.evaluate(new, gap=True)
    group.wait(lambda: new.is_heard and former.is_left, 'the new states are heard')
    new.publish({9: 999.0, 20: 100.0, 30: 100.0})
    failed = group.result()
    assert failed.formula_id == group.formulas[1]
    assert_refused(
        failed.exit_status,
        ExitStatus.CONSTRAINT_VIOLATION,
        'missing between 10.000 s and 20.000 s',
    )
    new.publish({31: 160.0})
    group.wait(lambda: len(group.results) > 1, 'the other result')
    assert group.results[1].verdict == FormulaResult.FALSE
    assert 'missing between 10.000 s and 20.000 s' in group.results[1].explanation


def test_states_come_from_another_publisher(nodes: Nodes) -> None:
    """An engine that was killed and is back at once gives its streams the same topics."""
    former = States(nodes)
    group = Group(nodes, former, CALM, SOON)
    former.publish({10: 100.0})
    group.progressed(1, 1)
    new = States(nodes, former.topic)
    group.wait(lambda: new.is_heard, 'the new states are heard')
    new.publish({20: 100.0, 30: 100.0})
    failed = group.result()
    assert failed.formula_id == group.formulas[1]
    missing = 'missing between 10.000 s and 20.000 s'
    assert_refused(failed.exit_status, ExitStatus.CONSTRAINT_VIOLATION, missing)
    assert group.progressed(1, 3).latest_valid_time.sec == 30
    (event,) = group.events(1)
    assert 'recreated' in event
    assert missing in event
    new.publish({31: 160.0})
    group.wait(lambda: len(group.results) > 1, 'the other result')
    assert group.results[1].verdict == FormulaResult.FALSE


@pytest.mark.parametrize(
    ('fields', 'words'),
    [
        ({'domains': [Domain(sort='UAV', objects=['uav2'])]}, ('UAV', 'uav1')),
        ({'domains': [Domain(sort='Boat', objects=['boat1'])]}, ('Boat', 'none')),
        ({'result_topic': '/results/elsewhere'}, ('/results/of_', '/results/elsewhere')),
        ({'state_stream': '/two words'}, ('state_stream', '/two words')),
    ],
)
def test_going_over_to_something_else_is_refused(
    nodes: Nodes, fields: dict[str, Any], words: tuple[str, ...]
) -> None:
    states = States(nodes)
    group = Group(nodes, states, CALM)
    wanted = {'state_stream': '/states/other', **fields}
    answer = nodes.call(ENGINE, srv.FormulaGroupEvaluate, formula_group_id=group.number, **wanted)
    assert_refused(answer.exit_status, ExitStatus.INVALID_ARGUMENT, *words)
    assert states.is_heard
    states.publish({10: 160.0})
    assert group.result().verdict == FormulaResult.FALSE


def test_nobody_helps_after_a_violation(nodes: Nodes) -> None:
    states = States(nodes)
    states.break_constraint(available_time=SECOND)
    group = Group(nodes, states, CALM)
    states.publish({10: 100.0})
    group.progressed(1, 1)
    states.break_constraint()
    assert_refused(
        group.result().exit_status,
        ExitStatus.CONSTRAINT_VIOLATION,
        "at 12.000 s: stream 'power': no sample after 12 s",
    )
    late = group.add(CALM)
    group.wait(lambda: len(group.results) > 1, 'the formula that came too late')
    assert group.results[1].formula_id == late
    assert group.results[1].exit_status.code == ExitStatus.CONSTRAINT_VIOLATION


@pytest.mark.parametrize('gap', [False, True])
def test_other_states_help_after_a_violation(nodes: Nodes, gap: bool) -> None:  # noqa: FBT001
    former, new = States(nodes), States(nodes)
    group = Group(nodes, former, CALM)
    former.publish({10: 100.0})
    group.progressed(1, 1)
    former.break_constraint()
    group.evaluate(new, gap=gap)
    group.wait(lambda: new.is_heard and former.is_left, 'the new states are heard')
    new.publish({20: 100.0, 21: 160.0})
    assert nanoseconds(group.result().decided_at) == 21 * SECOND
    assert 'missing between 10.000 s and 20.000 s' in group.results[0].explanation


def known_groups(nodes: Nodes) -> str:
    answer = nodes.call(ENGINE, srv.FormulaGroupExtractSymbols, formula_group_id=NOBODY)
    return str(answer.exit_status.message)


def test_orphans_are_destroyed(nodes: Nodes) -> None:
    made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='forgotten')
    forgotten = str(made.formula_group_id)
    assert forgotten in known_groups(nodes)
    made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='unheard')
    states = States(nodes)
    nodes.obtain(
        ENGINE,
        srv.FormulaGroupEvaluate,
        formula_group_id=made.formula_group_id,
        state_stream=states.topic,
        result_topic='/results/unheard',
    )
    listened = Group(nodes, States(nodes), CALM)
    nodes.client.spin_until(lambda: states.is_heard, 'the states are heard')
    nodes.client.spin_until(lambda: states.is_left, 'the group that is not heard is destroyed')
    nodes.client.spin_until(
        lambda: forgotten not in known_groups(nodes), 'the other one is, too', pause=POLL
    )
    assert str(made.formula_group_id) not in known_groups(nodes)
    assert str(listened.number) in known_groups(nodes)


def test_a_group_is_no_orphan_while_the_engine_is_stopped(nodes: Nodes) -> None:
    """A request may wait that was sent meanwhile."""
    made = nodes.obtain(ENGINE, srv.FormulaGroupCreate, formula_group_name='waiting')
    nodes.processes[ENGINE].send_signal(signal.SIGSTOP)
    added = nodes.request(
        ENGINE,
        srv.FormulaGroupAddFormula,
        formula_group_id=made.formula_group_id,
        formula_name='calm',
        formula=CALM,
    )
    nodes.client.wait(7.0)  # Longer than the limit of orphans.
    nodes.processes[ENGINE].send_signal(signal.SIGCONT)
    nodes.client.spin_until(added.done, 'the answer')
    assert added.result().exit_status.code == ExitStatus.SUCCESS, added.result().exit_status


def test_a_verdict_holds_whatever_an_unknown_power_was(nodes: Nodes) -> None:
    states = States(nodes)
    power = UnknownFeature(name='Power', lower=0.0, upper=500.0)
    group = Group(nodes, states, CALM, unknown=[power])
    states.publish({10: 100.0, 11: math.nan})
    report = group.progressed(group.formulas[0], 2)
    assert 'undecided for want of Power[uav1] since 11.000 s' in report.residual_formula
    states.publish({12: 160.0})
    result = group.result()
    assert result.verdict == FormulaResult.FALSE
    assert 'whatever Power[uav1] since 11.000 s was' in result.explanation
