"""Outcomes of every scenario, by functions written for each formula and by progression.

The features are computed from the telemetry as a receiver has it, and each formula is evaluated
by code written for it alone, so that nothing of DyKnow is needed to see what is right. Progression
must then come to the same verdict at the same state.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist, inf, isnan

import pytest

from dyknow_bringup.simulation.scenario import Scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.telemetry import Battery, Channel, Odometry, Telemetry
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common import NANOSECONDS
from dyknow_configuration import RequestedFormula
from dyknow_reasoning import FormulaGroup, UnknownFeatures

pytestmark = pytest.mark.long

MS = NANOSECONDS['ms']
SECOND = NANOSECONDS['s']

LATENCY = 700 * MS
"""Maximum time from an event to the answer in a running system."""

SILENCE = {Channel.ODOMETRY: (50 + 20 + 300) * MS, Channel.BATTERY: (200 + 50 + 500) * MS}
"""Time after which a message is missing: period, deviation and allowed delay."""

Series = list[tuple[int, float]]
Ground = dict[str, Series]


@dataclass(frozen=True)
class Ending:
    """The outcome of a formula, and the time at which it is certain."""

    outcome: str
    time: float


UNDECIDED = Ending('undecided', inf)


def features(messages: list[Telemetry]) -> dict[str, Ground]:
    """Return the values of each feature, by its arguments."""
    ground: dict[str, Ground] = defaultdict(lambda: defaultdict(list))
    places: dict[int, dict[str, Odometry]] = defaultdict(dict)
    for message in messages:
        vehicle, time = message.vehicle, message.stamp
        if isinstance(message, Battery):
            ground['Power'][vehicle].append((time, -message.voltage * message.current))
        else:
            places[time][vehicle] = message
            ground['Altitude'][vehicle].append((time, message.position[2]))
            ground['East'][vehicle].append((time, message.position[0]))
            ground['North'][vehicle].append((time, message.position[1]))
            ground['Speed'][vehicle].append((time, dist(message.velocity, (0, 0, 0))))
    for time, at in places.items():
        if 'uav1' in at:
            for vehicle in at.keys() - {'uav1'}:
                distance = dist(at[vehicle].position[:2], at['uav1'].position[:2])
                ground['XYDist'][vehicle].append((time, distance))
    return ground


def broken(ground: Ground, is_good: Callable[[float], bool]) -> Ending:
    """Return the outcome of `always` with a comparison, for all arguments; NaN is not bad."""
    bad = [
        time
        for series in ground.values()
        for time, value in series
        if not (isnan(value) or is_good(value))
    ]
    return Ending('false', min(bad)) if bad else UNDECIDED


def fence(ground: dict[str, Ground]) -> Ending:
    """Return false when the first vehicle leaves the fence in the east, west or south."""
    ways = (
        broken(ground['East'], lambda metres: -30 < metres < 60),
        broken(ground['North'], lambda metres: metres > -30),
    )
    return min(ways, key=lambda ending: ending.time)


def power(ground: Ground) -> Ending:
    return min((power_of_one(series) for series in ground.values()), key=lambda end: end.time)


def power_of_one(series: Series) -> Ending:
    """Return false when it is certain for a surge that no calm follows in time."""
    gone = [
        lost_at
        for index, (_, watts) in enumerate(series)
        if watts > 150 and (lost_at := surge_lost(series[index:])) is not None
    ]
    return Ending('false', min(gone)) if gone else UNDECIDED


def surge_lost(series: Series) -> int | None:
    """Return the time at which it is certain that no calm follows a surge at the first sample."""
    begin = series[0][0]
    candidates: set[int] = set()
    highest = 0.0
    for time, watts in series[1:]:
        # Calm may begin here, unless it is too late or the power was too high before.
        if time <= begin + 5 * SECOND and highest < 200:
            candidates.add(time)
        candidates = {
            candidate for candidate in candidates if watts <= 150 or time > candidate + 3 * SECOND
        }
        if any(time >= candidate + 3 * SECOND for candidate in candidates):
            return None
        highest = max(highest, watts)
        if not candidates and (time >= begin + 5 * SECOND or highest >= 200):
            return time
    return None


def takeoff(ground: Ground) -> Ending:
    """Return true when the last vehicle has been above 5 m, as far as is known."""
    up = [
        min((time for time, height in series if height > 5), default=inf)
        for series in ground.values()
    ]
    start = min(series[0][0] for series in ground.values())
    return Ending('true', max(up)) if max(up) <= start + 15 * SECOND else UNDECIDED


def silence(messages: list[Telemetry], channel: Channel, end: int) -> Ending:
    """Return the time at which the first message of a channel is missing."""
    stamps: dict[str, list[int]] = defaultdict(list)
    for message in messages:
        if message.channel is channel:
            stamps[message.vehicle].append(message.stamp)
    missed = [
        early + SILENCE[channel]
        for times in stamps.values()
        for early, late in pairwise([*times, end])
        if late - early > SILENCE[channel]
    ]
    return Ending('CONSTRAINT_VIOLATION', min(missed)) if missed else UNDECIDED


def endings(messages: list[Telemetry], end: int) -> dict[str, Ending]:
    """Return the outcome of each formula: its verdict, or the earlier silence of a stream."""
    ground = features(messages)
    no_odometry = silence(messages, Channel.ODOMETRY, end)
    no_battery = silence(messages, Channel.BATTERY, end)
    verdicts = {
        'power': (power(ground['Power']), no_battery),
        'separation': (broken(ground['XYDist'], lambda metres: metres > 10), no_odometry),
        'ceiling': (broken(ground['Altitude'], lambda metres: metres < 30), no_odometry),
        'geofence': (fence(ground), no_odometry),
        'speed_limit': (broken(ground['Speed'], lambda speed: speed < 8), no_odometry),
        'takeoff': (takeoff(ground['Altitude']), no_odometry),
    }
    return {name: min(pair, key=lambda ending: ending.time) for name, pair in verdicts.items()}


def flight(scenario: Scenario, count: int, asked: int) -> list[Telemetry]:
    messages = Simulation(scenario, vehicle_names(count), 0).until(scenario.duration)
    return [message for message in messages if message.stamp >= asked]


def assert_as_expected(scenario: Scenario, found: dict[str, Ending]) -> None:
    assert found.keys() == scenario.expected.keys()
    for name, expectation in scenario.expected.items():
        assert (name, found[name].outcome) == (name, expectation.outcome)
        if expectation.decided_between is not None:
            earliest, latest = expectation.decided_between
            assert earliest <= found[name].time <= latest - LATENCY, name


SURGES: dict[str, tuple[list[int], float]] = {
    # Watts for each second, and the time of the verdict false.
    'calm': ([120] * 12, inf),
    'short surge': ([120, 170, 170, 120, 120, 120, 120, 120], inf),
    'at the last moment': ([160, 160, 160, 160, 160, 150, 150, 150, 150, 160, 120, 120], inf),
    'too long': ([160, 160, 160, 160, 160, 160, 120, 120, 120, 120], 5),
    'calm broken': ([160, 160, 120, 120, 160, 160, 160, 120, 120, 120, 120], 5),
    'calm broken late': ([160, 160, 160, 160, 160, 120, 120, 160, 120, 120, 120, 120], 7),
    'too strong': ([120, 160, 210, 120, 120, 120, 120, 120], 2),
    'strong at first only': ([120, 210, 120, 120, 120, 120, 120], inf),
    'strong twice': ([210, 210, 120, 120, 120, 120, 120], 1),
}

NAMES = ['geofence', 'gps_loss', 'near_miss', 'nominal', 'power_surge', 'telemetry_loss']


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize(('count', 'asked'), [(3, 0), (3, 2_500 * MS), (5, 0)])
def test_the_outcomes_of_a_scenario(
    scenarios: dict[str, Scenario], name: str, count: int, asked: int
) -> None:
    scenario = scenarios[name]
    for seed in (scenario.seed, 101):
        messages = flight(replace(scenario, seed=seed), count, asked)
        assert_as_expected(scenario, endings(messages, scenario.duration))


def asked(formula: str, messages: list[Telemetry]) -> FormulaGroup:
    """Return a group with one formula, for the vehicles of the messages."""
    vehicles = sorted({message.vehicle for message in messages})
    group = FormulaGroup()
    group.add_formula('formula', formula)
    group.begin({'UAV': vehicles}, UnknownFeatures({'Altitude': (-10, 120)}))
    return group


def progressed(formula: str, messages: list[Telemetry]) -> Ending:
    """Return the outcome of a formula by progression."""
    group = asked(formula, messages)
    for time, state in states(formula, features(messages)):
        for result in group.progress(time, state):
            assert result.decided_at == time
            return Ending(result.verdict.name.lower(), time)
    return UNDECIDED


def states(formula: str, values: dict[str, Ground]) -> list[tuple[int, dict[str, float]]]:
    """Yield states with a field for each ground feature of a formula, once all have a value."""
    by_time: dict[int, dict[str, float]] = defaultdict(dict)
    for feature, ground in values.items():
        if f'{feature}[' in formula:
            for vehicle, series in ground.items():
                other = ', uav1' if feature == 'XYDist' else ''
                for time, value in series:
                    by_time[time][f'{feature}[{vehicle}{other}]'] = value
    width = max(map(len, by_time.values()))
    return [(time, state) for time, state in sorted(by_time.items()) if len(state) == width]


@pytest.mark.parametrize('name', NAMES)
@pytest.mark.parametrize(('count', 'asked'), [(3, 0), (5, 2_500 * MS)])
def test_progression_says_the_same(
    scenarios: dict[str, Scenario],
    formulas: dict[str, RequestedFormula],
    name: str,
    count: int,
    asked: int,
) -> None:
    scenario = scenarios[name]
    messages = flight(scenario, count, asked)
    for formula, ending in endings(messages, scenario.duration).items():
        verdict = UNDECIDED if ending.outcome == 'CONSTRAINT_VIOLATION' else ending
        assert progressed(formulas[formula].text, messages) == verdict


@pytest.mark.parametrize(
    ('formula', 'wants'), [('takeoff', ['uav1']), ('ceiling', ['uav1', 'uav3'])]
)
def test_what_is_wanting_while_an_altitude_is_unknown(
    scenarios: dict[str, Scenario],
    formulas: dict[str, RequestedFormula],
    formula: str,
    wants: list[str],
) -> None:
    scenario = scenarios['gps_loss']
    begin, end = scenario.gps_losses[0].begin, scenario.gps_losses[0].end
    messages = flight(scenario, 3, 0)
    group = asked(formulas[formula].text, messages)
    for time, state in states(formulas[formula].text, features(messages)):
        assert group.progress(time, state) == [] or time >= end
        if begin <= time < end:
            assert group.wants(1) == {f'Altitude[{vehicle}]': begin for vehicle in wants}
    assert not group.undecided


@pytest.mark.parametrize('name', SURGES)
def test_progression_of_the_power_formula_says_the_same(
    formulas: dict[str, RequestedFormula], name: str
) -> None:
    watts, false_at = SURGES[name]
    group = FormulaGroup()
    group.add_formula('power', formulas['power'].text)
    group.begin({'UAV': ['uav1']})
    found = [
        result.decided_at
        for second, value in enumerate(watts)
        for result in group.progress(second * SECOND, {'Power[uav1]': float(value)})
    ]
    assert found == ([] if false_at == inf else [false_at * SECOND])


@pytest.mark.parametrize(
    'name', ['geofence', 'gps_loss', 'near_miss', 'power_surge', 'telemetry_loss']
)
def test_the_check_can_fail(scenarios: dict[str, Scenario], name: str) -> None:
    scenario = replace(scenarios[name], plans={}, gusts=(), telemetry_losses=(), gps_losses=())
    with pytest.raises(AssertionError):
        assert_as_expected(scenario, endings(flight(scenario, 3, 0), scenario.duration))


@pytest.mark.parametrize('name', SURGES)
def test_the_power_formula_by_hand(name: str) -> None:
    watts, false_at = SURGES[name]
    ending = power({'uav1': [(second * SECOND, value) for second, value in enumerate(watts)]})
    assert ending.time == false_at * SECOND
