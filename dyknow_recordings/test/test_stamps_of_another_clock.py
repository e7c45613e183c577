"""Recordings of a simulation: the log times are those of another clock than the stamps."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest
from running_checks import run_check
from small_bags import (
    START,
    STORE,
    channel,
    chunk,
    header,
    mcap,
    schema,
    stored,
    write_messages,
)

from dyknow_recordings import Bag
from dyknow_recordings.cut import add_cut_options

MS, S = 1_000_000, 1_000_000_000
POINT = 'geometry_msgs/msg/PointStamped'
SIMULATED = 100 * S

CONFIGURATION = """
features:
  X: {from: {topic: /a, field: point.x, max_gap: 300 ms, max_delay: 200 ms%s}}
formulas: [{name: low, formula: always X < 5}]
topics: {/a: {min_rate: 9 Hz, max_delay: 100 ms}}
"""


def written(
    folder: Path, values: list[float], *, clocks: dict[str, int], storage: str = 'mcap'
) -> Path:
    """A bag of points, 10 ms after their stamps by the clock of each topic."""
    types, messages = STORE.types, []
    for number, value in enumerate(values):
        for topic, clock in clocks.items():
            point = types['geometry_msgs/msg/Point'](value, 0.0, 0.0)
            stamped = types[POINT](header(clock + number * 100 * MS, ''), point)
            messages.append((START + (number * 100 + 10) * MS, topic, stamped))
    write_messages(folder / 'bag', messages, storage=storage)
    return folder / 'bag'


def configured(folder: Path, more: str = '') -> Path:
    file = folder / 'robot.yaml'
    file.write_text(CONFIGURATION % more)
    return file


@pytest.mark.parametrize(('worst', 'code'), [(4.0, 0), (6.0, 1)])
def test_no_delay_follows_from_stamps_of_another_clock(
    tmp_path: Path, worst: float, code: int
) -> None:
    """The configuration of the live robot applies; a note says what is not checked."""
    bag = written(tmp_path, [1.0] * 20 + [worst, 1.0], clocks={'/a': SIMULATED})
    found = run_check(bag, '--config', str(configured(tmp_path)), '--json')
    assert found.code == code, found
    document = json.loads(found.out)
    assert document['broken_expectations'] == []
    (note,) = document['notes']
    assert note == (
        "topic '/a': max_delay is not checked, as the stamps are of another clock than the log "
        'times; record a simulation with: ros2 bag record --use-sim-time'
    )
    assert run_check(bag, '--config', str(configured(tmp_path)), '--strict').code == 2


def test_gaps_are_still_checked(tmp_path: Path) -> None:
    bag = written(tmp_path, [1.0] * 20, clocks={'/a': SIMULATED})
    found = run_check(bag, '--formula', 'always "/a".point.x < 5')
    assert found.code == 0, found
    file = configured(tmp_path)
    file.write_text(file.read_text().replace('300 ms', '50 ms'))
    found = run_check(bag, '--config', str(file))
    assert found.code == 2
    assert 'max_gap is 50 ms' in ' '.join(found.out.replace('│', ' ').split())


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_single_wrong_clock_is_a_violation(tmp_path: Path, storage: str) -> None:
    """The clock of one sender is wrong: then it is to be set."""
    clocks = {'/a': SIMULATED, '/b': START}
    bag = written(tmp_path, [1.0] * 20, clocks=clocks, storage=storage)
    found = run_check(bag, '--config', str(configured(tmp_path)), '--json')
    document = json.loads(found.out)
    assert found.code == 2
    assert document['notes'] == []
    (expectation,) = document['broken_expectations']
    assert expectation['message'].startswith('20 messages late by up to ')
    error = document['formulas'][0]['error']['message']
    assert 'is stamped 1699999900 s before its receipt, as by another clock;' in error


@pytest.mark.parametrize(('begin', 'topics'), [(500 * MS, set()), (3 * S, {'/a', '/b'})])
def test_the_begin_shows_the_clock(tmp_path: Path, begin: int, topics: set[str]) -> None:
    """All topics of the first second count, in several chunks."""

    def part(key: int, clock: int, time: int) -> bytes:
        point = STORE.types['geometry_msgs/msg/Point'](1.0, 0.0, 0.0)
        message = STORE.types[POINT](header(clock + time, ''), point)
        data = bytes(STORE.serialize_cdr(message, POINT))
        return chunk([stored(key, START + time, data)], (START + time, START + time))

    channels = schema(1, POINT) + channel(1, 1, '/a') + channel(2, 1, '/b')
    times = [(1, SIMULATED, 0), (1, SIMULATED, 2 * S), (2, START, begin)]
    parts = [part(*each) for each in sorted(times, key=lambda each: each[2])]
    path = tmp_path / 'a.mcap'
    path.write_bytes(mcap(channels, *parts))
    with Bag(path) as bag:
        assert bag.other_clock == topics


def test_order_needs_a_delay(tmp_path: Path) -> None:
    bag = written(tmp_path, [1.0] * 20, clocks={'/a': SIMULATED})
    found = run_check(bag, '--config', str(configured(tmp_path, ', reorder: true')), '--json')
    assert found.code == 2
    error = json.loads(found.out)['formulas'][0]['error']['message']
    assert 'record a simulation with: ros2 bag record --use-sim-time' in error


def test_health(tmp_path: Path) -> None:
    bag = written(tmp_path, [1.0] * 20, clocks={'/a': SIMULATED})
    found = run_check(bag, '--config', str(configured(tmp_path)), '--health')
    assert found.code == 0, found
    assert '1699999900' not in found.out + found.err
    assert "topic '/a': max_delay is not checked" in found.err
    found = run_check(bag, '--health', '--json')
    assert json.loads(found.out)['health'][0]['timing']['delays_ns'] is None


@pytest.mark.parametrize(
    ('formula', 'span', 'reason'),
    [
        ('always "/a".point.x < 5', '3.900 s to 6.000 s', 'is false at 5.000 s'),
        ('eventually[0 s, 20 s] "/a".point.x > 9', '0.000 s to 7.000 s', 'is not met'),
    ],
)
def test_cut_shows_the_times_of_a_check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], formula: str, span: str, reason: str
) -> None:
    """The span and the failure count from the start; the part shows the failure."""
    bag = written(tmp_path, [1.0] * 50 + [6.0] + [1.0] * 20, clocks={'/a': SIMULATED})
    parser = argparse.ArgumentParser()
    add_cut_options(parser)
    words = (bag, '--formula', formula, '--before', '1', '--after', '1')
    options = parser.parse_args(map(str, (*words, '-o', tmp_path / 'parts')))
    assert options.command(options) == 0
    shown = capsys.readouterr().out
    assert f': {span}, ' in shown
    assert shown.endswith(f"' {reason}\n")
