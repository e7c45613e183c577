"""The alternatives of a state contain the true one, and no others that are known to be wrong."""

from __future__ import annotations

from itertools import accumulate

from hypothesis import given
from hypothesis import strategies as st

from dyknow_federation import RemoteSample, UncertainStates
from dyknow_federation.uncertain_states import MAX_ALTERNATIVES, MAX_WAITING


def merged(start: int = 0, period: int = 10) -> UncertainStates:
    return UncertainStates(start, period, lambda host: f'the clocks of me and {host} differ')


def sample(time: int, uncertainty: int, value: int) -> RemoteSample:
    return RemoteSample(time, uncertainty, {'x': value})


@st.composite
def streams(draw: st.DrawFn) -> list[tuple[int, RemoteSample]]:
    """The true times of samples, and what is known of them."""
    steps = draw(st.lists(st.integers(1, 12), min_size=1, max_size=10))
    found = []
    for time in accumulate(steps):
        uncertainty = draw(st.integers(0, 15))
        error = draw(st.integers(-uncertainty, uncertainty))
        found.append((time, sample(time + error, uncertainty, draw(st.integers(0, 2)))))
    return found


@given(streams(), streams())
def test_the_true_state_is_one_of_the_alternatives(
    first: list[tuple[int, RemoteSample]], second: list[tuple[int, RemoteSample]]
) -> None:
    states = merged()
    states.add('a', 's', {'P': 'x'})
    states.add('b', 's', {'Q': 'x'})
    found = []
    for host, known in (('a', first), ('b', second)):
        for _, each in known:
            states.put(host, 's', each)
            found += states.states()
    states.promise('a', 's', 200)
    states.promise('b', 's', 200)
    found += states.states()
    assert [each.valid_time for each in found] == list(range(0, 201, 10))
    for tick, alternatives, _ in found:
        true = {
            name: value
            for name, known in (('P', first), ('Q', second))
            for time, each in known
            for value in [each.fields['x']]
            if time <= tick
        }
        known = set(alternatives[0])
        assert {k: v for k, v in true.items() if k in known} in [dict(e) for e in alternatives]
        if all(each.uncertainty == 0 for _, each in first + second):
            assert list(map(dict, alternatives)) == [true]


def test_a_tick_waits_for_all_that_may_still_come_before_it() -> None:
    states = merged()
    states.add('', 'own', {'P': 'x'})
    states.add('b', 's', {'Q': 'x'})
    states.put('', 'own', sample(0, 0, 1))
    states.put('b', 's', sample(12, 5, 1))
    states.promise('', 'own', 30)
    assert [each.valid_time for each in states.states()] == [0]
    assert states.awaited == [('b', 's')]
    states.put('b', 's', sample(26, 5, 2))
    assert list(states.states()) == [
        (10, ({'P': 1},), 'a value of Q has not arrived yet'),
        (20, ({'P': 1, 'Q': 1},), ''),
    ]
    states.promise('b', 's', 40)
    states.promise('', 'own', 40)
    assert [(each.alternatives, each.reason) for each in states.states()] == [
        (({'P': 1, 'Q': 1}, {'P': 1, 'Q': 2}), 'the clocks of me and b differ'),
        (({'P': 1, 'Q': 2},), ''),
    ]


def test_a_later_sample_is_not_valid_earlier() -> None:
    states = merged()
    states.add('b', 's', {'Q': 'x'})
    states.put('b', 's', sample(12, 1, 1))
    states.put('b', 's', sample(10, 5, 2))  # A later one, so it is valid after 11.
    states.promise('b', 's', 20)
    assert [each.alternatives for each in states.states()] == [({},), ({},), ({'Q': 2},)]


def test_equal_values_are_one_alternative() -> None:
    states = merged()
    states.add('b', 's', {'Q': 'x'})
    for time in (2, 9, 12):
        states.put('b', 's', sample(time, 2, 7))
    states.promise('b', 's', 10)
    assert list(states.states())[-1] == (10, ({'Q': 7},), '')


def test_lost_samples_are_unknown_until_the_next_one() -> None:
    states = merged()
    states.add('b', 's', {'Q': 'x'})
    states.put('b', 's', sample(5, 0, 1))
    states.promise('b', 's', 10)
    states.lose('b', 's', '2 samples of b are lost')
    states.put('b', 's', sample(27, 0, 2))
    states.promise('b', 's', 30)
    assert [(each.alternatives, each.reason) for each in states.states()] == [
        (({},), '2 samples of b are lost'),
        (({},), '2 samples of b are lost'),
        (({},), '2 samples of b are lost'),
        (({'Q': 2},), ''),
    ]


def test_memory_and_alternatives_are_bounded() -> None:
    states = merged(period=10 * MAX_WAITING)
    states.add('b', 's', {'Q': 'x'})
    states.add('c', 's', {'R': 'x'})
    for number in range(MAX_WAITING + 50):
        states.put('b', 's', sample(number + 1, 0, number))
    assert states.held == MAX_WAITING
    states = merged()
    for host in 'abcdefgh':
        states.add(host, 's', {host: 'x'})
        for number in range(3):
            states.put(host, 's', sample(number + 1, 0 if number == 0 else 20, number))
        states.promise(host, 's', 10)
    *_, state = states.states()
    assert 3 < len(state.alternatives) <= MAX_ALTERNATIVES
    assert len(state.alternatives[0]) == 3
