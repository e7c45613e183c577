"""The stream manager's registry of streams and engines."""

import pytest

from dyknow_common import NO_CONSTRAINTS, ExitCode, StreamConstraints
from dyknow_stream_processing import StreamError
from dyknow_stream_processing.management.naming import Namespaces, NamingConvention, check_name
from dyknow_stream_processing.management.registry import (
    StreamRegistry,
    engines_missing,
    name_taken,
    two_streams,
)
from dyknow_stream_processing.management.streams import CreatedStream, RegisteredStream
from dyknow_stream_processing.reporting.stream_report import SAMPLE_TYPE, StreamReport, StreamState

E1, E2, FAR = '/e1', '/e2', '/far/e3'


def created(name: str, specification: str = 'select a from "/t"') -> CreatedStream:
    return CreatedStream(name, specification, NO_CONSTRAINTS)


def place(registry: StreamRegistry, name: str, engine: str) -> None:
    topic = f'{engine.rpartition("/")[0]}/dyknow/streams/{name}'
    registry.place(name, engine, topic, {})


def reported_by(
    registry: StreamRegistry,
    engine: str,
    name: str,
    text: str,
    constraints: StreamConstraints,
    topic: str,
) -> CreatedStream:
    report = StreamReport(
        name, StreamState.FLOWING, topic=topic, specification=text, constraints=constraints
    )
    return registry.reported_stream(engine, report)


@pytest.fixture
def registry() -> StreamRegistry:
    """Two streams on engine `/e1`, one on `/e2`, one that waits, and a registered topic."""
    known = StreamRegistry()
    for name, engine in (('a', E1), ('b', E1), ('c', E2)):
        known.add(created(name))
        place(known, name, engine)
    known.add(created('waiting'))
    known.add(RegisteredStream('battery', '/uav1/battery', 'sensor_msgs/msg/BatteryState'))
    return known


def test_only_streams_that_flow_are_listed(registry: StreamRegistry) -> None:
    assert registry.names() == ('a', 'b', 'battery', 'c')
    assert [stream.name for stream in registry.waiting()] == ['waiting']


def test_an_unknown_stream_is_answered_with_those_there_are(registry: StreamRegistry) -> None:
    for ask in (registry.find, registry.topic, registry.remove):
        with pytest.raises(
            StreamError, match=r"no stream 'z' \(there are: a, b, battery, c\)"
        ) as e:
            ask('z')
        assert e.value.code is ExitCode.NOT_FOUND


def test_an_unknown_stream_may_be_a_relative_topic() -> None:
    topics = {
        name: (topic, 'sensor_msgs/msg/Range')
        for name, topic in (('rng', '/robot1/rng'), ('root', '/root'))
    }
    varying = '; where the namespace varies, make a stream or a feature of "rng"'
    known = StreamRegistry(published=topics.get)
    known.add(created('_states_1'))
    place(known, '_states_1', E1)
    for name, hint in (
        ('rng', f'; for the topic, write "/robot1/rng"{varying}'),
        ('root', '; for the topic, write "/root"'),
        ('nowhere', ''),
    ):
        with pytest.raises(StreamError) as e:
            known.topic(name)
        assert str(e.value).endswith(f"there is no stream '{name}' (there are: none){hint}")


@pytest.mark.parametrize(
    ('name', 'words'),
    [('a', "a stream 'a' already; destroy"), ('waiting', 'already, which is not made yet')],
)
def test_a_name_is_given_once(registry: StreamRegistry, name: str, words: str) -> None:
    with pytest.raises(StreamError, match=words) as error:
        registry.add(created(name))
    assert error.value.code is ExitCode.ALREADY_EXISTS


def test_the_engine_with_the_fewest_streams_is_chosen(registry: StreamRegistry) -> None:
    assert registry.least_loaded([E1, E2]) == E2
    assert registry.least_loaded([E1, E2, FAR]) == FAR
    assert registry.least_loaded([]) is None
    registry.assign('waiting', E2)
    assert registry.least_loaded([E1, E2]) == E1


@pytest.mark.parametrize(
    ('kept', 'text', 'engines'),
    [
        ('/limit', 'sync(limit, "/speed")', {E1}),
        ('/limit', 'select a from half', {E2}),
        ('/limit', 'sync(limit, half)', {E1, E2}),
        ('/limit', 'select a from registered', set()),
        ('/limit', 'select a from "/limit"', set()),
        ('/limit', 'select a from from_registered', {E1}),
        ('/tank', 'select a from declared', {E2}),
        ('/speed', 'select a from half', set()),
        ('/tf_static', 'select yaw from pose', {E1}),
        ('/dock/_action/status', 'select name from docking', {E1}),
    ],
)
def test_engines_that_have_the_last_value_of_a_kept_topic(
    kept: str, text: str, engines: set[str]
) -> None:
    known = StreamRegistry()
    known.add(RegisteredStream('registered', '/limit', 'std_msgs/msg/Float64'))
    for name, specification, engine in (
        ('limit', 'select a from "/limit"', E1),
        ('half', 'select a from limit', E2),
        ('from_registered', 'select a from registered', E1),
        ('declared', 'source (a: float) "/tank"; sink select a from "/tank"', E2),
        ('pose', 'tf("map", "base")', E1),
        ('docking', 'action("/dock")', E1),
    ):
        known.add(created(name, specification))
        place(known, name, engine)
    known.add(created('new', text))
    assert known.keepers(created('new', text), {kept}.__contains__) == engines


def test_the_streams_of_a_lost_engine_wait_for_another(registry: StreamRegistry) -> None:
    registry.withdraw_all(E1)
    assert [stream.name for stream in registry.waiting()] == ['a', 'b', 'waiting']
    assert registry.names() == ('battery', 'c')
    assert registry.waiting()[0].message == '/e1 is gone'


def test_what_an_engine_is_asked_for_is_left_to_the_caller(registry: StreamRegistry) -> None:
    registry.assign('waiting', E2)
    registry.withdraw_all(E2)
    assert [stream.name for stream in registry.waiting()] == ['c']


def test_what_another_engine_makes_is_read_from_its_topic(registry: StreamRegistry) -> None:
    text, sources = registry.text_for(created('x', 'sync(a, c, battery)'), E1)
    assert text == (
        'stream battery = "/uav1/battery";\n'
        'stream c = "/dyknow/streams/c";\nsink sync(a, c, battery)'
    )
    assert sources == {'battery': '/uav1/battery', 'c': '/dyknow/streams/c'}


def test_relative_topics_mean_the_same_on_engines_elsewhere() -> None:
    registry = StreamRegistry(namespace='/robot1')
    stream = created('x', 'source (v: float) battery; sink sync(battery, "gps", "/clock")')
    assert registry.text_for(stream, '/robot1/e')[0] == (
        'source (v: float) battery;\nsink sync(battery, "gps", "/clock")'
    )
    assert registry.text_for(stream, FAR)[0] == (
        'source (v: float) "/robot1/battery";\n'
        'sink sync("/robot1/battery", "/robot1/gps", "/clock")'
    )
    reported = reported_by(
        registry, FAR, 'y', 'select a from "gps"', NO_CONSTRAINTS, '/far/dyknow/streams/y'
    )
    assert reported.specification == 'sink select a from "/far/gps"'


@pytest.mark.parametrize(
    ('text', 'words', 'code'),
    [
        ('select a from waiting', "stream 'waiting' waits", ExitCode.UNAVAILABLE),
        ('select a from nowhere', "no stream 'nowhere'", ExitCode.NOT_FOUND),
        ('select a from x', 'made from itself', ExitCode.INVALID_ARGUMENT),
    ],
)
def test_what_a_stream_cannot_be_made_from(
    registry: StreamRegistry, text: str, words: str, code: ExitCode
) -> None:
    with pytest.raises(StreamError, match=words) as error:
        registry.text_for(created('x', text), E1)
    assert error.value.code is code


def test_a_stream_that_others_are_made_from_is_kept(registry: StreamRegistry) -> None:
    for name in ('x', 'y'):
        registry.add(created(name, 'sync(a, battery)'))
    with pytest.raises(StreamError, match="'a' is used: x, y are made from it") as error:
        registry.remove('a')
    assert error.value.code is ExitCode.INVALID_ARGUMENT
    registry.remove('y')
    with pytest.raises(StreamError, match="'battery' is used: x is made from it"):
        registry.remove('battery')
    registry.remove('x')
    registry.remove('a')


def test_a_stream_is_recreated_when_its_sources_move(registry: StreamRegistry) -> None:
    registry.add(created('x', 'select a from a'))
    registry.place('x', E2, '/dyknow/streams/x', {'a': '/dyknow/streams/a'})
    registry.withdraw_all(E1)
    assert registry.outdated() == ()  # It is not known yet where `a` will be.
    place(registry, 'a', '/e4')
    assert registry.outdated() == ()  # The topic is the same.
    place(registry, 'a', FAR)
    assert [stream.name for stream in registry.outdated()] == ['x']


def test_streams_made_from_a_recreated_stream_are_recreated(
    registry: StreamRegistry,
) -> None:
    for name, engine in (('y', E2), ('z', E2), ('far', E1)):
        registry.add(created(name, 'select a from x'))
        place(registry, name, engine)
    registry.add(created('x', 'select a from a'))
    registry.place('x', E2, '/dyknow/streams/x', {'a': '/dyknow/streams/a'})
    registry.add(created('top', 'sync(y, battery)'))
    place(registry, 'top', E2)
    assert registry.outdated() == ()
    place(registry, 'a', FAR)
    assert {stream.name for stream in registry.outdated()} == {'x', 'y', 'z', 'top'}


def test_what_a_manager_before_asked_for_is_understood_again() -> None:
    """A new manager learns a text with the topics that the last one wrote into it."""
    before = StreamRegistry()
    before.add(created('c'))
    place(before, 'c', E1)
    asked = created('x', 'select a from c')
    text, _ = before.text_for(asked, E2)
    assert '"/dyknow/streams/c"' in text

    after = StreamRegistry()
    reported = reported_by(after, E2, 'x', text, NO_CONSTRAINTS, '/dyknow/streams/x')
    after.add(reported)
    assert after.made_from('c') == ()  # Nothing is known of `c` yet.
    after.add(created('c'))
    place(after, 'c', FAR)
    assert after.made_from('c') == ('x',)
    after.restore_names()
    assert [stream.name for stream in after.outdated()] == ['x']
    known = after.get('x')
    assert isinstance(known, CreatedStream)
    assert after.text_for(known, FAR)[0] == 'sink select a from c'


def test_a_copy_is_distinguished_from_another_stream_of_the_name(registry: StreamRegistry) -> None:
    registry.add(created('x', 'select a from a'))
    registry.place('x', E2, '/dyknow/streams/x', {'a': '/dyknow/streams/a'})
    text, _ = registry.text_for(created('x', 'select a from a'), E2)
    assert registry.is_copy(reported_by(registry, '/e9', 'x', text, NO_CONSTRAINTS, ''))
    assert registry.is_copy(
        reported_by(registry, '/e9', 'x', 'select a from a', NO_CONSTRAINTS, '')
    )
    assert not registry.is_copy(
        reported_by(registry, '/e9', 'x', 'select b from a', NO_CONSTRAINTS, '')
    )
    late = StreamConstraints(max_delay=1)
    assert not registry.is_copy(reported_by(registry, '/e9', 'x', text, late, ''))
    assert not registry.is_copy(reported_by(registry, '/e9', 'battery', text, NO_CONSTRAINTS, ''))


def test_what_an_engine_makes_already_is_taken_over() -> None:
    """Even if the alias of the engine is not the current topic of the stream it is made from."""
    registry = StreamRegistry()
    registry.add(created('c'))
    registry.add(created('x', 'select a from c'))
    text = 'stream c = "/odd/place/c";\nsink select a from c'
    reported = reported_by(registry, E2, 'x', text, NO_CONSTRAINTS, '/dyknow/streams/x')
    assert registry.is_copy(reported)
    registry.adopt(reported)
    assert registry.topic('x') == '/dyknow/streams/x'
    place(registry, 'c', E1)
    assert [stream.name for stream in registry.outdated()] == ['x']


def robot2() -> StreamRegistry:
    """The registry of a robot with a stream of a name that another robot uses, too."""
    registry = StreamRegistry(namespace='/robot2')
    registry.add(created('speed', 'select v from "odom"'))
    registry.place('speed', '/robot2/e', '/robot2/dyknow/streams/speed', {})
    return registry


FOREIGN = 'stream speed = "/robot1/dyknow/streams/speed";\nsink select v from speed'


def test_a_requested_alias_for_a_stream_of_another_robot_is_kept() -> None:
    assert robot2().text_for(created('x', FOREIGN), '/robot2/e')[0] == FOREIGN


def test_a_stream_made_from_that_of_another_robot_is_no_copy() -> None:
    registry = robot2()
    registry.add(created('x', 'select v from speed'))
    foreign = reported_by(registry, '/compute/e', 'x', FOREIGN, NO_CONSTRAINTS, '/compute/x')
    assert not registry.is_copy(foreign)
    own = FOREIGN.replace('robot1', 'robot2/arm')
    assert registry.is_copy(
        reported_by(registry, '/robot2/e', 'x', own, NO_CONSTRAINTS, '/robot2/x')
    )


def test_what_reads_the_topic_of_a_failed_stream_is_outdated(registry: StreamRegistry) -> None:
    """Another stream may be on that topic; while a stream only waits, none can be."""
    registry.add(created('x', 'select a from a'))
    registry.place('x', E2, '/dyknow/streams/x', {'a': '/dyknow/streams/a'})
    registry.withdraw('a', 'lost')
    assert registry.outdated() == ()
    registry.withdraw('a', 'taken', failed=True)
    assert [stream.name for stream in registry.outdated()] == ['x']
    with pytest.raises(StreamError, match="stream 'a' cannot be made: taken"):
        registry.topic('a')


def test_conflicts_name_both_specifications(registry: StreamRegistry) -> None:
    late = StreamConstraints(max_delay=1_000_000)
    other = reported_by(registry, E2, 'a', 'select b from "/t"', late, '/dyknow/streams/a')
    used = registry.find('a')
    assert isinstance(used, CreatedStream)
    for error in (name_taken(used, [other]), two_streams(used, other)):
        assert error.code is ExitCode.ALREADY_EXISTS
        for words in ('\'sink select a from "/t"\'', '\'sink select b from "/t"\' with max_delay'):
            assert words in error.message
    battery = two_streams(registry.find('battery'), other)
    assert 'the registered topic /uav1/battery is used' in battery.message


def test_no_engine_in_the_namespaces() -> None:
    error = engines_missing(['/robot1/e'], Namespaces.of((), '/robot1'))
    assert 'running in /robot1 (/robot1/e); start one there' in error.message


def test_an_alias_that_is_all_of_a_text_is_no_alias(registry: StreamRegistry) -> None:
    stream = created('x', 'stream a = "/dyknow/streams/a"')
    assert registry.text_for(stream, E2)[0] == 'stream a = "/dyknow/streams/a"'


def test_the_convention_names_what_is_published() -> None:
    topics = {'/dyknow/streams/speed': SAMPLE_TYPE}
    registry = StreamRegistry(
        NamingConvention('/dyknow/streams/<name>'),
        published=lambda topic: (topic, topics[topic]) if topic in topics else None,
    )
    assert registry.topic('speed') == '/dyknow/streams/speed'
    assert registry.names() == ()
    with pytest.raises(StreamError, match="no stream 'height'"):
        registry.topic('height')
    registry.add(RegisteredStream('speed', '/explicit', SAMPLE_TYPE))
    assert registry.topic('speed') == '/explicit'


def test_the_convention_lists_what_is_published() -> None:
    def published(topic: str) -> tuple[str, str] | None:
        return None if topic.endswith('gone') else (f'/robot/{topic}', SAMPLE_TYPE)

    registry = StreamRegistry(namespace='/robot', published=published)
    registry.add(CreatedStream('waiting', 'sink a', NO_CONSTRAINTS))
    registry.add(RegisteredStream('named', '/a', SAMPLE_TYPE))
    topics = (
        '/robot/dyknow/streams/external',
        '/robot/dyknow/streams/external/violations',
        '/robot/dyknow/streams/select',
        '/robot/dyknow/streams/gone',
        '/robot/dyknow/streams/waiting',
        '/other/dyknow/streams/elsewhere',
        '/robot/status',
    )
    assert registry.listed_names(topics) == ('external', 'named')


@pytest.mark.parametrize(
    ('pattern', 'topic', 'name'),
    [
        ('<name>', '/a', 'a'),
        ('/<name>/data', '/a/data', 'a'),
        ('/<name>/data', '/a/date', None),
        ('~/made_<name>', '/node/made_a', 'a'),
        ('streams/<name>', '/streams', None),
        ('streams/<name>', '/streams/', None),
    ],
)
def test_the_name_of_a_topic(pattern: str, topic: str, name: str | None) -> None:
    assert NamingConvention(pattern).name(topic) == name


@pytest.mark.parametrize('pattern', ['dyknow/streams', '', '<name>/<name>'])
def test_a_convention_that_names_nothing(pattern: str) -> None:
    with pytest.raises(StreamError, match='must hold <name> once'):
        NamingConvention(pattern)


@pytest.mark.parametrize(
    'name', ['', 'two words', '1st', '_watermarks', 'ä', 'a/b', 'select', 'sync', "S'"]
)
def test_a_name_that_no_text_can_mention(name: str) -> None:
    with pytest.raises(StreamError, match=f"'{name}' cannot be the name of a stream"):
        check_name(name)


def test_a_name_of_a_function() -> None:
    with pytest.raises(StreamError, match='formulas would take it for a function'):
        check_name('abs')


def test_a_report_joins_what_the_manager_and_the_engine_know(registry: StreamRegistry) -> None:
    reported = StreamReport('a', StreamState.FLOWING, samples=7)
    flowing = registry.report(registry.find('a'), reported)
    assert (flowing.samples, flowing.engine, flowing.topic) == (7, E1, '/dyknow/streams/a')
    registry.release('waiting', 'no unit', failed=True)
    failed = registry.report(registry.find('waiting'), None)
    assert (failed.state, failed.message, failed.engine) == (StreamState.FAILED, 'no unit', '')
    battery = registry.report(registry.find('battery'), None)
    assert (battery.state, battery.topic) == (StreamState.REGISTERED, '/uav1/battery')
