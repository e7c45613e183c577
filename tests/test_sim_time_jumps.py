"""Simulated time: all follows /clock, and a clock that jumps leads to no false verdict."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult, Sample, StreamWatermarks
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Float64

from battery_publishers import CALM, BatteryPublishers
from dyknow_common.ros import STREAM, nanoseconds_to_time, time_to_nanoseconds
from dyknow_stream_processing.ros.topics.watermark_topics import WATERMARKS
from evaluations import COORDINATOR, Evaluations, Monitored, Spares
from services import nanoseconds
from system import Batteries, System

SECOND = 1_000_000_000
TICK = 20_000_000
ALWAYS = 'always Power[uav1] < 150'
SOON = 'always[0 s, 500 ms] Power[uav1] < 150'


class Simulation:
    """A clock, the batteries of a fleet and a level without a stamp, by simulated time."""

    def __init__(self, system: System) -> None:
        self.now = 1000 * SECOND
        self.speed = 1
        self.periods = 1
        """The periods of the timer for a step. A busy machine is late for a clock that is fast."""
        self.tick = TICK
        self.clock_is_last = False
        self.level = 10.0
        self.batteries = BatteryPublishers(system.client.node, system.vehicles)
        self._node = system.client.node
        self.power = dict.fromkeys(system.vehicles, CALM)
        self._clock = self._node.create_publisher(Clock, '/clock', 10)
        self._level = self._node.create_publisher(Float64, '/tank/level', 10)
        self._calls = 0
        self._node.create_timer(TICK / SECOND, self._tick)

    def jump(self, step: int) -> None:
        """Set the clock forwards or backwards, and publish it at once."""
        self.now += step
        self._clock.publish(Clock(clock=nanoseconds_to_time(self.now)))

    def _tick(self) -> None:
        self._calls += 1
        for _ in range(0 if self._calls % self.periods else self.speed):
            self.now += self.tick
            clock = Clock(clock=nanoseconds_to_time(self.now))
            if not self.clock_is_last:
                self._clock.publish(clock)
            if self.now % Batteries.PERIOD == 0:
                self._level.publish(Float64(data=self.level))
                for vehicle, power in self.power.items():
                    self.batteries.publish(vehicle, self.now, power)
            if self.clock_is_last:
                self._clock.publish(clock)


@pytest.fixture(scope='module')
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    folder = tmp_path_factory.mktemp('system')
    parameters = {'stream_reasoning_engine': {'orphan_limit': 12.0}}
    with System(
        folder, use_sim_time=True, parameters=parameters, short_lease=True, composition=False
    ) as running:
        yield running


@pytest.fixture(scope='module')
def simulation(system: System) -> Simulation:
    return Simulation(system)


@pytest.fixture(autouse=True)
def calm(simulation: Simulation, evaluations: Evaluations) -> Iterator[None]:
    simulation.speed = 1
    yield
    simulation.speed, simulation.periods = 1, 1
    simulation.tick, simulation.clock_is_last = TICK, False
    evaluations.wait_for_nothing()


def assert_broken(answer: Any, *words: str) -> None:
    """No verdict, but which stream broke which constraint."""
    assert answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION, answer
    assert answer.verdict == FormulaResult.UNDECIDED
    for word in words:
        assert word in answer.exit_status.message


def test_all_follows_the_clock(
    system: System, simulation: Simulation, evaluations: Evaluations
) -> None:
    future = system.ask('always[0 s, 3 s] Power[uav1] < 150')
    evaluations.wait_for_state()
    begun = simulation.now
    simulation.periods = 2
    answer = system.decided(future, FormulaResult.TRUE)
    assert begun + SECOND < nanoseconds(answer.decided_at) <= simulation.now


def test_a_clock_that_lags_the_data(
    system: System, simulation: Simulation, evaluations: Evaluations
) -> None:
    """Data that comes before the step of the clock at which it was stamped is not ahead of it."""
    future = system.ask('always[0 s, 4 s] Power[uav1] < 150')
    evaluations.wait_for_state()
    simulation.clock_is_last = True
    system.client.spin_until(lambda: simulation.now % Batteries.PERIOD == 0, 'data')
    simulation.tick, simulation.periods = Batteries.PERIOD, Batteries.PERIOD // TICK
    system.decided(future, FormulaResult.TRUE)


def test_a_clock_that_stands_still(
    system: System, simulation: Simulation, evaluations: Evaluations
) -> None:
    """No verdict comes then, nor a violation; the caller's timeout is one of the wall clock."""
    future = system.ask('always[0 s, 9 s] Power[uav1] < 150', timeout=6.0)
    evaluations.wait_for_state()
    simulation.speed = 0
    system.client.spin_until(future.done, 'the answer')
    assert future.result().exit_status.code == ExitStatus.TIMEOUT
    assert future.result().verdict == FormulaResult.UNDECIDED


def test_a_jump_forth(system: System, simulation: Simulation, evaluations: Evaluations) -> None:
    """Also a window that was jumped over is not known to have been as it should."""
    futures = [system.ask(ALWAYS), system.ask('always[0 s, 30 s] Power[uav1] < 150')]
    evaluations.wait_for_state(2)
    simulation.now += 60 * SECOND
    system.client.spin_until(lambda: all(each.done() for each in futures), 'the answers')
    for future in futures:
        answer = future.result()
        if answer.exit_status.code == ExitStatus.UNAVAILABLE:
            # The coordinator may notice the silence before it hears of the violation.
            assert "'/uav1/battery' has been silent" in answer.exit_status.message
        else:
            assert_broken(answer, 'uav1_battery', 'sample_period: ', '250 ms allowed')
    again = system.evaluate(SOON)
    assert again.verdict == FormulaResult.TRUE, again.exit_status.message


@pytest.mark.parametrize('jump', [500_000_000, 60 * SECOND], ids=['0.5 s', '60 s'])
def test_a_jump_back(
    system: System, simulation: Simulation, evaluations: Evaluations, jump: int
) -> None:
    """As when a simulation is reset."""
    future = system.ask('eventually[5 s, 6 s] Power[uav1] > 150')
    evaluations.wait_for_state()
    simulation.now -= jump
    system.client.spin_until(future.done, 'the answer')
    assert_broken(future.result())
    # What comes after is evaluated as ever: a simulation may be reset without restarting anything.
    again = system.evaluate(SOON)
    assert again.verdict == FormulaResult.TRUE, again.exit_status.message


@pytest.mark.parametrize('clock_is_last', [False, True])
def test_no_stand_in_goes_on_after_a_jump_back(
    system: System,
    simulation: Simulation,
    evaluations: Evaluations,
    spares: Spares,
    clock_is_last: bool,  # noqa: FBT001
) -> None:
    """Its states are of another run, although they have the same times."""
    spares.power('uav1_spare_power', 'uav2', of='uav1')
    future = system.ask('always Power[uav1] < 150', timeout=30.0)
    evaluations.wait_for_state()
    simulation.clock_is_last = clock_is_last
    simulation.now -= 60 * SECOND if clock_is_last else SECOND // 2
    system.client.spin_until(future.done, 'the answer')
    # Data that comes before the step of the clock is late by the jump.
    assert_broken(future.result(), *([] if clock_is_last else ['the clock was set back by']))


def test_a_jump_back_of_a_stream_without_stamps(
    system: System, simulation: Simulation, evaluations: Evaluations
) -> None:
    spares = Spares(system)
    spares.make('level', 'select data as level from "/tank/level"')
    future = system.ask('eventually[5 s, 6 s] level > 150')
    evaluations.wait_for_state()
    simulation.now -= 60 * SECOND
    system.client.spin_until(future.done, 'the answer')
    assert_broken(future.result())
    again = system.evaluate('always[0 s, 500 ms] level < 150')
    assert again.verdict == FormulaResult.TRUE, again.exit_status.message
    spares.clear()


def test_what_is_certain_after_a_jump_back(
    system: System, simulation: Simulation, spares: Spares
) -> None:
    """Another engine waited for a stream without samples until the time had passed once more."""
    certain: list[int] = []
    samples: list[Sample] = []

    def note(message: StreamWatermarks) -> None:
        found = [each for each in message.streams if each.stream_name == 'full']
        certain.extend(time_to_nanoseconds(each.watermark) for each in found)

    node, topic = system.client.node, '/dyknow/streams/_watermarks'
    subscriptions = [
        node.create_subscription(StreamWatermarks, topic, note, WATERMARKS),
        node.create_subscription(Sample, '/dyknow/streams/full', samples.append, STREAM),
    ]
    spares.make('full', 'select data as level from "/tank/level" where data > 9')
    system.client.spin_until(lambda: bool(samples and certain), 'what is certain')
    simulation.level, begun = 1.0, simulation.now
    system.client.spin_until(lambda: certain[-1] > begun + SECOND, 'what is certain later')
    simulation.now -= 60 * SECOND
    system.client.spin_until(lambda: certain[-1] < begun, 'what is certain again')
    simulation.level = 10.0
    for each in subscriptions:
        node.destroy_subscription(each)


def test_a_coordinator_that_is_killed(
    system: System, simulation: Simulation, evaluations: Evaluations
) -> None:
    """Its successor is another one although simulated time has not come to it yet."""
    system.ask(ALWAYS, timeout=60.0)
    (former,) = evaluations.wait_for_state()
    system.launcher.kill(COORDINATOR)
    simulation.speed = 0
    system.restart(COORDINATOR)
    system.client.wait_for_coordinator()
    simulation.speed = 1
    evaluations.wait_for_nothing()
    monitored = Monitored(system.client, ALWAYS)
    (other,) = evaluations.wait_for_state()
    assert other.state_stream != former.state_stream
    assert monitored.end().exit_status.code == ExitStatus.CANCELLED
