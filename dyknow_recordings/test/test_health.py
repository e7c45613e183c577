"""The health of recordings, and the expectations that they break, against a naive reference."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from recorded import RecordedSample, at, recording, sample
from running_checks import run_check
from small_bags import START, channel, chunk, mcap, messages, schema, stored, write

from dyknow_common import SECOND_NS, StreamConstraints
from dyknow_configuration import TopicExpectation
from dyknow_recordings.health import broken_in, health_of
from dyknow_recordings.reading.opening import open_recording

MS = 1_000_000

# Of each message: the time in ms since the receipt of the one before, and its delay; None for a
# message whose stamp is unset.
DRAWN = st.lists(
    st.tuples(st.integers(0, 2_000), st.one_of(st.none(), st.integers(-50, 300))),
    min_size=1,
    max_size=40,
)
BOUNDS = st.sampled_from((1, 100, 333, 500, 1_500))


def received(drawn: list[tuple[int, int | None]]) -> list[RecordedSample]:
    """The messages of a topic, and the first and last message of the recording."""
    time, found = at(0), [sample('/clock', 0)]
    for distance, delay in drawn:
        time += distance * MS
        stamp = 0 if delay is None else time - delay * MS
        found.append(RecordedSample(time, '/a', 'a/msg/B', stamp, {'v': 1}))
    end = (time - at(0)) / SECOND_NS + 1
    return [*found, sample('/clock', end)]


def valid_times(found: list[RecordedSample]) -> list[int]:
    return [each.stamp or each.log_time for each in found if each.topic == '/a']


@given(DRAWN, BOUNDS)
def test_gaps_and_delays(drawn: list[tuple[int, int | None]], bound: int) -> None:
    found = received(drawn)
    own = [each for each in found if each.topic == '/a']
    start, end = found[0].log_time, found[-1].log_time
    valid = sorted(valid_times(found))
    gaps = [own[0].log_time - start, end - own[-1].log_time, *(b - a for a, b in pairwise(valid))]
    delays = [each.log_time - (each.stamp or each.log_time) for each in own]

    (health,) = [each for each in health_of(recording(found)).health if each.topic == '/a']
    assert (health.messages, health.gap) == (len(own), max(gaps))
    assert health.unstamped == sum(delay is None for _, delay in drawn)
    assert health.stamped_ahead == sum(each < 0 for each in delays)
    assert health.timing is not None
    assert health.timing.delays is not None
    assert health.timing.delays[-1] == max(delays)
    assert health.timing.delays[0] in {*delays} | {median(delays)}

    constraints = StreamConstraints(max_gap=bound * MS, max_delay=bound * MS, max_lead=10 * MS)
    expected = TopicExpectation('/a', constraints=constraints, stamped=True)
    rules = {each.rule for each in broken_in(recording(found), [expected])}
    assert rules == {
        *(['max_gap'] if max(gaps) > bound * MS else []),
        *(['max_delay'] if max(delays) > bound * MS else []),
        *(['max_lead'] if min(delays) < -10 * MS else []),
        *(['stamped'] if any(delay is None for _, delay in drawn) else []),
    }


@pytest.mark.parametrize('first', [0, 10])
def test_all_rows_of_a_trace_have_a_stamp(first: int, tmp_path: Path) -> None:
    path = tmp_path / 'a.csv'
    path.write_text(f'time_s,x\n{first},1\n{first + 1},2\n')
    with open_recording(path) as trace:
        assert not broken_in(trace, [TopicExpectation('/trace', stamped=True)])


@given(DRAWN, st.sampled_from((0.5, 1.0, 3.0, 10.0)))
@example([(100, 0)] * 40, 10.0)
def test_rates(drawn: list[tuple[int, int | None]], rate: float) -> None:
    found = received(drawn)
    start, end = found[0].log_time, found[-1].log_time
    length = max(5 * SECOND_NS, int(10 * SECOND_NS / rate))
    edges = [start + number * length for number in range(max(1, (end - start) // length))]
    slow = fast = False
    for begin, stop in pairwise([*edges, end + 1]):
        count = sum(begin <= each.log_time < stop for each in found if each.topic == '/a')
        slow |= count + 1 < rate * (stop - begin) / SECOND_NS
        fast |= count - 1 > rate * (stop - begin) / SECOND_NS
    expected = TopicExpectation('/a', min_rate=rate, max_rate=rate)
    rules = {each.rule for each in broken_in(recording(found), [expected])}
    assert rules == {*(['min_rate'] if slow else []), *(['max_rate'] if fast else [])}


def test_places() -> None:
    times = [n / 10 for n in range(125)] + [n / 10 for n in range(151, 600)]
    found = [sample('/scan', time, delay=0.25 if 20 < time < 20.25 else 0.01) for time in times]
    clock = [sample('/clock', 0), sample('/clock', 65)]
    constraints = StreamConstraints(max_gap=500 * MS, max_delay=200 * MS)
    expected = [
        TopicExpectation('/scan', 'a/msg/Scan', 9.5, constraints=constraints),
        TopicExpectation('/lost'),
    ]
    shown = [str(each) for each in broken_in(recording([*clock, *found]), expected)]
    assert shown == [
        '/scan: its type is test_msgs/msg/Values, not a/msg/Scan',
        '/scan: silent for 2.7 s from 12.410 s to 15.110 s, max_gap is 500 ms',
        '/scan: silent for 5.09 s from 59.910 s to 65.000 s, max_gap is 500 ms',
        '/scan: 5 Hz from 10.000 s to 15.000 s, min_rate is 9.5 Hz',
        '/scan: 0 Hz from 60.000 s to 65.000 s, min_rate is 9.5 Hz',
        '/scan: 1 message late by up to 250 ms at 20.350 s, max_delay is 200 ms',
        '/scan: 1 message late by up to 250 ms at 20.450 s, max_delay is 200 ms',
        '/lost: it is not recorded',
    ]


def test_sensors_that_go_together() -> None:
    left = [sample('/left', n / 10) for n in range(50)]
    right = [sample('/right', n / 10 + 0.004, delay=0.01) for n in range(50)]
    other = [sample('/other', n / 9.7) for n in range(50)]
    drifting = [sample('/drifting', n / 9.9) for n in range(50)]
    found = {
        each.topic: each for each in health_of(recording(left + right + other + drifting)).health
    }
    offsets = {name: (each.offset_from, each.offset) for name, each in found.items()}
    assert offsets == {
        '/drifting': ('', None),
        '/left': ('', None),
        '/right': ('/left', 4 * MS),
        '/other': ('', None),
    }


def test_the_command(tmp_path: Path) -> None:
    bag, robot = tmp_path / 'bag', tmp_path / 'robot.yaml'
    write(bag, 'mcap', 'none', messages(300))
    robot.write_text('topics: {/odom: {max_gap: 50 ms, stamped: true}, /scan: {max_delay: 6 ms}}\n')
    options = [bag, '--config', robot]
    assert run_check(*options, '--health').code == 0
    assert run_check(*options).code == 0
    robot.write_text('topics: {/odom: {max_gap: 20 ms}, /gone: }\n')
    health = run_check(*options, '--health', '--json')
    found = run_check(*options, '--json', '--junit', tmp_path / 'report.xml')
    assert health.code == found.code == 1
    broken = found.document['broken_expectations']
    assert broken == health.document['broken_expectations']
    assert [each['rule'] for each in broken] == ['max_gap', 'topic']
    report = (tmp_path / 'report.xml').read_text()
    assert 'failures="2"' in report
    found = run_check(*options, '--formula', 'always "/odom".pose.pose.position.z >= 0')
    assert (found.code, '/gone: it is not recorded' in found.out) == (1, True)


def test_losses(tmp_path: Path) -> None:
    path = tmp_path / 'lost.mcap'
    numbers = [n for n in range(1, 40) if n not in {7, 8}]
    records = [stored(1, START + n * 10 * MS, b'\0\1\0\0\1', n) for n in numbers]
    definition = schema(1, 'std_msgs/msg/Bool', 'bool data') + channel(1, 1, '/armed')
    path.write_bytes(mcap(definition, chunk(records, (START + 10 * MS, START + 390 * MS))))
    found = run_check(path, '--health', '--json')
    assert found.code == 0
    (topic,) = found.document['health']
    assert (topic['missing'], topic['gap_ns'], topic['unstamped']) == (2, 30 * MS, None)
    strict = run_check(path, '--health', '--strict')
    assert (strict.code, '2 missing by the sequence numbers' in strict.out) == (2, True)
