"""The stream manager and the engine, alone and together: all their services and errors.

What is wrong with a specification is tested without ROS, in test_bad_specifications.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from itertools import count
from typing import Any

import pytest
from action_msgs.msg import GoalStatus, GoalStatusArray
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import (
    ConstraintViolation,
    ExitStatus,
    Field,
    Sample,
    StreamConstraints,
    StreamSpec,
    StreamStatusArray,
)
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Float64

from commands import command, output_of
from services import LATCHED, Nodes, Telemetry, assert_refused, nanoseconds, time_of
from system import POLL, private_environment

ENGINE = 'stream_processing_engine'
MANAGER = 'stream_manager'
PERIOD = 100_000_000
SECOND = 1_000_000_000
INVALID = ExitStatus.INVALID_ARGUMENT
LATEST = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
MISSING = ExitStatus.NOT_FOUND
EXISTING = ExitStatus.ALREADY_EXISTS


def create(nodes: Nodes, name: str, text: str, node: str = ENGINE) -> list[Any]:
    """Create a stream, and return the list that receives its samples."""
    spec = StreamSpec(name=name, specification=text)
    made = nodes.obtain(node, srv.StreamCreateFromSpec, spec=spec)
    assert made.stream_topic == f'/dyknow/streams/{name}'
    assert made.stream_constraint_violation_topic == f'/dyknow/streams/{name}/violations'
    return nodes.collect(Sample, made.stream_topic)


def streams(nodes: Nodes, node: str) -> list[str]:
    return list(nodes.obtain(node, srv.ListStreams).stream_names)


def wait_until_gone(nodes: Nodes, name: str) -> None:
    """Wait until the manager lists a stream no more; it lists topics of the graph, too."""
    nodes.client.spin_until(
        lambda: name not in streams(nodes, MANAGER), f'{name} is gone', pause=0.02
    )


def assert_not_made(
    nodes: Nodes, node: str, spec: StreamSpec, code: int, words: tuple[str, ...]
) -> None:
    """Assert that a stream is refused, and that the streams of the node are unchanged."""
    before = streams(nodes, node)
    answer = nodes.call(node, srv.StreamCreateFromSpec, spec=spec)
    assert_refused(answer.exit_status, code, *words)
    assert streams(nodes, node) == before


@pytest.fixture(scope='module')
def engine(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """An engine alone."""
    with Nodes(tmp_path_factory.mktemp('engine'), stream_processing_engine={}) as nodes:
        yield nodes


@pytest.fixture(scope='module')
def telemetry(engine: Nodes) -> Telemetry:
    return Telemetry(engine.client)


@pytest.fixture(scope='module')
def altitude(engine: Nodes, telemetry: Telemetry) -> list[Any]:
    """The samples of a stream that flows."""
    text = 'select pose.pose.position.z as altitude from "/robot/odometry"'
    samples = create(engine, 'altitude', text)
    engine.client.spin_until(lambda: len(samples) >= 5, 'samples')
    assert telemetry.altitudes
    return samples


def test_samples_of_messages_with_a_header(telemetry: Telemetry, altitude: list[Any]) -> None:
    for sample in altitude:
        value = telemetry.altitudes[nanoseconds(sample.valid_time)]
        assert list(sample.fields) == [Field(type='float', name='altitude', value=str(value))]
        assert sample.header.stamp == sample.valid_time
        assert nanoseconds(sample.available_time) >= nanoseconds(sample.valid_time)
    available = [nanoseconds(sample.available_time) for sample in altitude]
    assert available == sorted(set(available))


@pytest.mark.usefixtures('telemetry')
def test_samples_of_messages_without_a_header(engine: Nodes) -> None:
    begun = engine.client.node.get_clock().now().nanoseconds
    samples = create(engine, 'level', 'stream level = select data as level from "/tank/level"')
    engine.client.spin_until(lambda: len(samples) >= 5, 'samples')
    valid = [nanoseconds(sample.valid_time) for sample in samples]
    assert begun < valid[0] < valid[-1] < engine.client.node.get_clock().now().nanoseconds
    assert list(samples[0].fields) == [Field(type='float', name='level', value='0.5')]


def test_a_later_stream_has_the_value_that_is_kept(engine: Nodes) -> None:
    publisher = engine.client.node.create_publisher(Float64, '/mode', LATEST)
    found = {name: engine.collect(Sample, f'/dyknow/streams/{name}') for name in ('mode', 'later')}
    create(engine, 'mode', 'select data from "/mode"')
    publisher.publish(Float64(data=3.0))
    engine.client.spin_until(lambda: found['mode'], 'a sample')
    create(engine, 'later', 'select data as kept from "/mode" with max_delay = 10 ms')
    engine.client.spin_until(lambda: found['later'], 'the value that is kept')
    first, later = found['mode'][0], found['later'][0]
    assert list(later.fields) == [Field(type='float', name='kept', value='3.0')]
    assert later.valid_time == first.valid_time


def test_a_later_built_in_source_repeats_no_kept_message(engine: Nodes) -> None:
    """The streams of its topic received the kept message again, by its new subscription."""
    topic = '/dock/_action/status'
    publisher = engine.client.node.create_publisher(GoalStatusArray, topic, LATEST)
    found = {name: engine.collect(Sample, f'/dyknow/streams/{name}') for name in ('goal', 'dock')}
    create(engine, 'goal', f'select status_list[0].status as goal from "{topic}"')
    publisher.publish(GoalStatusArray(status_list=[GoalStatus(status=GoalStatus.STATUS_EXECUTING)]))
    engine.client.spin_until(lambda: found['goal'], 'a sample')
    create(engine, 'dock', 'select name from action("/dock")')
    engine.client.spin_until(lambda: found['dock'], 'the status that is kept')
    publisher.publish(GoalStatusArray(status_list=[GoalStatus(status=GoalStatus.STATUS_ABORTED)]))
    engine.client.spin_until(lambda: len(found['dock']) > 1, 'a later status')
    values = {name: [each.fields[0].value for each in samples] for name, samples in found.items()}
    assert values == {'goal': ['2', '6'], 'dock': ['EXECUTING', 'ABORTED']}


def test_telemetry_that_stops_violates_its_period(engine: Nodes) -> None:
    spec = StreamSpec(
        name='fading',
        specification='select data from "/fading" with max_delay = 1 s',
        constraints=StreamConstraints(
            sample_period=[Duration(nanosec=PERIOD)], sample_period_deviation=[Duration()]
        ),
    )
    made = engine.obtain(ENGINE, srv.StreamCreateFromSpec, spec=spec)
    samples = engine.collect(Sample, made.stream_topic)
    violations = engine.collect(
        ConstraintViolation, made.stream_constraint_violation_topic, LATCHED
    )
    source = engine.client.node.create_publisher(Sample, '/fading', LATCHED)
    last = engine.client.node.get_clock().now().nanoseconds
    fields = [Field(type='int', name='data', value='1')]
    for valid_time in (last - 2 * PERIOD, last - PERIOD, last):
        source.publish(Sample(valid_time=time_of(valid_time), fields=fields))
    engine.client.spin_until(lambda: bool(violations), 'a violation')
    assert len(samples) == 3
    assert (violations[0].stream_name, violations[0].constraint) == ('fading', 'sample_period')
    assert nanoseconds(violations[0].valid_time) == last + PERIOD
    assert nanoseconds(violations[0].allowed) == PERIOD
    assert nanoseconds(violations[0].available_time) > last
    assert 'fading' in violations[0].message


def test_the_drift_of_a_forecast_is_a_diagnostic(engine: Nodes) -> None:
    statuses = engine.collect(DiagnosticStatus, f'/{ENGINE}/_status', LATCHED)
    samples = create(
        engine,
        'bound',
        'compunit bound: float constant_velocity((value: float, rate: float)); '
        'sink constant_velocity("/height" with max_delay = 1 h, reorder = false, horizon = 1 s, '
        'step = 1 s, widening = "0 0.5; 0.95 of 40 blocks of 1 s")',
    )
    source = engine.client.node.create_publisher(Sample, '/height', LATCHED)
    now = engine.client.node.get_clock().now().nanoseconds
    for second in range(20):
        fields = [Field(type='float', name=name, value='1.0') for name in ('value', 'rate')]
        source.publish(Sample(valid_time=time_of(now + (second - 20) * SECOND), fields=fields))

    def warned() -> bool:
        return bool(statuses) and statuses[-1].level == DiagnosticStatus.WARN

    engine.client.spin_until(warned, 'a warning')
    values = {each.key: each.value for each in statuses[-1].values}
    assert values['faults'].startswith("stream 'bound': ")
    engine.client.spin_until(lambda: len(samples) == 20, 'all bounds')
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='bound')
    engine.client.spin_until(lambda: not warned(), 'no warning')


def test_stamps_ahead_of_the_clock(engine: Nodes) -> None:
    """Of messages, of samples of an engine with the same clock, and of one with another clock."""
    reports = engine.collect(StreamStatusArray, f'/{ENGINE}/streams', LATEST)
    created = {}
    for name, limit in (('ahead', ''), ('forecast', ' with max_lead = 1 min')):
        text = f'select x from "/ahead"{limit}'
        spec = StreamSpec(name=name, specification=text)
        answer = engine.obtain(ENGINE, srv.StreamCreateFromSpec, spec=spec)
        violations = answer.stream_constraint_violation_topic
        created[name] = (
            engine.collect(Sample, answer.stream_topic),
            engine.collect(ConstraintViolation, violations, LATCHED),
        )
    source = engine.client.node.create_publisher(Sample, '/ahead', LATCHED)
    now = engine.client.node.get_clock().now().nanoseconds
    for number, available, lead in (
        (0, 0, 0),
        (1, 0, 30),
        (2, now, 30),
        (4, 30, 30),
        (3, now, 120),
    ):
        source.publish(
            Sample(
                valid_time=time_of(now + lead * SECOND),
                available_time=time_of(now + available * SECOND if available == 30 else available),
                watermark=[time_of(now + lead * SECOND)] if available else [],
                fields=[Field(type='int', name='x', value=str(number))],
            )
        )
    (samples, violations), (forecasts, broken) = created['ahead'], created['forecast']

    def numbers(received: list[Any]) -> list[str]:
        return [each.fields[0].value for each in received]

    engine.client.spin_until(lambda: len(violations) >= 2 and len(broken) >= 1, 'violations')
    engine.client.spin_until(lambda: len(samples) == len(forecasts) - 1 == 3, 'samples')
    assert numbers(samples) == ['0', '2', '3']
    assert numbers(forecasts) == ['0', '1', '2', '4']
    assert [each.constraint for each in (*violations, *broken)] == ['future'] * 3
    assert 25 * SECOND < nanoseconds(violations[0].observed) <= 30 * SECOND
    assert nanoseconds(violations[0].allowed) == PERIOD
    assert nanoseconds(broken[0].allowed) == 60 * SECOND

    def reported() -> Any:
        return {each.name: each for each in reports[-1].streams}.get('ahead') if reports else None

    engine.client.spin_until(
        lambda: (report := reported()) is not None and report.violations == 2, 'a report'
    )
    assert {each.reason: each.count for each in reported().drops} == {'future': 2}
    assert -120 * SECOND <= nanoseconds(reported().sources[0].delay) < -115 * SECOND


def test_elements_of_arrays_are_read_where_messages_have_them(engine: Nodes) -> None:
    text = 'select ranges[1], header.frame_id from "/laser"'
    spec = StreamSpec(name='laser', specification=text)
    made = engine.obtain(ENGINE, srv.StreamCreateFromSpec, spec=spec)
    samples = engine.collect(Sample, made.stream_topic)
    violations = engine.collect(
        ConstraintViolation, made.stream_constraint_violation_topic, LATCHED
    )
    source = engine.client.node.create_publisher(LaserScan, '/laser', LATCHED)
    for ranges in ([1.0], [1.0, 2.5, 3.0]):
        scan = LaserScan(ranges=ranges)
        scan.header.stamp = engine.client.node.get_clock().now().to_msg()
        scan.header.frame_id = 'mast'
        source.publish(scan)
    engine.client.spin_until(lambda: bool(samples and violations), 'a sample and a violation')
    assert [(field.name, field.value) for field in samples[0].fields] == [
        ('ranges[1]', '2.5'),
        ('header.frame_id', 'mast'),
    ]
    assert [each.constraint for each in violations] == ['fields']
    assert "no field 'ranges[1]': 'ranges' has 1 element, not one at [1]" in violations[0].message


def test_the_engine_lists_and_destroys_streams(engine: Nodes) -> None:
    for name in ('zulu', 'alpha'):
        create(engine, name, 'select a from "/nobody"')
    names = streams(engine, ENGINE)
    assert {'alpha', 'zulu'} <= set(names)
    assert names == sorted(names)
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='zulu')
    assert streams(engine, ENGINE) == [name for name in names if name != 'zulu']
    count = engine.client.node.count_publishers
    engine.client.spin_until(lambda: count('/dyknow/streams/zulu') == 0, 'no publisher')


@pytest.mark.usefixtures('altitude')
@pytest.mark.parametrize(
    ('name', 'text', 'code', 'words'),
    [
        ('new', 'select a form "/b"', INVALID, ("'form'", "'from'", '^')),
        ('altitude', 'select a from "/b"', EXISTING, ("'altitude'",)),
        ('two words', 'select a from "/b"', INVALID, ("'two words'", 'letters')),
        ('new', 'select a from nowhere', MISSING, ("'nowhere'", 'altitude')),
        ('new', 'select depth from altitude', INVALID, ("'depth'", 'has: altitude', '^')),
        ('new', 'select a from "/a//b"', INVALID, ("'/a//b'", 'cannot be the name')),
        (
            'new',
            'select z from "/robot/odometry"',
            INVALID,
            ("'z'", 'has: child_frame_id, pose, twist', '^'),
        ),
        ('new', 'select pose.covariance from "/robot/odometry"', INVALID, ('covariance[0]', '^')),
    ],
)
def test_a_stream_that_the_engine_cannot_make(
    engine: Nodes, name: str, text: str, code: int, words: tuple[str, ...]
) -> None:
    assert_not_made(engine, ENGINE, StreamSpec(name=name, specification=text), code, words)


def test_a_stream_that_the_middleware_refuses(engine: Nodes) -> None:
    """The engine reads other messages on the topic that the stream would have."""
    topic = '/dyknow/streams/taken'
    publisher = engine.client.node.create_publisher(Float64, topic, 10)
    samples = create(engine, 'other', f'select data from "{topic}"')
    engine.client.spin_until(
        lambda: publisher.publish(Float64(data=1.5)) or samples, 'a sample', pause=POLL
    )
    spec = StreamSpec(name='taken', specification='select data from "/tank/level"')
    assert_not_made(engine, ENGINE, spec, INVALID, ('refuses',))
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='other')


@pytest.mark.usefixtures('altitude')
def test_a_stream_that_the_engine_does_not_have(engine: Nodes) -> None:
    answer = engine.call(ENGINE, srv.StreamDestroy, stream_name='nowhere')
    assert_refused(answer.exit_status, MISSING, "'nowhere'", 'altitude')


@pytest.fixture(scope='module')
def managed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """A manager and an engine, with a topic that has a stream name and a stream made of it."""
    executables: dict[str, dict[str, Any]] = {MANAGER: {}, ENGINE: {}}
    with Nodes(tmp_path_factory.mktemp('managed'), **executables) as nodes:
        nodes.obtain(
            MANAGER,
            srv.StreamRegister,
            stream_name='tank',
            topic_name='/tank/level',
            message_type='std_msgs/msg/Float64',
        )
        spec = StreamSpec(name='level', specification='select data as level from tank')

        def made() -> bool:
            answer = nodes.call(MANAGER, srv.StreamCreateFromSpec, spec=spec)
            return bool(answer.exit_status.code != ExitStatus.UNAVAILABLE)

        nodes.client.spin_until(made, 'the manager has found the engine', pause=POLL)
        yield nodes


def test_a_stream_made_of_a_registered_topic_flows(managed: Nodes) -> None:
    telemetry = Telemetry(managed.client)
    samples = managed.collect(Sample, '/dyknow/streams/level')
    managed.client.spin_until(lambda: len(samples) >= 3, 'samples')
    assert list(samples[0].fields) == [Field(type='float', name='level', value='0.5')]
    telemetry.stop()


@pytest.mark.parametrize(
    ('name', 'topic', 'message_type'),
    [
        ('level', '/dyknow/streams/level', 'dyknow_interfaces/msg/Sample'),
        ('tank', '/tank/level', 'std_msgs/msg/Float64'),
    ],
)
def test_the_manager_knows_the_topic_of_a_stream(
    managed: Nodes, name: str, topic: str, message_type: str
) -> None:
    assert name in streams(managed, MANAGER)
    found = managed.obtain(MANAGER, srv.StreamGetTopic, stream_name=name)
    assert (found.topic_name, found.message_type) == (topic, message_type)


def test_a_stream_of_the_manager_is_one_of_the_engine(managed: Nodes) -> None:
    create(managed, 'twice', 'select level from level', MANAGER)
    names = streams(managed, MANAGER)
    assert 'twice' in names
    assert names == sorted(names)
    assert 'twice' in streams(managed, ENGINE)
    managed.obtain(MANAGER, srv.StreamDestroy, stream_name='twice')
    wait_until_gone(managed, 'twice')
    assert 'twice' not in streams(managed, ENGINE)


def test_a_registered_topic_can_be_forgotten(managed: Nodes) -> None:
    managed.obtain(
        MANAGER,
        srv.StreamRegister,
        stream_name='brief',
        topic_name='/brief',
        message_type='std_msgs/msg/Bool',
    )
    managed.obtain(MANAGER, srv.StreamDestroy, stream_name='brief')
    answer = managed.call(MANAGER, srv.StreamGetTopic, stream_name='brief')
    assert_refused(answer.exit_status, MISSING, "'brief'", 'tank')


def test_a_stream_that_is_destroyed_while_its_long_specification_is_parsed(managed: Nodes) -> None:
    """The requests are answered in their order; else a stream would stay that nobody wants."""
    text = f'select data from "/tank/level" where {" and ".join(["data > 0"] * 2000)}'
    spec = StreamSpec(name='unwanted', specification=text)
    # The client of the second service must be known before the first request is sent.
    managed.call(MANAGER, srv.StreamDestroy, stream_name='unwanted')
    created = managed.request(MANAGER, srv.StreamCreateFromSpec, spec=spec)
    time.sleep(0.1)  # In the middleware, requests of two services may overtake each other.
    destroyed = managed.request(MANAGER, srv.StreamDestroy, stream_name='unwanted')
    managed.client.spin_until(lambda: created.done() and destroyed.done(), 'both answers')
    for each in (created, destroyed):
        status = each.result().exit_status
        assert status.code == ExitStatus.SUCCESS, status.message
    wait_until_gone(managed, 'unwanted')


@pytest.mark.parametrize(
    ('name', 'text', 'code', 'words'),
    [
        ('new', 'select a form "/b"', INVALID, ("'form'", "'from'", '^')),
        ('level', 'select a from "/b"', EXISTING, ("'level'",)),
        ('tank', 'select a from "/b"', EXISTING, ("'tank'",)),
        ('two words', 'select a from "/b"', INVALID, ("'two words'", 'letters')),
        ('new', 'select a from nowhere', MISSING, ("'nowhere'", 'level', 'tank')),
        ('new', 'select depth from level', INVALID, ("'depth'", 'has: level', '^')),
    ],
)
def test_a_stream_that_the_manager_cannot_have_made(
    managed: Nodes, name: str, text: str, code: int, words: tuple[str, ...]
) -> None:
    assert_not_made(managed, MANAGER, StreamSpec(name=name, specification=text), code, words)


@pytest.mark.parametrize(
    ('name', 'topic', 'message_type', 'code', 'word'),
    [
        ('level', '/b', 'std_msgs/msg/Bool', EXISTING, "'level'"),
        ('new', '/b', 'no_msgs/msg/None', MISSING, "'no_msgs/msg/None'"),
        ('new', '/b', 'Bool', MISSING, 'package/msg/Type'),
        ('new', '/two words', 'std_msgs/msg/Bool', INVALID, "'/two words'"),
        ('two words', '/b', 'std_msgs/msg/Bool', INVALID, "'two words'"),
        ('select', '/b', 'std_msgs/msg/Bool', INVALID, "'select'"),
        ('', '/b', 'std_msgs/msg/Bool', INVALID, 'stream_name'),
        ('new', '', 'std_msgs/msg/Bool', INVALID, 'topic_name'),
        ('new', '/b', '', INVALID, 'message_type'),
    ],
)
def test_a_topic_that_cannot_be_registered(
    managed: Nodes, name: str, topic: str, message_type: str, code: int, word: str
) -> None:
    answer = managed.call(
        MANAGER,
        srv.StreamRegister,
        stream_name=name,
        topic_name=topic,
        message_type=message_type,
    )
    assert_refused(answer.exit_status, code, word)
    assert streams(managed, MANAGER) == ['level', 'tank']


@pytest.mark.parametrize('service', [srv.StreamGetTopic, srv.StreamDestroy])
def test_a_stream_that_the_manager_does_not_know(managed: Nodes, service: Any) -> None:
    answer = managed.call(MANAGER, service, stream_name='nowhere')
    assert_refused(answer.exit_status, MISSING, "'nowhere'", 'level', 'tank')


def test_a_published_stream_needs_no_registration(managed: Nodes) -> None:
    """Its topic follows the naming convention."""
    answer = managed.call(MANAGER, srv.StreamGetTopic, stream_name='external')
    assert_refused(answer.exit_status, MISSING, "'external'")
    source = managed.client.node.create_publisher(Sample, '/dyknow/streams/external', LATCHED)
    fields, times = [Field(type='int', name='data', value='7')], count(1)

    def publish() -> None:
        source.publish(Sample(valid_time=time_of(next(times)), fields=fields))

    def known() -> bool:
        found = managed.call(MANAGER, srv.StreamGetTopic, stream_name='external')
        return bool(found.topic_name == '/dyknow/streams/external')

    managed.client.spin_until(known, 'the manager sees the topic', pause=POLL)
    assert 'external' in streams(managed, MANAGER)
    samples = create(managed, 'convention', 'select data from external', MANAGER)
    # The first of them may come before the subscription to the new stream is known.
    timer = managed.client.node.create_timer(0.05, publish)
    managed.client.spin_until(lambda: bool(samples), 'a sample')
    managed.client.node.destroy_timer(timer)
    managed.obtain(MANAGER, srv.StreamDestroy, stream_name='convention')


def test_what_streams_have_in_common_is_done_once(engine: Nodes) -> None:
    """Two streams of one topic share a subscription, which ends with the last of them."""
    client = engine.client
    source = client.node.create_publisher(Float64, '/shared', 10)
    timer = client.node.create_timer(0.02, lambda: source.publish(Float64(data=1.0)))
    subscriptions = source.get_subscription_count
    first = create(engine, 'first', 'select data from "/shared" where data > 0.0')
    second = create(engine, 'second', 'sink select data as b from "/shared"')
    third = create(engine, 'third', 'select data from first')
    client.spin_until(lambda: all((first, second, third)), 'samples of all')
    assert subscriptions() == 1
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='first')
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='second')
    # What is made from a stream keeps what it needs of it.
    count = len(third)
    client.spin_until(lambda: len(third) > count, 'more samples')
    assert subscriptions() == 1
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='third')
    client.spin_until(lambda: subscriptions() == 0, 'no subscription')
    timer.cancel()


def test_the_engine_reports_its_streams(engine: Nodes) -> None:
    reports = engine.collect(StreamStatusArray, f'/{ENGINE}/streams', LATEST)
    text = 'stream told = select data from "/told" with max_delay = 1 s'
    create(engine, 'told', text)
    source = engine.client.node.create_publisher(Sample, '/told', LATCHED)
    # What is sent before the engine subscribes is never late.
    engine.client.spin_until(lambda: source.get_subscription_count() == 1, 'the subscription')
    now = engine.client.node.get_clock().now().nanoseconds
    fields = [Field(type='int', name='data', value='1')]
    for valid_time in (now, now - 100 * PERIOD):
        source.publish(Sample(valid_time=time_of(valid_time), fields=fields))

    def told() -> Any:
        return {each.name: each for each in reports[-1].streams}.get('told') if reports else None

    engine.client.spin_until(
        lambda: bool(told() and told().samples and told().drops), 'what became of the samples'
    )
    account = told()
    assert (account.state, account.engine) == (account.FLOWING, f'/{ENGINE}')
    assert account.topic == '/dyknow/streams/told'
    assert account.message_type == 'dyknow_interfaces/msg/Sample'
    assert account.specification == text
    assert account.samples == 1  # It may not have arrived here: the report is another topic.
    assert [(drop.reason, drop.count) for drop in account.drops] == [('max_delay', 1)]
    assert account.violations == 1
    (told_of,) = account.sources
    assert (told_of.topic, told_of.samples) == ('/told', 2)
    assert nanoseconds(told_of.latest) > now

    def rated() -> list[Any]:
        all_told = [each for report in reports for each in report.streams]
        return [each for each in all_told if each.name == 'told' and each.rate]

    engine.client.spin_until(lambda: bool(rated()), 'the period with the sample')
    assert nanoseconds(rated()[0].mean_delay) == nanoseconds(rated()[0].max_delay) > 0
    engine.client.spin_until(lambda: told().rate == 0, 'a period without samples')
    assert list(reports[-1].engines) == [f'/{ENGINE}']
    assert nanoseconds(reports[-1].stamp) > now
    engine.obtain(ENGINE, srv.StreamDestroy, stream_name='told')
    engine.client.spin_until(lambda: told() is None, 'it is told no more')


def test_a_subscriber_that_was_unreachable_counts_missed_samples(engine: Nodes) -> None:
    """To the middleware, a process that was unreachable for long is a new subscriber."""
    spec = StreamSpec(name='counted', specification='select data from "/counted"')
    engine.obtain(ENGINE, srv.StreamCreateFromSpec, spec=spec)
    client, values = engine.client, count()
    published: list[int] = []
    source = client.node.create_publisher(Float64, '/counted', 1000)

    def publish() -> None:
        published.append(next(values))
        source.publish(Float64(data=float(published[-1])))

    timer = client.node.create_timer(0.02, publish)

    def values_and_numbers() -> list[tuple[float, int]]:
        found: list[tuple[float, int]] = []

        def note(sample: Any, info: Any) -> None:
            value = float(sample.fields[0].value)
            found.append((value, info['publication_sequence_number']))

        listener = client.node.create_subscription(Sample, '/dyknow/streams/counted', note, 1000)
        client.spin_until(lambda: len(found) >= 3, 'samples')
        client.node.destroy_subscription(listener)
        return found

    before = values_and_numbers()
    published.clear()
    client.spin_until(lambda: len(published) > 20, 'samples that nobody hears')
    after = values_and_numbers()
    assert after[0][0] > before[-1][0] + 10
    assert len({value - number for value, number in before + after}) == 1
    timer.cancel()


def test_an_engine_cannot_publish_where_no_topic_can_be() -> None:
    line = command(ENGINE, '--ros-args', '-p', 'stream_prefix:=my streams')
    ended = output_of(line, private_environment())
    assert ended.returncode == 1
    assert ended.stderr.startswith("stream_prefix 'my streams' cannot be used")
