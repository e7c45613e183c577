"""The states of a formula of a guard, from one evaluation after the other, against its gate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_coordinator.ros.reporting.evaluation_messages import status_to_message
from dyknow_reactions.guard.command_formulas import CommandFormula, CommandStates
from dyknow_reactions.guard.gate import Gate, GateReports, GateState
from dyknow_reactions.guard.watched_formula import WatchedStates
from dyknow_reactions.ros.guard import formula_states
from dyknow_reactions.ros.guard.formula_states import RESUME_TIMEOUT_S, FormulaStates, StateServices
from dyknow_reasoning import ALL_KNOWN, ReadStream
from dyknow_reasoning.ros.state_subscription import State
from dyknow_stream_processing import Sample

NAME, TIMEOUT = '/guard: f', 1000
RUNNING = EvaluationStatus(
    NAME, '', EvaluationPhase.RUNNING, 1, formula_group_id=1, state_stream='s1'
)


class Stream(ReadStream[State]):
    """Instead of a `StateSubscription`, by the name of its topic."""

    latest: Stream

    def __init__(self, _node: object, topic: str, on_state: Any, _on_breach: Any) -> None:
        super().__init__()
        self.topic, self._on_state = topic, on_state
        Stream.latest = self

    def publish(self, valid_time: int, loss: str = '', **values: float) -> None:
        self._on_state(self, State(valid_time, Sample(valid_time, valid_time, values), loss))

    def destroy(self) -> None:
        """End it."""


class Guarded:
    """A gate with one formula, the coordinator's reports on it, and a clock."""

    def __init__(self, formula: str, command: CommandFormula | None = None) -> None:
        self.now, self.cancelled = 0, 0
        self.due: list[tuple[float, Callable[[object], None]]] = []
        self.gate = Gate(['f'], [], TIMEOUT, latch=False)
        reports = GateReports(
            self.gate, lambda: self.now, lambda valid: max(self.now - valid, 0), lambda _: None
        )
        receiver = CommandStates('f', command, reports) if command else WatchedStates('f', reports)
        node: Any = SimpleNamespace(
            now=lambda: self.now, spawn=self._spawn, deadlines=SimpleNamespace(after=self._after)
        )
        client: Any = SimpleNamespace(monitor=lambda *_, **__: SimpleNamespace(cancel=self._cancel))
        services = StateServices(node, client, None)  # type: ignore[arg-type]
        self._states = FormulaStates(services, formula, NAME, receiver, every_state=True)
        self._status = replace(RUNNING, formula=formula)
        self.report()

    def _spawn(self, function: Callable[..., Any], *arguments: object) -> None:
        with pytest.raises(StopIteration):
            function(*arguments).send(None)

    def _after(self, seconds: float) -> Any:
        return SimpleNamespace(add_done_callback=lambda each: self.due.append((seconds, each)))

    def _cancel(self) -> None:
        self.cancelled += 1

    def report(self, **changes: Any) -> None:
        """Report the evaluation of the coordinator."""
        self._status = replace(self._status, **changes)
        self._states.note_evaluations([status_to_message(self._status)])

    def publish(self, valid_time: int, x: float, loss: str = '') -> None:
        """Publish a state of the latest stream."""
        self.now = max(self.now, valid_time)
        Stream.latest.publish(valid_time, loss, x=x)

    @property
    def is_open(self) -> bool:
        self.gate.update(self.now)
        return self.gate.state is GateState.OPEN


@pytest.fixture(autouse=True)
def objects(monkeypatch: pytest.MonkeyPatch) -> None:
    async def domains(*_: object) -> dict[str, tuple[str, ...]]:
        return {}

    async def unknown(*_: object) -> object:
        return ALL_KNOWN

    monkeypatch.setattr(formula_states, 'StateSubscription', Stream)
    monkeypatch.setattr(formula_states, 'objects_of', domains)
    monkeypatch.setattr(formula_states, 'unknown_of', unknown)


def test_a_formula_about_the_past_that_lacks_states_is_asked_anew() -> None:
    """Only the guard lacks them, so the evaluation goes on."""
    guarded = Guarded('x - prev(x) < 3')
    for valid_time in (100, 200):
        guarded.publish(valid_time, 1.0)
    assert guarded.is_open
    guarded.publish(300, 1.0, '2 states were lost')
    assert 'states that are missing' in guarded.gate.reason
    guarded.publish(400, 1.0)
    guarded.report()
    assert not guarded.is_open
    ((seconds, ask_anew),) = guarded.due
    assert seconds == RESUME_TIMEOUT_S
    ask_anew(None)
    assert guarded.cancelled == 1
    guarded.report(started=2)
    for valid_time in (500, 600):
        guarded.publish(valid_time, 1.0)
    assert guarded.is_open


@pytest.mark.parametrize('first', [100, 200])
def test_a_recreated_stream_begins_with_states_that_do_not_count(first: int) -> None:
    guarded = Guarded('x < 3')
    for valid_time in (100, 200):
        guarded.publish(valid_time, 1.0)
    for valid_time in range(first, 300, 100):
        loss = 'the state stream was recreated' if valid_time == first else ''
        guarded.publish(valid_time, 5.0, loss)
        assert guarded.is_open
    guarded.publish(300, 5.0)
    assert not guarded.is_open
    guarded.publish(400, 1.0)
    assert guarded.is_open
    assert not guarded.cancelled


def test_another_stream_begins_with_states_that_do_not_count() -> None:
    guarded = Guarded('x < 3')
    for valid_time, x in ((100, 1.0), (200, 5.0)):
        guarded.publish(valid_time, x)
    guarded.report(state_stream='s2')
    assert Stream.latest.topic == 's2'
    guarded.publish(150, 1.0)
    assert not guarded.is_open
    guarded.publish(300, 1.0)
    assert guarded.is_open


@pytest.mark.parametrize('change', [{}, {'started': 2}, {'formula_group_id': 2}])
def test_another_stream_of_the_same_evaluation_ends_no_obligation(change: dict[str, int]) -> None:
    guarded = Guarded('x < 0 -> always[0 ns, 300 ns] x < 5')
    for valid_time, x in ((100, -1.0), (200, 1.0)):
        guarded.publish(valid_time, x)
    guarded.report(state_stream='s2', **change)
    guarded.publish(300, 7.0)
    assert guarded.is_open is bool(change)
    guarded.publish(400, 7.0)
    assert guarded.is_open


def test_the_states_of_another_group_count_from_the_first_on() -> None:
    """A simulation that is set back ends the evaluation, and has other states earlier."""
    guarded = Guarded('x < 3')
    guarded.publish(200, 1.0)
    guarded.report(started=2, formula_group_id=2, state_stream='s2')
    guarded.publish(100, 5.0)
    assert not guarded.is_open


def test_a_recreated_stream_does_not_bring_back_old_values_for_commands() -> None:
    command = CommandFormula('"/c".v > 0 -> x < 3', '/c', {})
    guarded = Guarded(command.state_formula, command)
    for valid_time, x, loss in ((100, 1.0, ''), (200, 5.0, ''), (150, 1.0, 'recreated')):
        guarded.publish(valid_time, x, loss)
    assert command.refusal(1, {'"/c".v': 1.0})
    guarded.publish(300, 1.0)
    assert not command.refusal(2, {'"/c".v': 1.0})


@pytest.mark.parametrize('phase', ['GROUNDING', 'RUNNING'])
def test_an_evaluation_that_begins_again_with_other_objects(phase: str) -> None:
    guarded = Guarded('x < 3')
    guarded.publish(100, 1.0)
    stream = Stream.latest
    guarded.report(
        phase=EvaluationPhase[phase],
        formula_group_id=2,
        state_stream='s2' if phase == 'RUNNING' else '',
    )
    assert not guarded.is_open
    assert guarded.gate.reason == 'f: its objects have changed'
    stream.publish(200, x=1.0)
    assert not guarded.is_open
    guarded.report(phase=EvaluationPhase.RUNNING, state_stream='s2')
    guarded.publish(300, 1.0)
    assert guarded.is_open
