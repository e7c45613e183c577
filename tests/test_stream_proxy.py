"""StreamProxy on real topics: samples, drops, and publishers that come and go."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import MagicMock

import pytest
from dyknow_interfaces.msg import ConstraintViolation, Field
from dyknow_interfaces.msg import Sample as SampleMessage
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Float64, Int32

from dyknow_common import StreamConstraints
from dyknow_common.ros import VIOLATIONS
from dyknow_stream_processing import Sample, StreamError, Violation
from dyknow_stream_processing.ros import StreamProxy
from dyknow_stream_processing.ros.topics import node_topics
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics
from dyknow_stream_processing.ros.topics.process_pauses import PAUSES
from dyknow_stream_processing.ros.topics.topic_feed import ReceivedMessage
from services import time_of
from system import Client

BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=100)
LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
SECOND = 1_000_000_000

OTHER_PROCESS = """
import rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import Float64
rclpy.init()
node = rclpy.create_node('other')
publisher = node.create_publisher(Float64, '/a', qos_profile_sensor_data)
node.create_timer(0.05, lambda: publisher.publish(Float64(data=0.5)))
rclpy.spin(node)
"""


class Recording:
    """A proxy, and all that it reported."""

    def __init__(self, client: Client, stream: str, **arguments: Any) -> None:
        self.samples: list[Sample] = []
        self.violations: list[Violation] = []
        self.proxy = StreamProxy(
            client.node,
            stream,
            on_sample=self.samples.append,
            on_violation=self.violations.append,
            **arguments,
        )

    def values(self, field: str = 'data') -> list[object]:
        return [sample.fields[field] for sample in self.samples]

    def broken(self) -> list[str]:
        return [violation.constraint for violation in self.violations]


def wait_for_match(client: Client, publisher: Any) -> None:
    client.spin_until(lambda: publisher.get_subscription_count() == 1, 'the match')


def wait_until_heard(client: Client, recording: Recording, publisher: Any, message: Any) -> None:
    """Publish until a sample arrives."""
    count = len(recording.samples)

    def heard() -> bool:
        publisher.publish(message)
        return len(recording.samples) > count

    client.spin_until(heard, f'a sample of {publisher.topic_name}')


def flooded(
    client: Client,
    message_type: Any,
    message: Callable[[int], Any],
    is_lost: Callable[[Recording], bool],
) -> Recording:
    """A proxy with a queue of one message, which receives numbered ones until some are lost."""
    publisher = client.node.create_publisher(message_type, '/a', RELIABLE)
    recording = Recording(client, '/a', quality_of_service=QoSProfile(depth=1))
    numbers = itertools.count(1)

    def lost() -> bool:
        for number in itertools.islice(numbers, 5):
            publisher.publish(message(number))
        return is_lost(recording)

    client.spin_until(lost, 'a loss')
    return recording


def odometry(stamp: int, x: float = 0.0) -> Odometry:
    message = Odometry()
    message.header.stamp = time_of(stamp)
    message.pose.pose.position.x = x
    return message


@contextmanager
def other_process() -> Iterator[None]:
    """A process that publishes floats on /a, with best effort."""
    # In one process the middleware allows a topic one type.
    with subprocess.Popen([sys.executable, '-c', OTHER_PROCESS], start_new_session=True) as process:
        try:
            yield
        finally:
            process.kill()


@pytest.fixture
def entities(client: Client) -> Iterator[None]:
    """Assert that no subscription or timer is left on the node."""

    def count() -> tuple[int, int]:
        return len(list(client.node.subscriptions)), len(list(client.node.timers))

    before = count()
    yield
    assert count() == before


@pytest.mark.parametrize('quality_of_service', [BEST_EFFORT, RELIABLE, LATCHED])
def test_the_quality_of_service_is_that_of_the_publisher(
    client: Client, quality_of_service: QoSProfile
) -> None:
    publisher = client.node.create_publisher(Float64, '/a', quality_of_service)
    publisher.publish(Float64(data=1.0))
    recording = Recording(client, '/a')
    if quality_of_service is not LATCHED:
        wait_until_heard(client, recording, publisher, Float64(data=1.0))
    client.spin_until(lambda: bool(recording.samples), 'a sample')
    assert recording.values()[0] == 1.0


def test_what_was_kept_is_given_to_each_proxy(client: Client) -> None:
    publisher = client.node.create_publisher(Float64, '/a', LATCHED)
    publisher.publish(Float64(data=1.0))
    for _ in range(3):
        recording = Recording(client, '/a')
        client.spin_until(lambda: bool(recording.samples), 'a sample')  # noqa: B023
        assert recording.values() == [1.0]


def test_the_quality_of_service_can_be_overridden(client: Client) -> None:
    publisher = client.node.create_publisher(Float64, '/a', RELIABLE)
    recording = Recording(client, '/a', quality_of_service=BEST_EFFORT)
    wait_until_heard(client, recording, publisher, Float64())
    (info,) = client.node.get_subscriptions_info_by_topic('/a')
    assert info.qos_profile.reliability is ReliabilityPolicy.BEST_EFFORT


@pytest.mark.usefixtures('entities')
def test_a_topic_is_waited_for(client: Client) -> None:
    recording = Recording(client, 'select data as level from "a" where data > 1')
    publisher = client.node.create_publisher(Float64, '/a', RELIABLE)
    wait_until_heard(client, recording, publisher, Float64(data=2.0))
    assert recording.values('level')[0] == 2.0
    recording.proxy.destroy()
    recording.proxy.destroy()


def test_with_a_type_the_first_message_is_received(client: Client) -> None:
    recording = Recording(client, '/a', message_type=Float64)
    publisher = client.node.create_publisher(Float64, '/a', RELIABLE)
    wait_for_match(client, publisher)
    publisher.publish(Float64(data=1.0))
    client.spin_until(lambda: bool(recording.samples), 'a sample')
    assert recording.values() == [1.0]


def test_with_a_type_a_weaker_publisher_is_received(client: Client) -> None:
    recording = Recording(client, '/a', message_type=Float64)
    publisher = client.node.create_publisher(Float64, '/a', BEST_EFFORT)
    wait_until_heard(client, recording, publisher, Float64())


def test_a_weaker_publisher_that_joins_is_received(client: Client) -> None:
    reliable = client.node.create_publisher(Float64, '/a', LATCHED)
    recording = Recording(client, '/a')
    reliable.publish(Float64(data=1.0))
    client.spin_until(lambda: bool(recording.samples), 'a sample')
    best_effort = client.node.create_publisher(Float64, '/a', BEST_EFFORT)

    def heard() -> bool:
        best_effort.publish(Float64(data=2.0))
        return 2.0 in recording.values()

    client.spin_until(heard, 'the weaker publisher')
    wait_until_heard(client, recording, reliable, Float64(data=3.0))
    assert recording.values().count(1.0) == 1


def test_publishers_that_come_back_with_another_type(client: Client) -> None:
    publisher = client.node.create_publisher(Int32, '/a', RELIABLE)
    recording = Recording(client, '/a')
    wait_until_heard(client, recording, publisher, Int32(data=1))
    client.node.destroy_publisher(publisher)
    with other_process():
        client.spin_until(lambda: recording.values()[-1] == 0.5, 'samples of the other type')


@pytest.mark.parametrize('message_type', [Odometry, SampleMessage])
def test_a_message_that_waits_while_the_type_of_its_topic_changes(
    client: Client, message_type: Any
) -> None:
    """It cannot be used any more, which is reported, and does not end the node."""
    _, recording = recorded_publisher(client, message_type)
    topics, now = NodeTopics.of(client.node), client.node.get_clock().now().nanoseconds
    (feed,) = topics._feeds.values()
    topics._taken.append(ReceivedMessage(feed, Int32(data=1), None, now, now))
    client.spin_until(lambda: not topics._taken or topics.catch_up(now), 'what waits')
    assert recording.broken() == ['message']
    assert 'the type of the topic has changed' in recording.violations[0].message
    assert recording.proxy.drops == {'message': 1}


@pytest.mark.parametrize('count', [1, 2])
def test_samples_are_put_in_order_and_late_ones_dropped(client: Client, count: int) -> None:
    """One publisher must be asked for it; the samples of several are put in order anyway."""
    publishers = [client.node.create_publisher(Odometry, '/a', RELIABLE) for _ in range(count)]
    publisher = publishers[0]
    recording = Recording(
        client,
        'select pose.pose.position.x as x from "/a"',
        constraints=StreamConstraints(max_delay=SECOND, reorder=True if count == 1 else None),
    )
    wait_for_match(client, publisher)
    now = client.node.get_clock().now().nanoseconds
    for x in (3, 1, 2):
        publisher.publish(odometry(now + x, float(x)))
    publisher.publish(odometry(now - 2 * SECOND))
    client.spin_until(lambda: len(recording.samples) == 3, 'samples')
    assert recording.values('x') == [1.0, 2.0, 3.0]
    available = [sample.available_time for sample in recording.samples]
    assert available == sorted(set(available))
    assert recording.proxy.drops == {'max_delay': 1}
    assert recording.broken() == ['max_delay']
    assert recording.proxy.statistics.samples == 3


def outside_sample(stamp: int, x: float) -> SampleMessage:
    """A sample as a node without watermarks publishes it."""
    field = Field(name='pose.pose.position.x', type='float', value=str(x))
    return SampleMessage(valid_time=time_of(stamp), fields=[field])


def recorded_publisher(client: Client, message_type: Any = Odometry) -> tuple[Any, Recording]:
    """A publisher, and what is recorded of the positions that it publishes."""
    publisher = client.node.create_publisher(message_type, '/a', RELIABLE)
    recording = Recording(
        client,
        'select pose.pose.position.x as x from "/a"',
        constraints=StreamConstraints(max_delay=100 * SECOND),
    )
    wait_for_match(client, publisher)
    return publisher, recording


@pytest.mark.parametrize(
    ('message_type', 'message'), [(Odometry, odometry), (SampleMessage, outside_sample)]
)
def test_samples_of_one_publisher_pass_at_once(
    client: Client, message_type: Any, message: Callable[[int, float], Any]
) -> None:
    publisher, recording = recorded_publisher(client, message_type)
    now = client.node.get_clock().now().nanoseconds
    for x in (1, 3, 2, 4):
        publisher.publish(message(now + x, float(x)))
    client.spin_until(lambda: len(recording.samples) == 3, 'samples')
    assert recording.values('x') == [1.0, 3.0, 4.0]
    assert recording.proxy.drops == {'valid_time_order': 1}
    assert recording.broken() == ['valid_time_order']


def test_a_second_publisher_has_samples_put_in_order(client: Client) -> None:
    """Publishers come and go; what is held is released when one is left."""
    publisher, recording = recorded_publisher(client)
    now, numbers = client.node.get_clock().now().nanoseconds, itertools.count(1)

    def held() -> int:
        number = next(numbers)
        publisher.publish(odometry(now + number, float(number)))
        return number - len(recording.samples)

    assert held() == 1
    client.spin_until(lambda: len(recording.samples) == 1, 'the sample of one publisher')
    second = client.node.create_publisher(Odometry, '/a', RELIABLE)
    client.spin_until(lambda: held() > 20, 'samples that are held', pause=0.05)
    client.node.destroy_publisher(second)
    client.spin_until(lambda: held() < 5, 'the samples that were held', pause=0.05)
    values = recording.values('x')
    assert values == [float(number + 1) for number in range(len(values))]
    assert recording.violations == []


def test_a_busy_process_breaks_no_period(client: Client) -> None:
    """Messages count from the time at which the middleware received them."""
    with other_process():
        recording = Recording(
            client,
            'sync(select data as a from "/a" with sample_period = 1500 ms, '
            'sample_period_deviation = 1500 ms, max_delay = 500 ms) with sample_period = 20 ms',
        )
        client.spin_until(lambda: len(recording.samples) > 5, 'samples')
        count = len(recording.samples)
        time.sleep(4.0)
        client.spin_until(lambda: len(recording.samples) > count + 150, 'samples')
    assert recording.violations == []
    assert recording.proxy.drops == {}


def test_a_process_that_cannot_keep_up_runs_its_other_callbacks(client: Client) -> None:
    publisher = client.node.create_publisher(Float64, '/a', RELIABLE)
    recording = Recording(client, '/a', quality_of_service=RELIABLE)
    wait_until_heard(client, recording, publisher, Float64(data=-1.0))
    slow = StreamProxy(client.node, '/a', on_sample=lambda _: time.sleep(0.03))
    numbers = [float(number) for number in range(60)]
    for number in numbers:
        publisher.publish(Float64(data=number))
    time.sleep(0.3)  # Now all of them wait, so the first callback finds itself late.
    received_at_ticks: list[int] = []
    timer = client.node.create_timer(
        0.01, lambda: received_at_ticks.append(recording.values().count(numbers[-1]))
    )
    client.spin_until(lambda: numbers[-1] in recording.values(), 'the last sample')
    assert received_at_ticks.count(0) > 3
    values = [each for each in recording.values() if each != -1.0]
    assert values == numbers
    client.node.destroy_timer(timer)
    slow.destroy()


def test_a_message_that_comes_while_others_are_processed_is_not_ahead_of_the_clock(
    client: Client,
) -> None:
    """The process may have no processor after it has read the clock, before it takes messages."""
    publisher = client.node.create_publisher(Odometry, '/a', RELIABLE)
    recording = Recording(client, 'select pose.pose.position.x as x from "/a"')
    wait_for_match(client, publisher)
    read = client.node.get_clock().now().nanoseconds
    time.sleep(0.3)
    publisher.publish(odometry(client.node.get_clock().now().nanoseconds))
    time.sleep(0.3)  # The middleware receives it.
    NodeTopics.of(client.node).catch_up(read)
    client.spin_until(lambda: bool(recording.samples or recording.violations), 'the sample')
    assert recording.violations == []
    (sample,) = recording.samples
    assert sample.available_time >= sample.valid_time > read


def test_a_clock_of_the_host_that_is_set_back(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is set back by half a second: the steady clock is then half a second further."""
    publisher = client.node.create_publisher(Odometry, '/a', RELIABLE)
    recording = Recording(client, 'select pose.pose.position.x as x from "/a"')
    clock = client.node.get_clock()
    wait_until_heard(client, recording, publisher, odometry(clock.now().nanoseconds, 1.0))
    clocks = MagicMock(monotonic_ns=lambda: time.monotonic_ns() + SECOND // 2)
    monkeypatch.setattr(node_topics, 'time', clocks)
    wait_until_heard(client, recording, publisher, odometry(clock.now().nanoseconds, 2.0))
    assert recording.broken() == ['valid_time_order']
    assert 'the clock was set back by 500 ms; all streams restart' in str(recording.violations)
    assert recording.proxy.drops == {}


@pytest.mark.parametrize('paused_s', [0, 1])
def test_stamps_that_are_zero_negative_or_equal(client: Client, paused_s: int) -> None:
    """Messages stay in order, also where those without a stamp are received after a pause."""
    publisher = client.node.create_publisher(Odometry, '/a', RELIABLE)
    recording = Recording(client, 'select pose.pose.position.x as x from "/a" with max_lead = 9 s')
    wait_for_match(client, publisher)
    begun = client.node.get_clock().now().nanoseconds
    negative = odometry(begun)
    negative.header.stamp.sec = -5
    for message in (odometry(0), negative, odometry(begun + SECOND), odometry(begun + SECOND)):
        publisher.publish(message)
    if paused_s:
        time.sleep(0.3)  # The middleware receives them.
        PAUSES.note_sign_of_life(time.monotonic_ns() - paused_s * SECOND)
    client.spin_until(lambda: len(recording.samples) == 3, 'samples')
    zero, *equal = recording.samples
    assert begun < zero.valid_time <= zero.available_time
    assert {sample.valid_time for sample in equal} == {begun + SECOND}
    assert equal[0].available_time < equal[1].available_time
    assert recording.proxy.drops == {'message': 1}
    (violation,) = recording.violations
    assert 'before 1970' in violation.message
    assert violation.valid_time == -5 * SECOND + begun % SECOND


def test_topics_are_known_until_the_begin_of_a_pause(client: Client) -> None:
    _, recording = recorded_publisher(client)
    sources = recording.proxy._sources
    client.spin_until(
        lambda: client.node.get_clock().now().nanoseconds - sources.processed_until() < SECOND,
        'no pause',
    )
    PAUSES.note_sign_of_life(time.monotonic_ns() - 5 * SECOND)
    assert client.node.get_clock().now().nanoseconds - sources.processed_until() >= 5 * SECOND


def test_messages_that_a_pause_has_lost_are_not_missing_from_a_rate(client: Client) -> None:
    """They are missing from no other stream either, without its violation."""
    few, text = QoSProfile(depth=5), 'rate("/a", 500 ms) with max_delay = 100 ms'
    topics = ('/a', '/b', '/c')
    publishers = [client.node.create_publisher(Float64, each, RELIABLE) for each in topics]
    recording = Recording(client, text, quality_of_service=few)
    other = Recording(client, '/b', quality_of_service=few)
    # Its messages are processed before the loss can be known.
    complete = Recording(client, '/c')
    for publisher in publishers:
        wait_for_match(client, publisher)

    def publish() -> bool:
        for publisher in publishers:
            publisher.publish(Float64())
        return len(recording.samples) > count

    count = 5
    client.spin_until(publish, 'a rate', pause=0.02)
    begun, begun_at = time.monotonic_ns(), time.time_ns()
    for _ in range(75):
        publish()
        time.sleep(0.02)
    PAUSES.note_sign_of_life(begun)
    count = len(recording.samples) + 15
    client.spin_until(publish, 'rates after the pause', pause=0.02)
    assert 0 not in recording.values('hz')
    assert 'lost' in recording.broken()
    assert 'were lost, as their reader was stopped' in str(recording.violations)
    assert complete.violations == []
    (lost,) = other.violations
    assert lost.constraint == 'lost'
    assert 'were lost, as the node that reads them did not run for 1.' in lost.message
    before, after = [
        [
            each.available_time
            for each in other.samples
            if (each.valid_time < lost.valid_time) is early
        ]
        for early in (True, False)
    ]
    assert max(before) < lost.available_time
    assert min(after) > begun_at + SECOND


def test_the_field_of_the_valid_time_can_be_named(client: Client) -> None:
    publisher = client.node.create_publisher(TimeReference, '/a', RELIABLE)
    text = 'select source from "/a" with max_delay = 1 min'
    recording = Recording(client, text, valid_time='time_ref')
    now = client.node.get_clock().now().nanoseconds
    message = TimeReference(time_ref=time_of(now), source='gps')
    message.header.stamp = time_of(7)
    wait_until_heard(client, recording, publisher, message)
    assert recording.samples[0].valid_time == now


def test_a_field_of_the_valid_time_that_is_none(client: Client) -> None:
    client.node.create_publisher(TimeReference, '/a', RELIABLE)
    client.spin_until(lambda: client.node.count_publishers('/a') == 1, 'the publisher')
    with pytest.raises(StreamError, match=r'header\.stamp, time_ref'):
        Recording(client, '/a', valid_time='stamp')
    with pytest.raises(StreamError, match=r'header\.stamp'):
        Recording(client, '/b', valid_time='stamp', message_type=Odometry)


def test_a_sink_with_messages_is_refused(client: Client) -> None:
    with pytest.raises(StreamError, match="a StreamProxy publishes nothing; leave out the 'as'"):
        Recording(client, 'sink "/a" as std_msgs/msg/Float64')


def test_arguments_for_several_topics(client: Client) -> None:
    text = 'sync(select a from "/a", select b from "/b")'
    with pytest.raises(StreamError, match='several topics') as caught:
        Recording(client, text, valid_time='stamp')
    assert '/a, /b' in caught.value.message
    with pytest.raises(StreamError, match=r"'/c'.*/a, /b"):
        Recording(client, text, message_type={'/c': Odometry})


def test_a_topic_with_several_types_is_an_error_once(
    client: Client, capfd: pytest.CaptureFixture[str]
) -> None:
    client.node.create_publisher(Int32, '/a', RELIABLE)
    client.spin_until(lambda: client.node.count_publishers('/a') == 1, 'the publisher')
    recording = Recording(client, '/a')
    said = ''

    def complained() -> bool:
        nonlocal said
        said += capfd.readouterr().err
        return 'several types' in said

    with other_process():
        client.spin_until(complained, 'the error')
        ticks: list[bool] = []
        client.node.create_timer(0.5, lambda: ticks.append(complained()))
        client.spin_until(lambda: len(ticks) >= 5, 'two more looks')
    assert said.count('several types') == 1
    assert not recording.samples


def test_a_message_that_cannot_be_read_is_dropped(client: Client) -> None:
    publisher = client.node.create_publisher(SampleMessage, '/a', RELIABLE)
    recording = Recording(client, '/a')
    wait_for_match(client, publisher)
    now = client.node.get_clock().now().nanoseconds
    for number, value in enumerate(('1', 'many', '2')):
        fields = [Field(type='int', name='data', value=value)]
        publisher.publish(SampleMessage(valid_time=time_of(now + number), fields=fields))
    client.spin_until(lambda: len(recording.samples) == 2, 'samples')
    assert recording.values() == [1, 2]
    assert recording.proxy.drops == {'message': 1}
    (violation,) = recording.violations
    assert (violation.stream_name, violation.valid_time) == ('/a', now + 1)
    assert "'many'" in violation.message


def test_samples_that_are_lost_between_two_nodes_are_reported(client: Client) -> None:
    recording = flooded(
        client,
        SampleMessage,
        lambda number: SampleMessage(
            valid_time=time_of(client.node.get_clock().now().nanoseconds),
            fields=[Field(type='int', name='data', value=str(number))],
        ),
        lambda recording: 'lost' in recording.broken(),
    )
    values = recording.values()
    assert set(recording.broken()) == {'lost'}
    assert recording.proxy.drops['lost'] + len(values) == values[-1] - values[0] + 1


def test_messages_that_are_lost_on_the_way_are_counted(client: Client) -> None:
    recording = flooded(
        client,
        Float64,
        lambda number: Float64(data=float(number)),
        lambda recording: bool(recording.proxy.drops),
    )
    values = recording.values()
    assert recording.proxy.drops['lost'] + len(values) == values[-1] - values[0] + 1
    assert not recording.violations


def test_several_publishers_of_one_topic_lose_nothing(client: Client) -> None:
    publishers = [client.node.create_publisher(SampleMessage, '/a', RELIABLE) for _ in range(2)]
    recording = Recording(client, '/a')
    client.spin_until(lambda: all(p.get_subscription_count() for p in publishers), 'the matches')
    now = client.node.get_clock().now().nanoseconds
    for number in range(1, 21):
        publishers[number % 3 == 0].publish(SampleMessage(valid_time=time_of(now + number)))
    client.spin_until(lambda: recording.proxy.statistics.samples > 5, 'samples')
    assert 'lost' not in recording.broken()
    assert 'source' not in recording.broken()


def test_violations_of_a_stream_reach_the_streams_made_from_it(client: Client) -> None:
    client.node.create_publisher(SampleMessage, '/a', RELIABLE)
    violations = client.node.create_publisher(ConstraintViolation, '/a/violations', VIOLATIONS)

    def break_it(constraint: str) -> None:
        now = time_of(client.node.get_clock().now().nanoseconds)
        violations.publish(
            ConstraintViolation(stream_name='far', constraint=constraint, available_time=now)
        )

    break_it('before')
    recording = Recording(client, '/a')
    break_it('after')
    client.spin_until(lambda: bool(recording.violations), 'a violation')
    assert recording.broken() == ['after']
    assert recording.violations[0].stream_name == 'far'
    client.node.destroy_publisher(violations)
    client.spin_until(lambda: len(recording.violations) == 2, 'the end of the publisher')
    assert recording.broken()[1] == 'source'
    assert 'gone' in recording.violations[1].message


def test_a_violation_that_waits_is_reported_before_later_samples(client: Client) -> None:
    """Also if the timer of the clock runs before the callbacks of both."""
    events: list[object] = []
    source = client.node.create_publisher(SampleMessage, '/a', RELIABLE)
    violations = client.node.create_publisher(ConstraintViolation, '/a/violations', VIOLATIONS)
    proxy = StreamProxy(
        client.node,
        'sync("/a" with max_delay = 1 ms) with sample_period = 5 ms',
        on_sample=lambda sample: events.append(sample.fields['x']),
        on_violation=lambda violation: events.append(violation.constraint),
    )

    def publish(value: int) -> None:
        now = time_of(client.node.get_clock().now().nanoseconds)
        fields = [Field(type='int', name='x', value=str(value))]
        source.publish(SampleMessage(valid_time=now, available_time=now, fields=fields))

    def is_heard() -> bool:
        publish(1)
        return bool(events)

    client.spin_until(is_heard, 'samples')
    now = time_of(client.node.get_clock().now().nanoseconds)
    violations.publish(ConstraintViolation(constraint='far', available_time=now))
    publish(2)
    time.sleep(0.1)
    client.spin_until(lambda: {2, 'far'} <= set(events), 'both')
    assert events.index('far') < events.index(2)
    proxy.destroy()


def test_a_sample_that_overtakes_a_violation_is_reported(client: Client) -> None:
    source = client.node.create_publisher(SampleMessage, '/a', RELIABLE)
    recording = Recording(client, '/a')
    wait_for_match(client, source)
    for _ in range(2):
        now = time_of(client.node.get_clock().now().nanoseconds)
        fields = [Field(type='int', name='data', value='1')]
        source.publish(SampleMessage(valid_time=now, fields=fields, violated_at=now))
    client.spin_until(lambda: len(recording.samples) == 2, 'samples')
    assert recording.broken() == ['lost', 'lost']
    assert 'has not arrived' in recording.violations[0].message


@pytest.mark.usefixtures('entities')
def test_proxies_on_one_node_share_a_subscription(client: Client) -> None:
    publisher = client.node.create_publisher(Odometry, '/a', RELIABLE)
    client.spin_until(lambda: client.node.count_publishers('/a') == 1, 'the publisher')
    before = len(list(client.node.subscriptions))
    text = 'select pose.pose.position.{} as value from "/a" with max_delay = 1 min'
    recordings = [Recording(client, text.format(field)) for field in 'xyzx']
    assert len(list(client.node.subscriptions)) == before + 1
    now = client.node.get_clock().now().nanoseconds
    wait_until_heard(client, recordings[-1], publisher, odometry(now, 4.0))
    assert [each.values('value')[0] for each in recordings] == [4.0, 0.0, 0.0, 4.0]
    recordings[0].proxy.destroy()
    count = len(recordings[0].samples)
    wait_until_heard(client, recordings[1], publisher, odometry(now + 1))
    assert len(recordings[0].samples) == count
    for each in recordings:
        each.proxy.destroy()
