from collections import defaultdict
from dataclasses import replace
from itertools import pairwise
from math import isnan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_bringup.errors import BringupError
from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.telemetry import TRANSPORT, Battery, Channel, Odometry, Telemetry
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common import NANOSECONDS

SECOND = NANOSECONDS['s']
START = 1_700_000_000 * SECOND + 123

Series = dict[tuple[str, Channel], list[Telemetry]]


def fly(
    scenario: Scenario, count: int = 2, start: int = START, seconds: float = 3
) -> list[Telemetry]:
    simulation = Simulation(scenario, vehicle_names(count), start)
    return list(simulation.until(start + round(seconds * SECOND)))


def by_channel(messages: list[Telemetry]) -> Series:
    series: Series = defaultdict(list)
    for message in messages:
        series[message.vehicle, message.channel].append(message)
    return series


def test_stamps_lie_on_the_grid_and_deliveries_keep_order(scenarios: dict[str, Scenario]) -> None:
    messages = fly(scenarios['nominal'])
    for (_, channel), series in by_channel(messages).items():
        transport = TRANSPORT[channel]
        stamps = [message.stamp for message in series]
        assert stamps == [START + index * transport.period for index in range(len(stamps))]
        for message in series:
            delay = message.delivery_time - message.stamp
            assert transport.delay <= delay < transport.delay + transport.jitter
        deliveries = [message.delivery_time for message in series]
        assert all(early < late for early, late in pairwise(deliveries))
    deliveries = [message.delivery_time for message in messages]
    assert deliveries == sorted(deliveries)
    assert deliveries[-1] <= START + 3 * SECOND


def test_everything_due_is_delivered(scenarios: dict[str, Scenario]) -> None:
    counts = {key: len(series) for key, series in by_channel(fly(scenarios['nominal'])).items()}
    # Stamps from 0 s to 2.95 s and to 2.8 s; that of 3 s is not delivered yet.
    assert counts == {
        ('uav1', Channel.ODOMETRY): 60,
        ('uav1', Channel.BATTERY): 15,
        ('uav2', Channel.ODOMETRY): 60,
        ('uav2', Channel.BATTERY): 15,
    }


@given(st.lists(st.integers(-SECOND, 2 * SECOND), max_size=8))
def test_when_it_is_asked_makes_no_difference(
    scenarios: dict[str, Scenario], times: list[int]
) -> None:
    scenario = scenarios['power_surge']
    simulation = Simulation(scenario, vehicle_names(2), START)
    messages: list[Telemetry] = []
    for time in [*sorted(times), 2 * SECOND]:
        new = list(simulation.until(START + time))
        assert all(message.delivery_time <= START + time for message in new)
        messages += new
    assert messages == fly(scenario, seconds=2)


def test_the_seed_makes_the_noise(scenarios: dict[str, Scenario]) -> None:
    scenario = scenarios['nominal']
    assert fly(scenario) == fly(scenario)
    assert fly(scenario) != fly(replace(scenario, seed=scenario.seed + 1))


def test_another_start_only_moves_the_times(scenarios: dict[str, Scenario]) -> None:
    def moved(message: Telemetry) -> Telemetry:
        return replace(
            message, stamp=message.stamp - START, delivery_time=message.delivery_time - START
        )

    scenario = scenarios['nominal']
    assert [moved(message) for message in fly(scenario)] == fly(scenario, start=0)


def test_more_vehicles_do_not_disturb_the_others(scenarios: dict[str, Scenario]) -> None:
    few = by_channel(fly(scenarios['nominal'], count=1))
    many = by_channel(fly(scenarios['nominal'], count=5))
    assert few.items() <= many.items()
    assert len(many) == 10


def test_vehicles_have_noise_of_their_own(scenarios: dict[str, Scenario]) -> None:
    series = by_channel(fly(scenarios['nominal']))
    one, other = series['uav1', Channel.BATTERY], series['uav2', Channel.BATTERY]
    voltages = [
        [message.voltage for message in messages if isinstance(message, Battery)]
        for messages in (one, other)
    ]
    assert voltages[0] != voltages[1]


def test_noise_has_no_bias_and_a_plausible_size(scenarios: dict[str, Scenario]) -> None:
    scenario = replace(scenarios['nominal'], plans={})
    heights = [
        message.position[1] for message in fly(scenario, count=1) if isinstance(message, Odometry)
    ]
    mean = sum(heights) / len(heights)
    deviation = (sum((height - mean) ** 2 for height in heights) / len(heights)) ** 0.5
    assert abs(mean) < 0.03
    assert 0.03 < deviation < 0.07


def test_a_discharging_battery_has_a_negative_current(scenarios: dict[str, Scenario]) -> None:
    batteries = [message for message in fly(scenarios['nominal']) if isinstance(message, Battery)]
    assert all(message.current < -5 for message in batteries)
    assert all(14 < message.voltage < 17 for message in batteries)
    assert all(0.9 < message.percentage < 1 for message in batteries)


def test_lost_telemetry_is_missing_and_nothing_else(scenarios: dict[str, Scenario]) -> None:
    scenario = scenarios['telemetry_loss']
    complete = fly(replace(scenario, telemetry_losses=()), count=3, seconds=20)
    heard = fly(scenario, count=3, seconds=20)
    assert [message for message in complete if message in heard] == heard
    lost = by_channel([message for message in complete if message not in heard])
    stamps = {
        key: (series[0].stamp - START, series[-1].stamp - START) for key, series in lost.items()
    }
    ms = NANOSECONDS['ms']
    assert stamps == {
        ('uav3', Channel.ODOMETRY): (10_000 * ms, 19_950 * ms),
        ('uav1', Channel.BATTERY): (14_000 * ms, 15_800 * ms),
    }


def test_an_altitude_is_unknown_and_nothing_else(scenarios: dict[str, Scenario]) -> None:
    scenario = scenarios['gps_loss']
    complete = fly(replace(scenario, gps_losses=()), count=3, seconds=20)
    heard = fly(scenario, count=3, seconds=20)
    lost = [
        (full, message) for full, message in zip(complete, heard, strict=True) if message != full
    ]
    assert len(lost) == 2 * 4 * 20
    for full, message in lost:
        assert isinstance(full, Odometry)
        assert isinstance(message, Odometry)
        assert message.vehicle in {'uav1', 'uav3'}
        assert 3 * SECOND <= message.stamp - START < 7 * SECOND
        assert isnan(message.position[2])
        assert replace(message, position=full.position) == full


def test_a_gust_rises_and_falls(scenarios: dict[str, Scenario]) -> None:
    gust = scenarios['power_surge'].gusts[0]
    half = 250 * NANOSECONDS['ms']
    assert gust.wind_at(gust.begin).tolist() == [0, 0, 0]
    assert gust.wind_at(gust.begin + half).tolist() == [-3.5, 0, 0]
    assert gust.wind_at(gust.begin + 2 * half).tolist() == [-7, 0, 0]
    assert gust.wind_at(gust.end - half).tolist() == [-3.5, 0, 0]
    assert gust.wind_at(gust.end + half).tolist() == [0, 0, 0]


def test_a_fleet_that_is_too_small(scenarios: dict[str, Scenario]) -> None:
    with pytest.raises(BringupError) as error:
        Simulation(scenarios['telemetry_loss'], ('uav1', 'uav2'), START)
    assert str(error.value) == (
        "scenario 'telemetry_loss' needs uav3; the fleet is uav1, uav2: add vehicles"
    )


def test_lanes_are_clear_of_each_other(scenarios: dict[str, Scenario]) -> None:
    for name, scenario in scenarios.items():
        odometry: dict[int, dict[str, Odometry]] = defaultdict(dict)
        for message in fly(scenario, count=6, seconds=20):
            if isinstance(message, Odometry):
                odometry[message.stamp][message.vehicle] = message
        near = {
            frozenset((one.vehicle, other.vehicle))
            for positions in odometry.values()
            for one in positions.values()
            for other in positions.values()
            if one is not other and distance(one, other) < 12
        }
        assert near == ({frozenset(('uav1', 'uav2'))} if name == 'near_miss' else set())


def distance(one: Odometry, other: Odometry) -> float:
    return (
        (one.position[0] - other.position[0]) ** 2 + (one.position[1] - other.position[1]) ** 2
    ) ** 0.5
