"""The states of a group.

Changes of streams: a gap exactly if a state may be missing, no state is used twice. The last states
of formulas that are removed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from typing import Any, Self
from unittest import mock

import pytest
from dyknow_interfaces.msg import ConstraintViolation
from hypothesis import example, given
from hypothesis import strategies as st

from dyknow_common.ros import nanoseconds_to_time, time_to_nanoseconds
from dyknow_reasoning import FormulaGroup, ReasoningError
from dyknow_reasoning.ros import group_evaluation
from dyknow_reasoning.ros.group_evaluation import GroupEvaluation
from dyknow_reasoning.ros.state_subscription import State, StateSubscription
from dyknow_reasoning.state_line import HAND_OVER_LIMIT_NS
from dyknow_stream_processing import Sample, ViolationKind
from dyknow_stream_processing.ros import sample_to_message


def run_to_end(coroutine: Coroutine[Any, Any, Any]) -> None:
    """Run a coroutine that waits for nothing: an event loop takes longer than all else here."""
    with pytest.raises(StopIteration):
        coroutine.send(None)


class Group:
    """A group whose streams of states a test feeds, and what it progresses."""

    def __init__(self) -> None:
        self.progressed: list[int | str] = []
        group = FormulaGroup()
        group.add_formula('calm', 'always power < 150')
        progress, gap = group.progress, group.gap

        def note(valid_time: int, fields: Any) -> Any:
            self.progressed.append(valid_time)
            return progress(valid_time, fields)

        def note_gap() -> None:
            self.progressed.append('gap')
            gap()

        group.progress, group.gap = note, note_gap  # type: ignore[method-assign]
        node, background = mock.MagicMock(), mock.MagicMock()
        self._clock = node.wall_clock.now.return_value
        self._clock.nanoseconds = node.now.return_value = 0
        node.resolve_topic_name = lambda topic: topic
        self._spawned: deque[Any] = deque()
        node.spawn = lambda function, *arguments: self._spawned.append(function(*arguments))

        async def run(function: Callable[[], Any], **_: Any) -> Any:
            return function()

        background.run = run
        self.streams: dict[str, StateSubscription] = {}
        self.reports = mock.MagicMock()
        self.evaluation = GroupEvaluation(
            node, 1, 'group', group, background, self.reports, mock.MagicMock()
        )

        def subscribe(*arguments: Any) -> StateSubscription:
            with mock.patch(f'{StateSubscription.__module__}.DirectSubscription'):
                made = StateSubscription(*arguments)
            self.streams[made.topic] = made
            return made

        with mock.patch.object(group_evaluation, 'DirectPublisher'):
            self._patch = mock.patch.object(group_evaluation, 'StateSubscription', subscribe)
            self._patch.start()
            run_to_end(self.evaluation.begin({}, '/former', '/results'))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._patch.stop()

    def state(self, topic: str, valid_time: int, loss: str = '') -> None:
        self.receive(topic, valid_time, loss)
        self.drain()

    def receive(self, topic: str, valid_time: int, loss: str = '') -> None:
        """Receive a state, which waits if the group is busy."""
        stream = self.streams[topic]
        sample = Sample(valid_time, valid_time, {'power': 100.0})
        stream._on_state(stream, State(valid_time, sample, loss))

    def wait(self, duration: int) -> None:
        """Let time pass, and the engine supervise its groups."""
        self._clock.nanoseconds += duration
        self.evaluation.change_if_due()

    def violate(self, topic: str, valid_time: int, kind: str = 'max_delay') -> None:
        stamp = nanoseconds_to_time(valid_time)
        message = ConstraintViolation(constraint=kind, valid_time=stamp, available_time=stamp)
        self.streams[topic]._on_violation(message, None)

    def take_over(self, *, gap: bool = False, doubtful_from: int = 0) -> None:
        change = self.evaluation.change_stream(
            {}, '/standby', '', gap=gap, doubtful_from=doubtful_from
        )
        run_to_end(change)
        self.drain()

    def drain(self, steps: int = 1_000) -> None:
        """Do the work that slow steps leave to the background, at most so many of them."""
        while self._spawned and steps:
            run_to_end(self._spawned.popleft())
            steps -= 1


@pytest.fixture
def group() -> Any:
    with Group() as made:
        run_to_end(made.evaluation.set_standby('/standby'))
        yield made


@dataclass
class Reference:
    """The states in the order of a take-over, kept as all that there are."""

    former: list[int] = field(default_factory=list)
    standby: list[int] = field(default_factory=list)

    def expected(self, later: list[int]) -> list[int | str]:
        used = [each for each in [*self.standby, *later] if each > max(self.former, default=-1)]
        is_complete = not self.former or (self.standby and self.standby[0] <= self.former[-1])
        return [*self.former, *([] if is_complete else ['gap']), *used]


def test_a_stream_that_falls_silent_while_it_is_left() -> None:
    with Group() as made:
        made.state('/former', 1)
        run_to_end(made.evaluation.change_stream({}, '/better', '', gap=False))
        made.wait(HAND_OVER_LIMIT_NS)  # Without a state of the other one, it is no better.
        made.state('/former', 2)
        run_to_end(made.evaluation.change_stream({}, '/better', '', gap=False))
        for valid_time in (3, 4):
            made.state('/better', valid_time)
        made.wait(HAND_OVER_LIMIT_NS - 1)
        assert made.progressed == [1, 2]
        made.wait(1)
        made.state('/better', 5)
        assert made.progressed == [1, 2, 'gap', 3, 4, 5]


# Requests by the topic of the next stream, and states by their topic and valid time.
HAND_OVERS: dict[str, tuple[list[str | tuple[str, int]], list[int]]] = {
    'to states that are behind': (
        [('/former', 2), '/better', *(('/better', each) for each in (1, 2, 3))],
        [2, 3],
    ),
    'to a third stream': (
        [
            *(('/former', 1), '/better', ('/better', 2)),
            *('/best', ('/best', 2), ('/former', 2), ('/best', 3)),
        ],
        [1, 2, 3],
    ),
    'back to the stream in use': (
        [('/former', 1), '/better', '/former', ('/former', 2), ('/better', 2), ('/better', 3)],
        [1, 2],
    ),
}


@pytest.mark.parametrize('name', HAND_OVERS)
def test_hand_overs(name: str) -> None:
    steps, expected = HAND_OVERS[name]
    with Group() as made:
        for step in steps:
            if isinstance(step, tuple):
                made.state(*step)
            else:
                run_to_end(made.evaluation.change_stream({}, step, '', gap=False))
        assert made.progressed == expected


def test_a_request_ends_a_hand_over() -> None:
    with Group() as made:
        made.state('/former', 2)
        run_to_end(made.evaluation.change_stream({}, '/better', '', gap=False))
        made.state('/better', 3)
        run_to_end(made.evaluation.change_stream({}, '/better', '', gap=True))
        assert made.progressed == [2, 'gap', 3]


@pytest.mark.parametrize(('valid_time', 'expected'), [(3, [1, 2, 3]), (2, [1, 2, 'gap', 3])])
def test_a_violation_that_waits_while_the_next_stream_catches_up(
    valid_time: int, expected: list[int | str]
) -> None:
    with Group() as made, mock.patch.object(group_evaluation, 'HEAVY_STEP_S', -1.0):
        made.state('/former', 1)
        run_to_end(made.evaluation.change_stream({}, '/better', '', gap=False))
        made.receive('/former', 2)
        made.receive('/better', 2)
        made.violate('/former', valid_time)
        made.drain()
        made.state('/better', 3)
        assert made.progressed == expected


STEPS = st.lists(st.tuples(st.booleans(), st.integers(1, 4)), min_size=4, max_size=30)


@given(STEPS, st.lists(st.integers(1, 3), max_size=3), st.integers(0, 9))
def test_states_after_a_take_over(
    steps: list[tuple[bool, int]], later: list[int], begin: int
) -> None:
    with Group() as made:
        run_to_end(made.evaluation.set_standby('/standby'))
        reference = Reference()
        times = {'/former': 0, '/standby': begin}
        for is_former, distance in steps:
            topic = '/former' if is_former else '/standby'
            times[topic] += distance
            (reference.former if is_former else reference.standby).append(times[topic])
            made.state(topic, times[topic])
        made.take_over()
        after = [times['/standby'] + sum(later[: count + 1]) for count in range(len(later))]
        for each in after:
            made.state('/standby', each)
        assert made.progressed == reference.expected(after)


@given(
    st.lists(st.tuples(st.booleans(), st.integers(0, 2)), min_size=4, max_size=30),
    st.integers(1, 9),
)
@example([(False, 0), (True, 2), (False, 0), (False, 0), (True, 0), (True, 0), (False, 9)], 3)
def test_states_that_wait_while_a_better_stream_catches_up(
    steps: list[tuple[bool, int]], begin: int
) -> None:
    """Each state is slow; both streams have the same states, the better one from `begin` on."""
    with Group() as made, mock.patch.object(group_evaluation, 'HEAVY_STEP_S', -1.0):
        made.state('/former', 1)
        run_to_end(made.evaluation.change_stream({}, '/better', '', gap=False))
        latest = {'/former': 1, '/better': begin - 1}
        ends = [(is_former, 0) for is_former in (True, False) for _ in range(30)]
        for is_former, work in [*steps, *ends]:
            topic = '/former' if is_former else '/better'
            if latest[topic] < 30:
                latest[topic] += 1
                made.receive(topic, latest[topic])
            made.drain(work)
        made.drain()
        assert made.progressed == list(range(1, 31))


@pytest.mark.parametrize(
    ('valid_time', 'kind', 'expected'),
    [
        (3, ViolationKind.SAMPLE_PERIOD, [1, 2, 3, 4]),
        (2, ViolationKind.MAX_DELAY, [1, 2, 'gap', 3, 4]),
        (9, ViolationKind.CLOCK, [1, 2, 'gap', 3, 4]),
    ],
)
@pytest.mark.parametrize('gap', [False, True])
def test_states_that_a_violation_makes_doubtful(
    group: Group,
    valid_time: int,
    kind: ViolationKind,
    expected: list[int | str],
    gap: bool,  # noqa: FBT001
) -> None:
    for each in (1, 2):
        group.state('/former', each)
    for each in (1, 2, 3, 4):
        group.state('/standby', each)
    group.violate('/former', valid_time, kind)
    group.state('/former', 3)
    doubtful_from = 0 if kind == ViolationKind.CLOCK else valid_time
    group.take_over(gap=gap, doubtful_from=doubtful_from)
    assert group.progressed == expected
    group.state('/standby', 5)
    assert group.progressed == [*expected, 5]


@pytest.mark.parametrize(
    ('doubtful_from', 'expected'), [(3, [2, 3]), (2, [2, 'gap', 3]), (0, [2, 'gap', 3])]
)
def test_a_request_may_overtake_the_violation(
    group: Group, doubtful_from: int, expected: list[int | str]
) -> None:
    group.state('/former', 2)
    for each in (2, 3):
        group.state('/standby', each)
    group.take_over(gap=True, doubtful_from=doubtful_from)
    assert group.progressed == expected


def test_a_next_standby_waits_for_the_take_over(group: Group) -> None:
    """The take-over waits for a step; the former standby is taken, which has all states."""
    group.state('/former', 2)
    with mock.patch.object(group_evaluation, 'HEAVY_STEP_S', -1.0):
        group.receive('/former', 3)
    for each in (2, 3, 4):
        group.receive('/standby', each)
    change = group.evaluation.change_stream({}, '/standby', '', gap=True, doubtful_from=9)
    following = group.evaluation.set_standby('/next')
    for each in (change, following):
        assert each.send(None) is None
    group.drain()
    for each in (change, following):
        run_to_end(each)
    group.drain()
    assert group.progressed == [2, 3, 4]


def test_states_of_a_standby_that_broke_a_constraint_are_not_used(group: Group) -> None:
    group.state('/former', 2)
    for each in (2, 3):
        group.state('/standby', each)
    group.violate('/standby', 3)
    group.take_over()
    group.state('/standby', 4)
    assert group.progressed == [2]


@pytest.mark.parametrize('topic', ['/former', '/standby'])
def test_a_state_that_overtakes_a_violation_is_not_used(group: Group, topic: str) -> None:
    """The violation was published before the state, and comes after it."""
    group.state('/former', 2)
    group.state('/standby', 2)
    stamp = nanoseconds_to_time(3)
    message = sample_to_message(Sample(3, 3, {'power': 200.0}))
    message.violated_at = stamp
    group.streams[topic]._on_sample(message, {})
    group.violate(topic, 3)
    if topic == '/standby':
        group.take_over()
    assert group.progressed == [2]
    if topic == '/former':
        group.state('/standby', 4)
        group.take_over(gap=True, doubtful_from=3)
        assert group.progressed == [2, 4]


def test_a_recreated_stream_repeats_states() -> None:
    with Group() as made:
        for valid_time in (1, 2, 3):
            made.state('/former', valid_time)
        made.state('/former', 2, loss='the state stream was recreated')
        for valid_time in (3, 4, 5):
            made.state('/former', valid_time)
        assert made.progressed == [1, 2, 3, 'gap', 4, 5]
        (event,) = made.evaluation._events
        assert event.startswith('the state stream was recreated: states may be missing')


def test_a_loss_in_the_standby_is_a_gap(group: Group) -> None:
    group.state('/former', 2)
    group.state('/standby', 2)
    group.state('/standby', 4, loss='1 states were lost')
    group.take_over()
    assert group.progressed == [2, 'gap', 4]


@pytest.mark.parametrize(
    ('is_better', 'more', 'expected', 'states'),
    [
        (False, [], [2, 3, 4, 5], 1),
        (False, [3], [2, 3, 4, 5], 3),
        (True, [], [2, 'gap', 3, 4, 5], 1),
        (True, [3], [2, 3, 4, 5], 3),
    ],
)
def test_no_state_from_before_a_formula_was_added_is_used(
    is_better: bool,  # noqa: FBT001
    more: list[int],
    expected: list[int | str],
    states: int,
) -> None:
    """The other formulas use the kept states. A state of the stream in use begins it."""
    with Group() as made:
        made.state('/former', 2)
        if is_better:
            run_to_end(made.evaluation.change_stream({}, '/standby', '', gap=False))
        else:
            run_to_end(made.evaluation.set_standby('/standby'))
            made.state('/standby', 2)
        for each in (3, 4):
            made.state('/standby', each)
        run_to_end(made.evaluation.add_formula('late', 'eventually power > 150'))
        for each in more:
            made.state('/former', each)
        if is_better:
            made.violate('/former', 9)
        else:
            made.take_over()
        made.state('/standby', 5)
        assert made.progressed == expected
        run_to_end(made.evaluation.remove_formula(2))
        assert last_reports(made) == [(states, 5)]


def test_there_may_be_no_standby(group: Group) -> None:
    former = group.streams['/standby']
    with mock.patch.object(former, 'destroy') as destroy:
        run_to_end(group.evaluation.set_standby(''))
    destroy.assert_called_once_with()
    group.state('/former', 2)
    group.take_over(gap=True)
    assert group.progressed == [2, 'gap']


CALM = 1
"""The formula of the group."""


def last_reports(made: Group) -> list[tuple[int, int]]:
    """Return the states and the latest valid times of the last reports."""
    reports = [call.args[0] for call in made.reports.publish.call_args_list]
    return [
        (each.states_progressed, time_to_nanoseconds(each.latest_valid_time))
        for each in reports
        if each.is_last
    ]


@pytest.mark.parametrize('heavy_step_s', [-1.0, 1e9])
def test_a_formula_gets_the_states_until_a_time(heavy_step_s: float) -> None:
    with Group() as made, mock.patch.object(group_evaluation, 'HEAVY_STEP_S', heavy_step_s):
        made.state('/former', 1)
        run_to_end(made.evaluation.remove_formula(CALM, 3))
        for valid_time in (2, 3, 4, 5):
            made.receive('/former', valid_time)
        made.drain()
        assert made.progressed == [1, 2, 3]
        assert last_reports(made) == [(3, 3)]
        with pytest.raises(ReasoningError):
            made.evaluation.group.remove_formula(CALM)


def test_states_that_wait_for_a_group_that_is_destroyed_are_not_progressed() -> None:
    """They kept the background busy, for which the work of other groups waited."""
    with Group() as made, mock.patch.object(group_evaluation, 'HEAVY_STEP_S', -1.0):
        for valid_time in (1, 2, 3):
            made.receive('/former', valid_time)
        made.evaluation.destroy()
        made.drain()
        assert made.progressed == [1]
        assert not made.evaluation._work.is_busy


def test_a_formula_without_a_state_until_a_time() -> None:
    with Group() as made:
        run_to_end(made.evaluation.remove_formula(CALM, 3))
        made.state('/former', 4)
        assert made.progressed == []
        assert last_reports(made) == [(0, 0)]


def test_other_formulas_get_the_later_states() -> None:
    with Group() as made:
        other = made.evaluation.group.add_formula('other', 'always power < 150')
        run_to_end(made.evaluation.remove_formula(CALM, 1))
        made.state('/former', 1)
        made.state('/former', 2)
        assert made.progressed == [1, 2]
        assert made.evaluation.group.undecided == {other}


def test_states_that_wait_while_a_formula_is_added_are_counted() -> None:
    """They are progressed, and the formula with them, before the request goes on."""
    with Group() as made:
        with mock.patch.object(group_evaluation, 'HEAVY_STEP_S', -1.0):
            made.receive('/former', 1)
        adding = made.evaluation.add_formula('late', 'eventually[0 ns, 1 ns] power > 150')
        assert adding.send(None) is None
        for valid_time in (2, 3, 4):
            made.receive('/former', valid_time)
        made.drain()
        assert made.progressed == [1]
        run_to_end(adding)
        made.drain()
        assert made.progressed == [1, 2, 3, 4]
        assert last_reports(made) == [(2, 3)]


@pytest.mark.parametrize('until', [0, 1, 2])
def test_a_formula_that_has_them_is_removed_at_once(until: int) -> None:
    with Group() as made:
        made.state('/former', 2)
        run_to_end(made.evaluation.remove_formula(CALM, until))
        assert last_reports(made) == [(1, 2)]


def test_a_later_removal_becomes_one_at_once() -> None:
    with Group() as made:
        made.state('/former', 1)
        run_to_end(made.evaluation.remove_formula(CALM, 9))
        assert last_reports(made) == []
        run_to_end(made.evaluation.remove_formula(CALM))
        made.state('/former', 10)
        assert last_reports(made) == [(1, 1)]


def test_states_of_another_clock_have_no_order_with_reports() -> None:
    """A recording of an earlier day is replayed, and a plan is monitored by the present clock."""
    now = 30 * 24 * 3600 * 10**9
    with Group() as made:
        group = made.evaluation.group
        adding = made.evaluation.add_formula('late', 'eventually power < 150', since=now)
        run_to_end(adding)
        made.state('/former', 1)
        assert group.waiting == {}
        assert group.undecided == {CALM}
        run_to_end(made.evaluation.remove_formula(CALM, now))
        assert last_reports(made) == [(1, 1), (1, 1)]
    with Group() as made:
        run_to_end(made.evaluation.remove_formula(CALM, now))
        made.state('/former', 1)
        assert last_reports(made) == [(0, 0)]
