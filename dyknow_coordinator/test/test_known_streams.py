"""The streams that sources are made from, and their availability."""

from dataclasses import replace

import pytest

from dyknow_common import SECOND_NS, StreamConstraints, Symbol, SymbolKind
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import FeatureSource, referenced_source
from dyknow_coordinator.grounding.known_streams import KnownStream, KnownStreams, field_names

ODOMETRY = '/uav1/odometry'
RATE = 'compunit v: float slope(a: float)'
STREAMS = (
    KnownStream('altitude', f'select z as altitude from "{ODOMETRY}"', '/dyknow/streams/altitude'),
    KnownStream(
        'climb',
        'compunit v: float slope(a: float); stream smooth = altitude; sink slope(smooth)',
        '/x/climb',
    ),
    KnownStream('laser', '', '/uav1/laser', message_type='std_msgs/msg/Float64'),
    KnownStream('waiting', 'select a from nowhere'),
)


def source(text: str) -> FeatureSource:
    return FeatureSource('F', 'made', f'stream made = {text}')


@pytest.fixture
def known() -> KnownStreams:
    published = {ODOMETRY, '/dyknow/streams/altitude', '/x/climb', 'dyknow/streams/foreign'}
    return KnownStreams(STREAMS, published.__contains__)


def test_streams_that_wait_do_not_flow(known: KnownStreams) -> None:
    assert known.published() == {'altitude', 'climb', 'laser'}


def test_origins_are_found_through_streams(known: KnownStreams) -> None:
    found = known.origins(source('select v from climb'))
    streams = {'climb', '/x/climb', 'altitude', '/dyknow/streams/altitude'}
    assert found == streams | {'smooth', ODOMETRY}
    assert known.origins(source('select v from "/x/climb"')) == found


def test_the_ids_of_the_streams_that_states_are_made_from() -> None:
    def known(climb: int) -> KnownStreams:
        ids = {'altitude': 7, 'climb': climb}
        streams = [replace(each, stream_id=ids.get(each.name, 0)) for each in STREAMS]
        return KnownStreams(streams, lambda _: True)

    altitude = source('select altitude from "/dyknow/streams/altitude"')
    others = source('select data from laser'), source('select a from waiting')
    assert known(9).identities([altitude, *others]) == {'/dyknow/streams/altitude': 7}
    climb = source('sync(climb, altitude)')
    assert known(9).identities([climb]) == {'/x/climb': 9, '/dyknow/streams/altitude': 7}
    assert known(0).identities([altitude])
    with pytest.raises(CoordinationError, match="'climb' is being made or replaced"):
        known(0).identities([altitude, climb])


@pytest.mark.parametrize(
    ('text', 'there'),
    [
        ('select v from climb', True),
        (f'select z from "{ODOMETRY}"', True),
        ('select z from "/nowhere"', False),
        ('select a from waiting', False),
        ('select data from laser', False),
        ('select a from foreign', True),
        ('select a from unknown', False),
    ],
)
def test_a_source_is_there_if_all_that_it_names_is(
    known: KnownStreams, text: str, *, there: bool
) -> None:
    assert known.is_available(source(text)) is there


def test_a_stream_whose_topics_nobody_publishes_is_not_there() -> None:
    """Its engine publishes it, without samples: a source that has failed is better."""
    known = KnownStreams(STREAMS, {'/dyknow/streams/altitude', '/x/climb'}.__contains__)
    for text in ('altitude', 'select v from climb', 'select altitude from "/x/climb"'):
        assert not known.is_available(source(text)), text


def test_one_topic_of_transforms_is_enough() -> None:
    for published, there in (({'/tf'}, True), ({'/tf_static'}, True), (set(), False)):
        known = KnownStreams((), published.__contains__)
        assert known.is_available(source('tf("map", "base")')) is there
        begun = KnownStreams((), lambda _: True, has_begun=published.__contains__)
        assert begun.is_flowing(source('tf("map", "base")')) is there


def test_messages_count_from_a_time_on() -> None:
    made, both = source('select z from "/a"'), source('sync("/a", "/b")')
    known = KnownStreams([KnownStream('s', received={'/a': 3, '/b': 0})], lambda _: True)
    assert known.are_received('s', made, 2)
    assert not known.are_received('s', made, 3)
    assert not known.are_received('s', both, 2)
    assert not known.are_received('unreported', made, 2)


@pytest.mark.parametrize(
    ('origin', 'names'),
    [
        ('climb', {'a'}),
        ('smooth', {'a'}),
        ('altitude', {'a', 'b'}),
        (ODOMETRY, {'a', 'b', 'c'}),
        (f'select z from "{ODOMETRY}"', {'a', 'b', 'c'}),
        ('laser', {'d'}),
        ('c', {'c'}),
        ('the_states', set()),
    ],
)
def test_suspects_are_made_from_what_failed(
    known: KnownStreams, origin: str, names: set[str]
) -> None:
    chosen = [
        FeatureSource('F', name, f'stream {name} = {text}')
        for name, text in {
            'a': 'select v from climb',
            'b': 'select altitude from altitude',
            'c': f'select x from "{ODOMETRY}"',
            'd': 'select data from laser',
        }.items()
    ]
    assert {each.stream for each in known.affected(chosen, origin)} == names


@pytest.mark.parametrize(
    ('text', 'fields'),
    [
        ('select a, b as c from s', ('a', 'c')),
        ('compunit v: float mean(a: float); sink mean(s)', ('v',)),
        ('stream x = select a from s; stream y = select b from s; sink sync(x, y)', ('a', 'b')),
        ('merge(s, s)', ('of_s',)),
        ('"/topic"', ('of_/topic',)),
        ('source (a: float, b: int) "/topic"; stream x = "/topic"; sink x', ('a', 'b')),
        ('select a as A%b% from s', ()),
    ],
)
def test_the_fields_of_a_stream_are_read_off_its_text(text: str, fields: tuple[str, ...]) -> None:
    assert field_names(text, lambda name: [f'of_{name}'], lambda name: [f'of_{name}']) == fields


def test_a_reference_names_its_topic() -> None:
    made = referenced_source(Symbol(SymbolKind.FEATURE, f'"{ODOMETRY}".z'))
    assert KnownStreams((), lambda _: True).origins(made) == {ODOMETRY}


def test_relative_topics_are_known_by_their_absolute_names() -> None:
    made = source('select z from "odometry"')
    known = KnownStreams((), lambda _: True, lambda topic: f'/uav1/{topic}')
    assert known.affected([made], '/uav1/odometry') == (made,)
    assert known.affected([made], 'odometry') == (made,)


PERIODIC = 'with sample_period = 2 s, sample_period_deviation = 1 s'


@pytest.mark.parametrize(
    ('text', 'silences', 'overdue'),
    [
        (f'select z from "/a" {PERIODIC}', {'/a': 4}, True),
        (f'select z from "/a" {PERIODIC}', {'/a': 3}, False),
        # It has never had a message.
        (f'select z from "/a" {PERIODIC}', {'/b': 9}, False),
        ('select z from "/a"', {'/a': 9}, False),
        ('select z from regular', {'/a': 4, '/b': 0}, True),
        ('select z from regular', {'/a': 3, '/b': 0}, False),
        ('select z from inner', {'/a': 4}, True),
        ('select z from constrained', {'/a': 4}, True),
        # It goes on as long as one of its inputs does.
        ('select z from merged', {'/a': 4, '/b': 0}, False),
        ('select z from merged', {'/a': 4, '/b': 4}, True),
        ('sync("/a", "/b") with sample_period = 1 s', {'/a': 9, '/b': 9}, False),
        ('select z from ticks', {'/a': 9, '/b': 9}, False),
        ('select z from "/a" with max_gap = 3 s', {'/a': 4}, True),
        ('select z from "/a" with max_gap = 3 s', {'/a': 3}, False),
        (
            'select z from "/a" with max_gap = 3 s, max_delay = 1 s, expires = true',
            {'/a': 9},
            False,
        ),
        ('sync("/a", "/b") with max_gap = 1 s', {'/a': 9, '/b': 9}, True),
        ('sync("/a", "/b") with max_gap = 2 s, sample_period = 1 s', {'/a': 9, '/b': 9}, False),
    ],
)
def test_a_source_with_a_period_is_overdue_after_it(
    text: str, silences: dict[str, int], *, overdue: bool
) -> None:
    streams = [
        KnownStream('regular', f'select z from "/a" {PERIODIC}', '/x/regular'),
        KnownStream('inner', f'stream i = "/a" {PERIODIC}; stream j = i; sink select z from j'),
        KnownStream(
            'constrained',
            'select z from "/a"',
            constraints=StreamConstraints(sample_period=3 * SECOND_NS),
        ),
        KnownStream('merged', f'merge("/a", "/b") {PERIODIC}'),
        KnownStream('ticks', 'sync("/a", "/b") with sample_period = 1 s'),
    ]
    known = KnownStreams(streams, lambda _: True)
    passed = {topic: seconds * SECOND_NS for topic, seconds in silences.items()}
    assert known.is_overdue(source(text), passed) is overdue
