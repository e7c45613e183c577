"""Streams that fail while a formula is evaluated: others stand in, and no verdict is wrong.

Which source replaces which is tested without middleware: in test_live_sessions, test_standby and
test_standby_states.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from dyknow_interfaces.srv import CancelEvaluation, EvaluateFormula, FormulaGroupEvaluate
from std_msgs.msg import Float64

from dyknow_bringup.processes.composition import NODES
from evaluations import BATTERY_PERIOD, COORDINATOR, Evaluations, Spares
from services import nanoseconds
from system import POLL, SOON_NOTICED, SPARES, Batteries, SharedSystem, System

TRUE, FALSE, UNDECIDED = FormulaResult.TRUE, FormulaResult.FALSE, FormulaResult.UNDECIDED
SECOND = 1_000_000_000
SPARE = 'uav1_spare_power'

pytestmark = pytest.mark.usefixtures('calm')


@pytest.fixture(scope='module')
def system(shared_system: SharedSystem, composition: bool) -> System:  # noqa: FBT001 - a fixture
    return shared_system.get(parameters=SOON_NOTICED, spares=SPARES, composition=composition)


def test_a_stream_that_falls_silent_is_replaced(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    spares.power(SPARE, 'spare1', of='uav1')
    future = system.ask('always Power[uav1] < 150', timeout=20.0)
    (before,) = evaluations.wait_for(1)
    (grounding,) = before.groundings
    assert 'from uav1_power' in grounding.stream
    assert [SPARE in each for each in grounding.stand_ins] == [True]
    batteries.silent.add('uav1')
    # A machine that stalls for long enough first notices that the topic is silent.
    evaluations.wait_for_event('uav1', SPARE)
    since = batteries.stamp
    batteries.power['spare1'] = 240.0
    answer = system.decided(future, FALSE)
    assert 'Power[uav1] = 24' in answer.explanation
    assert nanoseconds(answer.decided_at) > since
    assert SPARE in answer.groundings[0].stream


def test_a_pause_of_the_coordinator_is_no_silence(
    system: System,
    batteries: Batteries,
    evaluations: Evaluations,
    spares: Spares,
    composition: bool,  # noqa: FBT001 - a fixture
) -> None:
    """The stream manager's report from before the pause is older than `silence_limit`."""
    spares.make('regular', 'select voltage from "/uav1/battery" with sample_period = 200 ms')
    future = system.ask('always[0 s, 8 s] regular.voltage > 9', timeout=60.0)
    evaluations.wait_for_state()
    with system.stopped(NODES if composition else 'stream_reasoning_coordinator'):
        paused = batteries.stamp
        system.client.spin_until(lambda: batteries.stamp > paused + 4 * SECOND, 'four seconds')
    system.decided(future, TRUE)


def test_no_state_has_a_value_that_is_not_known(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """The last that was heard of uav1 would violate the formula; what is the case does not."""
    spares.power(SPARE, 'spare1', of='uav1')
    batteries.power['uav1'] = 240.0
    future = system.ask('always (Power[uav2] > 200 -> Power[uav1] < 150)', timeout=20.0)
    evaluations.wait_for_state()
    silence = batteries.stamp
    batteries.silent.add('uav1')
    system.client.spin_until(lambda: batteries.stamp > silence + SECOND // 2, 'half a second')
    batteries.power['uav2'] = 240.0
    evaluations.wait_for_event(SPARE)
    replaced = batteries.stamp
    system.client.spin_until(lambda: batteries.stamp > replaced + SECOND, 'a second')
    assert not future.done(), future.result()
    rise = batteries.stamp
    batteries.power['spare1'] = 240.0
    system.decided(future, FALSE)
    assert nanoseconds(future.result().decided_at) > rise


def wait_for_standby(system: System, former: set[str]) -> set[str]:
    """Wait until two streams of states, one of them new, have had states; return them.

    A standby that fails on a busy machine is replaced by another one.
    """

    def found() -> set[str]:
        return {each for each in system.streams() if 'states_' in each}

    def is_new(streams: set[str]) -> bool:
        return len(streams) == 2 and streams != former

    system.client.spin_until(lambda: is_new(found()), 'a standby', pause=POLL)
    # The reasoning engine keeps the states of the standby from its subscription on.
    count = system.client.node.count_subscribers
    system.client.spin_until(
        lambda: all(count(f'/dyknow/streams/{each}') for each in found()),
        'subscriptions to all states',
        pause=POLL,
    )
    made = system.batteries.stamp
    system.client.spin_until(lambda: system.batteries.stamp > made + SECOND, 'states of it')
    return found()


def ask_beside_standby(
    system: System, evaluations: Evaluations, spares: Spares, *formulas: str
) -> list[Any]:
    """Ask formulas over the power of uav1, whose states have a standby."""
    evaluations.wait_for_nothing()  # The streams of a former test would be taken for these.
    # A standby that is late for a moment, on a busy machine, would not be used.
    spares.power(SPARE, 'spare1', of='uav1', battery=f'max_delay = 20 s, {BATTERY_PERIOD}')
    answers = [system.ask(each, timeout=20.0) for each in formulas]
    evaluations.wait_for_state(len(answers))
    wait_for_standby(system, set())
    return answers


def test_a_stand_in_that_published_all_the_time_loses_no_state(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    formula = 'always[0 s, 5 s] Power[uav1] < 150'
    (calm,) = ask_beside_standby(system, evaluations, spares, formula)
    batteries.silent.add('uav1')
    evaluations.wait_for_event(SPARE)
    answer = system.decided(calm, TRUE)
    assert 'missing' not in answer.explanation
    assert SPARE in answer.groundings[0].stream


def test_states_from_before_a_stand_in_is_in_use_count(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """Its surge begins and ends before anybody knows that the stream in use is silent."""
    formula = 'eventually Power[uav1] > 150'
    (surges,) = ask_beside_standby(system, evaluations, spares, formula)
    silence = batteries.stamp
    batteries.silent.add('uav1')
    system.client.spin_until(lambda: batteries.stamp > silence + Batteries.PERIOD, 'silence')
    batteries.power['spare1'] = 240.0
    surge = batteries.stamp
    system.client.spin_until(lambda: batteries.stamp > surge, 'a sample')
    batteries.power['spare1'] = 100.0
    system.decided(surges, TRUE)
    assert surge < nanoseconds(surges.result().decided_at) <= surge + 2 * Batteries.PERIOD


def test_after_a_stand_in_another_one_takes_over(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    evaluations.wait_for_nothing()
    spares.power(SPARE, 'spare1', of='uav1')
    spares.power('uav1_zpower', 'spare2', of='uav1')
    calm = system.ask('always[0 s, 9 s] Power[uav1] < 150', timeout=20.0)
    evaluations.wait_for_state()
    streams: set[str] = set()
    for name, stand_in in (('uav1', SPARE), ('spare1', 'uav1_zpower')):
        streams = wait_for_standby(system, streams)
        batteries.silent.add(name)
        evaluations.wait_for_event(f'from {stand_in}')
    system.decided(calm, TRUE)


@pytest.mark.parametrize('power', [100.0, 240.0])
def test_a_verdict_that_depends_on_what_was_missed(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares, power: float
) -> None:
    """The stand-in begins when it is needed."""
    batteries.silent.add('spare1')
    spares.power(SPARE, 'spare1', of='uav1')
    batteries.power['spare1'] = power
    once = system.ask('eventually[1 s, 6 s] Power[uav1] > 150', timeout=20.0)
    ever = system.ask('always[1 s, 6 s] Power[uav1] < 150', timeout=20.0)
    evaluations.wait_for_state(2)
    batteries.silent.add('uav1')
    evaluations.wait_for_event(SPARE)
    batteries.silent.discard('spare1')
    known = {100.0: (UNDECIDED, UNDECIDED), 240.0: (TRUE, FALSE)}
    check_missed(system, once, ever, known[power])


def check_missed(system: System, once: Any, ever: Any, verdicts: tuple[int, int]) -> None:
    """Wait for two answers; those that are undecided must say that states are missing."""
    system.client.spin_until(lambda: once.done() and ever.done(), 'the answers')
    assert (once.result().verdict, ever.result().verdict) == verdicts
    for answer in (once.result(), ever.result()):
        if answer.verdict == UNDECIDED:
            assert answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION
            missed, cause = answer.exit_status.message.split('; the streams were replaced: ')
            assert 'missing' in missed
            assert 'uav1' in cause
        else:
            assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message


def test_without_a_stand_in_the_caller_hears_what_broke(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    future = system.ask('forall u in UAV: always Power[u] < 150')
    evaluations.wait_for(1)
    batteries.silent.add('uav2')
    answer = system.client.result(future, 'the answer', 5.0)
    assert answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION
    assert answer.verdict == UNDECIDED
    for word in ('uav2_battery', 'sample_period: ', 's observed', '250 ms allowed'):
        assert word in answer.exit_status.message
    assert 'uav1' not in answer.exit_status.message


@pytest.mark.parametrize(
    ('age', 'constraint', 'measured'),
    [(3 * SECOND, 'max_delay', '1 s allowed'), (0, 'sample_period', '150 ms allowed')],
    ids=['late', 'twice'],
)
def test_a_sample_that_should_not_be(
    system: System,
    batteries: Batteries,
    evaluations: Evaluations,
    age: int,
    constraint: str,
    measured: str,
) -> None:
    future = system.ask('always Power[uav1] < 150')
    evaluations.wait_for_state()
    batteries.publish_after_latest('uav1', -age, 240.0)
    answer = system.client.result(future, 'the answer')
    assert answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION, answer
    assert f'{constraint}: ' in answer.exit_status.message
    assert measured in answer.exit_status.message
    assert 'uav1_battery' in answer.exit_status.message
    assert answer.verdict == UNDECIDED


def test_samples_that_overtake_each_other_within_the_delay(
    system: System, batteries: Batteries, evaluations: Evaluations, spares: Spares
) -> None:
    """A surge that comes in the wrong order is seen where it belongs, where that is asked for."""
    spares.make(
        'mixed',
        'select current from "/uav1/battery" with max_delay = 1 s, sample_period = 200 ms, '
        'sample_period_deviation = 50 ms, reorder = true',
    )
    surge = 'mixed.current < -15'
    future = system.ask(
        f'always ({surge} -> eventually[100 ms, 300 ms] {surge})',
        timeout=6.0,
        grounding=EvaluateFormula.Request.SYNTACTIC,
    )
    evaluations.wait_for_state()
    surged_at = batteries.overtake('uav1', 240.0)
    answer = system.decided(future, FALSE)
    assert nanoseconds(answer.decided_at) > surged_at


def test_states_that_are_not_read_any_more_are_made_anew(
    system: System, batteries: Batteries, evaluations: Evaluations
) -> None:
    """The formula went on without states until its timeout, and nobody said so."""
    evaluations.wait_for_nothing()
    future = system.ask('always Power[uav1] < 150', timeout=40.0)
    evaluations.wait_for_state()
    (group,) = evaluations.groups()
    answer = system.client.call(
        FormulaGroupEvaluate,
        'stream_reasoning_engine/formula_group_evaluate',
        formula_group_id=group,
        state_stream='/nobody_publishes_this',
        gap=True,
    )
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer
    evaluations.wait_for_event('no state has come for 5 s, although states are made')
    batteries.power['uav1'] = 240.0
    system.decided(future, FALSE)


class Levels:
    """Topics without stamps and without constraints.

    Their names are new: of a topic that has just been used, a node may still know the former
    publisher while it does not know the new ones of other topics.
    """

    _numbers = count(1)

    def __init__(self, system: System, *names: str) -> None:
        self._node = system.client.node
        self.silent = set(names)
        self.level = dict.fromkeys(names, 10.0)
        number = next(self._numbers)
        self.topics = {name: f'/{name}/level{number}' for name in names}
        self._publishers = {
            name: self._node.create_publisher(Float64, topic, 10)
            for name, topic in self.topics.items()
        }
        self._timer = self._node.create_timer(0.1, self._publish)

    def _publish(self) -> None:
        for name, publisher in self._publishers.items():
            if name not in self.silent:
                publisher.publish(Float64(data=self.level[name]))

    def close(self) -> None:
        self._node.destroy_timer(self._timer)
        for publisher in self._publishers.values():
            self._node.destroy_publisher(publisher)


@pytest.fixture
def levels(system: System, spares: Spares) -> Iterator[Levels]:
    """Two streams that carry the altitude of uav1, the first the better one by its name."""
    levels = Levels(system, 'barometer', 'laser')
    for name, topic in levels.topics.items():
        spares.make(name, f'select data as altitude from "{topic}"')
        spares.annotate(name, 'Altitude[uav1] = altitude')
    yield levels
    levels.close()


def ask_over(system: System, evaluations: Evaluations, stream: str, formula: str) -> Any:
    """Ask a formula again until it begins with a stream: somebody must know of its publisher."""
    for _ in range(20):
        future = system.ask(formula, timeout=15.0)
        (found,) = evaluations.wait_for(1)
        if f'from {stream}' in found.groundings[0].stream:
            return future
        name = f'{COORDINATOR}/cancel_evaluation'
        system.client.call(CancelEvaluation, name, name=found.name)
        evaluations.wait_for_nothing()
    raise AssertionError(f'{formula} never begins with {stream}')


@pytest.mark.parametrize('speaks', [True, False], ids=['falls silent', 'never spoke'])
def test_silence_without_constraints(
    system: System, evaluations: Evaluations, levels: Levels, *, speaks: bool
) -> None:
    levels.silent = set() if speaks else {'barometer'}
    future = ask_over(system, evaluations, 'barometer', 'always Altitude[uav1] < 50')
    if speaks:
        evaluations.wait_for_state()
        levels.silent.add('barometer')
    evaluations.wait_for_event(levels.topics['barometer'], '2.5 s', 'from laser')
    levels.level['laser'] = 60.0
    system.decided(future, FALSE)
