"""Streams on a terminal."""

from dataclasses import replace

import pytest
from rich.console import Console, RenderableType

from dyknow_common import StreamConstraints
from dyknow_stream_processing.reporting.stream_report import (
    NO_FLOW,
    Flow,
    SourceReport,
    StreamReport,
    StreamState,
)
from dyknow_stream_processing.reporting.stream_table import as_json, stream_details, stream_table

MS = 1_000_000
FLOWING = StreamReport(
    'power',
    StreamState.FLOWING,
    engine='/engine',
    topic='/dyknow/streams/power',
    specification='stream a = select x from "/t";\nsink a',
    constraints=StreamConstraints(max_delay=100 * MS),
    samples=120,
    violations=2,
    drops={'max_delay': 2, 'fields': 1},
    sources=(SourceReport('/silent'), SourceReport('/t', 200, 1_000 * MS)),
    flow=Flow(9.96, 12 * MS, 31 * MS),
)
WAITING = StreamReport('late', StreamState.WAITING, message='no stream F[a]\n  there')
REGISTERED = StreamReport(
    'tank', StreamState.REGISTERED, topic='/tank', message_type='std_msgs/msg/Float64'
)


def printed(what: RenderableType, width: int) -> list[str]:
    console = Console(width=width)
    with console.capture() as captured:
        console.print(what)
    return captured.get().splitlines()


def shown(what: RenderableType) -> list[str]:
    """The lines without the space between columns."""
    return [' '.join(line.split()) for line in printed(what, 160)]


def test_a_line_for_each_stream() -> None:
    lines = shown(stream_table([FLOWING, WAITING, REGISTERED], ['/engine']))
    assert lines == [
        'stream state samples rate delay max dropped violations',
        'power flowing 120 10.0 Hz 12 ms 31 ms 3 2',
        'late waiting no stream F[a]',
        'tank registered /tank',
        '/engine',
    ]


def test_a_stream_that_waits_again_shows_what_it_has_had() -> None:
    silent = replace(
        FLOWING, state=StreamState.WAITING, message='nobody publishes /t', flow=NO_FLOW
    )
    assert shown(stream_table([silent], ['/engine']))[1] == (
        'power waiting 120 3 2 nobody publishes /t'
    )


def test_no_number_is_cut_in_80_columns() -> None:
    many = replace(
        FLOWING,
        name='rover1_battery_percentage',
        samples=1_234_567,
        violations=12_345,
        drops={'max_delay': 123_456},
        flow=Flow(1000.0, -5_010 * MS, 1_310 * MS),
    )
    late = replace(WAITING, message='nobody publishes /rover[1]/odom; ' * 3)
    table = stream_table([many, late], ['/engine'], hidden=2)
    assert [line.rstrip() for line in printed(table, 80)] == [
        'stream          state   samples      rate        delay    max dropped violations',
        'rover1_battery_ flowing 1234567 1000.0 Hz ahead 5.01 s 1.31 s  123456      12345',
        'percentage',
        'late            waiting',
        '  nobody publishes /rover[1]/odom; nobody publishes /rover[1]/odom; nobody',
        '  publishes /rover[1]/odom;',
        "/engine; 2 of DyKnow's own streams not shown (--all shows them)",
    ]


def test_stamps_ahead_of_the_clock() -> None:
    """Of forecasts, and of a topic whose samples are all dropped."""
    forecasts = replace(FLOWING, flow=Flow(9.96, -5_010 * MS, 12 * MS))
    assert 'power flowing 120 10.0 Hz ahead 5.01 s 12 ms 3 2' in shown(
        stream_table([forecasts], [])
    )
    assert 'delay ahead 5.01 s, 12 ms at most' in shown(stream_details(forecasts, 0))
    topic = SourceReport('/t', 200, 1_000 * MS, -5_010 * MS)
    dropped = replace(FLOWING, flow=Flow(), sources=(SourceReport('/other'), topic))
    assert 'power flowing 120 0.0 Hz ahead 5.01 s 3 2' in shown(stream_table([dropped], []))
    waiting = replace(dropped, state=StreamState.WAITING, message='all dropped')
    assert 'power waiting 120 ahead 5.01 s 3 2 all dropped' in shown(stream_table([waiting], []))
    lines = shown(stream_details(dropped, 1_310 * MS))
    assert 'delay ahead 5.01 s' in lines
    assert '/t: 200 received, the latest 310 ms ago, stamped ahead 5.01 s' in lines


def test_where_a_topic_loses_its_time() -> None:
    source = SourceReport('/t', 200, 1_000 * MS, 4_050 * MS, 2_000 * MS, 2_050 * MS)
    lines = shown(stream_details(replace(FLOWING, sources=(source,)), 1_310 * MS))
    assert (
        '/t: 200 received, the latest 310 ms ago, stamped 2 s before it was sent, clock of the '
        'sender 2.05 s behind'
    ) in ' '.join(lines)
    ahead = replace(source, before_sending=90 * MS, transport=-300 * MS)
    lines = shown(stream_details(replace(FLOWING, sources=(ahead,)), 1_310 * MS))
    assert 'the latest 310 ms ago, clock of the sender 300 ms ahead' in ' '.join(lines)


def test_the_engines_where_there_are_several() -> None:
    lines = shown(stream_table([FLOWING], ['/engine', '/robot1/engine']))
    assert lines[1].endswith(' 3 2 /engine')
    assert lines[-1] == '/engine, /robot1/engine'


def test_no_streams() -> None:
    lines = shown(stream_table([], ['/engine'], hidden=2))
    assert lines[0].startswith('There are no named streams; formulas over topics need none. To')
    assert lines[-1] == "/engine; 2 of DyKnow's own streams not shown (--all shows them)"


def test_that_there_is_no_engine() -> None:
    assert shown(stream_table([], []))[-1] == 'no stream processing engine is running'


def test_everything_about_a_stream() -> None:
    assert shown(stream_details(FLOWING, 1_310 * MS)) == [
        'stream power',
        'state flowing',
        'engine /engine',
        'topic /dyknow/streams/power',
        'type dyknow_interfaces/msg/Sample',
        'constraints max_delay = 100 ms',
        'samples 120 (10.0 Hz now)',
        'delay 12 ms, 31 ms at most',
        'dropped 1 fields, 2 max_delay',
        'violations 2',
        'made of /silent: nothing has come yet',
        '/t: 200 received, the latest 310 ms ago',
        '',
        'stream a = select x from "/t";',
        'sink a',
    ]
    still = shown(stream_details(replace(FLOWING, flow=Flow(), drops={}), 0))
    assert 'dropped none' in still
    assert not [line for line in still if line.startswith('delay')]


@pytest.mark.parametrize('account', [WAITING, REGISTERED])
def test_what_is_not_known_is_left_out(account: StreamReport) -> None:
    assert not [line for line in shown(stream_details(account, 0)) if 'samples' in line]


def test_a_stream_for_programs() -> None:
    document = as_json(FLOWING)
    zero = {'delay_ns': 0, 'before_sending_ns': 0, 'transport_ns': 0, 'stream_id': 0}
    zero |= {'rate_hz': 0.0, 'drops': {}}
    assert document['state'] == 'FLOWING'
    assert document['constraints'] == {'max_delay': 100 * MS}
    assert list(document['sources']) == [
        {'topic': '/silent', 'samples': 0, 'latest_ns': None, **zero},
        {'topic': '/t', 'samples': 200, 'latest_ns': 1_000 * MS, **zero},
    ]
    assert document['drops'] == {'max_delay': 2, 'fields': 1}
    assert (document['rate_hz'], document['mean_delay_ns'], document['max_delay_ns']) == (
        9.96,
        12 * MS,
        31 * MS,
    )
