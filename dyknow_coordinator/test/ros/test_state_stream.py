"""State streams that are replaced, are left, or whose evaluations end meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from functools import partial
from typing import Any
from unittest.mock import AsyncMock, MagicMock

import pytest

from dyknow_common import SECOND_NS, ExitCode, StreamConstraints
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    Grounding,
    KnownStream,
    KnownStreams,
)
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource
from dyknow_coordinator.grounding.state_specification import FormulaInputs
from dyknow_coordinator.ros.evaluation.state_stream import StateStream
from dyknow_coordinator.ros.evaluation.state_supervisor import StateSupervisor
from dyknow_stream_processing import Violation, ViolationKind

POWER = 'Power[uav1]'


def test_a_stream_that_was_destroyed_before_its_creation_is_not_created() -> None:
    """Otherwise nobody would destroy it: the formula was decided by a state of the former one."""
    context = MagicMock()
    stream = StateStream(context, 'states_2', MagicMock(), MagicMock())
    stream.destroy()
    with pytest.raises(CoordinationError, match='is not needed any more') as caught:
        asyncio.run(stream.create((), StreamConstraints()))
    assert caught.value.code is ExitCode.CANCELLED
    context.cleanup.keep_stream.assert_not_called()
    context.clients.create_stream.assert_not_called()


def test_a_stream_that_is_not_needed_any_more_is_destroyed_after_its_creation() -> None:
    """A request to destroy it might overtake the one to create it, and find nothing."""
    context = MagicMock()
    stream = StateStream(context, 'states_2', MagicMock(), MagicMock())

    async def create(*_: object) -> tuple[str, str]:
        stream.destroy()
        context.cleanup.destroy_stream.assert_not_called()
        return 'states_2', 'states_2/violations'

    context.clients.create_stream = create
    asyncio.run(stream.create((), StreamConstraints()))
    context.cleanup.destroy_stream.assert_called_once_with('states_2')
    context.node.create_subscription.assert_not_called()


class Elapsed(MagicMock):
    """A deadline that has passed."""

    def __await__(self) -> Iterator[None]:
        return iter(())


class Supervised:
    """A supervisor of states that are made of the first of some streams, and what it spawned."""

    def __init__(self, *streams: str) -> None:
        self.context = MagicMock()
        self.context.wall_time.return_value = self.context.wall_time_s.return_value = 0
        self.context.clients.evaluate_group = AsyncMock()
        self.context.clients.create_stream = create = AsyncMock()
        create.side_effect = self.create
        self.context.node.deadlines.after = lambda _: Elapsed()
        self.context.node.now.return_value = 0
        self.context.streams.known = KnownStreams([], lambda _: True)
        self.context.streams.known_until = 0
        self.received = {f'/{each}': 1 for each in 'abc'}
        self.spawned: list[Any] = []
        self.context.node.spawn = lambda *arguments: self.spawned.append(partial(*arguments))
        inputs = FormulaInputs(
            (), Grounding.AUTO, (POWER,), _candidates(*streams), {}, StreamConstraints()
        )
        self.observer = MagicMock()
        self.supervisor = StateSupervisor(self.context, 7, 'states_1', inputs, self.observer)
        self.supervisor._standby = MagicMock()
        self.supervisor._standby.take.return_value = None

    def create(self, name: str, *_: object) -> tuple[str, str]:
        """Report a stream, which has received messages of the topics."""
        made = KnownStream(name, topic=name, received=self.received)
        self.context.streams.known = KnownStreams([made], lambda _: True)
        return name, f'{name}/violations'

    def violate(self, stream: StateStream, name: str, kind: str, valid_time: int = 0) -> None:
        violation = Violation(name, kind, valid_time, valid_time, 0, 0, 'broken')
        self.supervisor._on_violation(stream, violation)

    def run(self) -> None:
        """Run what was spawned last."""
        asyncio.run(self.spawned.pop()())


def test_a_better_stream_that_comes_with_the_verdict_is_not_used() -> None:
    """Nobody would destroy the states that are made of it."""
    made = Supervised('b')
    made.supervisor.update_candidates(_candidates('a', 'b'))
    made.supervisor.end()
    made.run()
    made.context.clients.create_stream.assert_not_called()


def test_a_take_over_tells_from_when_on_former_states_are_doubtful() -> None:
    made = Supervised('a', 'b')
    standby = MagicMock(topic='/states_2', chosen=())
    made.supervisor._standby.take.return_value = standby  # type: ignore[attr-defined]
    for valid_time in (6, 5, 7):
        made.violate(made.supervisor.stream, 'a', ViolationKind.SOURCE, valid_time)
    made.run()
    ((_, kinds),) = made.context.clients.evaluate_group.call_args_list
    assert kinds == {'gap': True, 'doubtful_from': 5}


def test_a_take_over_after_a_better_stream_doubts_none_of_its_states() -> None:
    """A violation in the states that were left before made a gap in those of the better stream."""
    made = Supervised('b')
    supervisor = made.supervisor
    asyncio.run(supervisor.start())
    made.violate(supervisor.stream, 'states_1', ViolationKind.MAX_GAP, 3)
    supervisor.update_candidates(_candidates('a', 'b'))
    made.run()
    assert [each.stream for each in supervisor.chosen] == ['p_a']
    standby = MagicMock(topic='/states_3', chosen=())
    supervisor._standby.take.return_value = standby  # type: ignore[attr-defined]
    made.violate(supervisor.stream, 'p_a', ViolationKind.SOURCE, 9)
    made.run()
    kinds = made.context.clients.evaluate_group.call_args_list[-1].kwargs
    assert kinds == {'gap': True, 'doubtful_from': 9}


@pytest.mark.parametrize('name', ['b', '/b', 'states_1'])
def test_a_violation_of_a_stream_that_is_being_left_is_none_of_the_next(name: str) -> None:
    """It excluded the sources of the next one, and the supervisor returned to the broken one."""
    made = Supervised('b')
    supervisor, former = made.supervisor, made.supervisor.stream
    asyncio.run(supervisor.start())
    supervisor.update_candidates(_candidates('a', 'b'))
    made.run()
    (made_of,) = supervisor.chosen
    assert made_of.stream == 'p_a'
    made.violate(former, name, ViolationKind.MAX_GAP)
    assert not supervisor._session.choice.have_failed([made_of], 0)
    assert not supervisor._session.faults
    assert made.observer.set_phase.call_args.args == (EvaluationPhase.RUNNING,)


@pytest.mark.parametrize(
    ('event', 'is_excluded'),
    [
        ('silence', True),
        ('violation', True),
        ('loss', False),
        ('engine is lost', False),
        ('fault', False),
    ],
)
def test_a_better_stream_without_samples_replaces_none(event: str, is_excluded: bool) -> None:  # noqa: FBT001
    """It replaced the one in use, and the evaluation was interrupted when it was silent."""
    made = Supervised('b')
    supervisor, (better, _) = made.supervisor, _candidates('a', 'b').found
    asyncio.run(supervisor.start())
    supervisor.update_candidates(_candidates('a', 'b'))
    made.received = {}
    happened: list[float] = []

    def after(seconds: float) -> Elapsed:
        elapsed = Elapsed()
        elapsed.done.return_value = event == 'silence'
        if supervisor._next and seconds < 1 and event != 'silence' and not happened:
            happened.append(seconds)
            if event == 'violation':
                made.violate(supervisor._next, 'states_2', ViolationKind.MAX_GAP)
            elif event == 'loss':
                made.violate(supervisor._next, '/a', ViolationKind.LOST)
            elif event == 'engine is lost':
                supervisor._on_engine_lost(supervisor._next)
            else:
                supervisor._session.note_loss('b is lost')
        return elapsed

    made.context.node.deadlines.after = after
    asyncio.run(supervisor._prefer((better,)))
    assert bool(happened) == (event != 'silence')
    assert [each.stream for each in supervisor.chosen] == ['p_b']
    assert supervisor._session.choice.have_failed([better], 0) == is_excluded
    assert bool(supervisor._session.faults) == (event == 'fault')
    made.observer.add_event.assert_not_called()
    evaluated = made.context.clients.evaluate_group.call_args_list
    assert {call.args[2] for call in evaluated} == {'states_1'}
    made.context.cleanup.destroy_stream.assert_called_once()


@pytest.mark.parametrize('is_engine', [False, True])
def test_a_better_stream_that_is_lost_is_made_again_a_second_later(*, is_engine: bool) -> None:
    """If its topic loses messages all the time, it would be made and destroyed without end."""
    made = Supervised('b')
    supervisor = made.supervisor
    asyncio.run(supervisor.start())
    supervisor.update_candidates(_candidates('a', 'b'))

    def create(name: str, *_: object) -> tuple[str, str]:
        assert supervisor._next is not None
        if is_engine:
            supervisor._on_engine_lost(supervisor._next)
        else:
            made.violate(supervisor._next, '/a', ViolationKind.LOST)
        return made.create(name)

    made.context.clients.create_stream.side_effect = create
    made.run()
    assert [each.stream for each in supervisor.chosen] == ['p_b']
    for seconds, is_tried in ((0.9, False), (1.1, True)):
        made.context.wall_time.return_value = round(seconds * SECOND_NS)
        supervisor.improve()
        assert bool(made.spawned) == is_tried


@pytest.mark.parametrize('code', [ExitCode.UNAVAILABLE, ExitCode.INVALID_ARGUMENT])
def test_better_streams_are_not_at_fault_if_no_engine_can_make_their_states(code: ExitCode) -> None:
    """They were excluded, so a formula failed if its streams did within 10 s."""
    made = Supervised('b')
    supervisor, (better, _) = made.supervisor, _candidates('a', 'b').found
    asyncio.run(supervisor.start())
    made.context.clients.create_stream.side_effect = CoordinationError('no engine', code)
    supervisor.update_candidates(_candidates('a', 'b'))
    made.run()
    assert supervisor._session.choice.have_failed([better], 0) == (code != ExitCode.UNAVAILABLE)
    for seconds, is_tried in ((9, False), (11, True)):
        made.context.wall_time.return_value = seconds * SECOND_NS
        supervisor.improve()
        assert bool(made.spawned) == is_tried
    made.context.clients.create_stream.side_effect = made.create
    made.run()
    assert [each.stream for each in supervisor.chosen] == ['p_a']


@pytest.mark.parametrize('is_better', [False, True])
def test_an_unexpected_fault_while_streams_change_ends_the_formulas(*, is_better: bool) -> None:
    """They waited for other states until their timeout."""
    made = Supervised('b')
    supervisor = made.supervisor
    asyncio.run(supervisor.start())
    made.context.clients.create_stream.side_effect = RuntimeError('the middleware has no memory')
    if is_better:
        supervisor.update_candidates(_candidates('a', 'b'))
    else:
        made.violate(supervisor.stream, '/b', ViolationKind.LOST)
    made.context.fault.side_effect = str
    with pytest.raises(RuntimeError):
        made.run()
    made.observer.fail.assert_called_once_with('the middleware has no memory')


def test_a_stream_that_cannot_be_made_is_left_for_the_next() -> None:
    made = Supervised('a', 'b', 'c')
    supervisor, create = made.supervisor, made.context.clients.create_stream
    asyncio.run(supervisor.start())

    def refuse(name: str, specification: str, *_: object) -> tuple[str, str]:
        if '/b' in specification:
            raise CoordinationError("topic '/b' has no field 'x'")
        return name, f'{name}/violations'

    create.side_effect = refuse
    made.violate(supervisor.stream, 'a', ViolationKind.MAX_GAP)
    made.run()
    assert [each.stream for each in supervisor.chosen] == ['p_c']
    made.observer.fail.assert_not_called()


@pytest.mark.parametrize(
    ('reports', 'fault'),
    [
        # Each second: the samples made, until when, their delay, and the latest state that came.
        ([(each, each, 0, each) for each in range(20)], ''),
        ([(each, each, 0, min(each, 4)) for each in range(12)], 'although states are made'),
        ([(each, each, 0, 0) for each in range(12)], 'although states are made'),
        ([(each, each, 0, min(each, 4)) for each in range(11)], ''),
        ([(5 + (each > 3), each, 0, 3) for each in range(20)], ''),
        ([(each, each, 15, 5) for each in range(20)], ''),
        ([(each, each, 9, 5) for each in range(22)], 'although states are made'),
        ([(each, 7, 0, 8) for each in range(20)], ''),
        ([(5, each, 0, 4) for each in range(20)], ''),
        ([(None, each, 0, 4) for each in range(5)] + [(9, 9, 0, 4)] * 4, ''),
        ([(None, each, 0, 4) for each in range(6)], "stream 'states_2' is gone"),
        ([(None, each, 0, each) for each in range(9)], ''),
    ],
    ids=[
        'all arrive',
        'none arrives any more',
        'none has arrived',
        'for less than 5 s',
        'one sample, which is reported late',
        'behind former states',
        'behind former states at first',
        'time stands still at former states',
        'no samples',
        'the manager was restarted',
        'the manager knows none',
        'others arrive',
    ],
)
def test_states_that_do_not_arrive(reports: list[Any], fault: str) -> None:
    context = MagicMock()
    context.streams.engines = ('/engine',)
    stream = StateStream(context, 'states_2', MagicMock(), MagicMock())
    context.clients.create_stream = AsyncMock(return_value=('/states_2', '/states_2/violations'))
    asyncio.run(stream.create((), StreamConstraints()))
    found = ''
    for now, (samples, until, delay, latest) in enumerate(reports, start=1):
        made = (
            []
            if samples is None
            else [KnownStream('states_2', samples=samples, max_delay=delay * SECOND_NS)]
        )
        context.streams.known = KnownStreams(made, lambda _: True)
        context.streams.known_until = until * SECOND_NS
        context.wall_time_s.return_value = float(now)
        found = stream.arrival_fault(latest * SECOND_NS)
    assert found.endswith(fault) if fault else not found


def test_states_that_do_not_arrive_are_made_anew() -> None:
    """The formula went on without states, and nobody said so."""
    made = Supervised('a')
    supervisor = made.supervisor
    made.context.streams.engines = ('/engine',)
    asyncio.run(supervisor.start())
    made.context.streams.known = KnownStreams([], lambda _: True)
    for seconds in (1, 4, 7):
        assert not made.spawned
        made.context.wall_time_s.return_value = float(seconds)
        supervisor.note_progress(5)
    assert made.observer.set_phase.call_args.args == (EvaluationPhase.INTERRUPTED,)
    made.run()
    assert supervisor.stream.name != 'states_1'
    assert "stream 'states_1' is gone; states are made" in made.observer.add_event.call_args.args[0]


def _candidates(*streams: str) -> Candidates:
    return Candidates(
        tuple(
            FeatureSource(
                POWER, f'p_{each}', f'stream p_{each} = select x as "{POWER}" from "/{each}"'
            )
            for each in streams
        )
    )
