"""What the stream manager knows of streams and engines."""

import pytest

from dyknow_stream_processing import NO_CONSTRAINTS, ExitCode, StreamError
from dyknow_stream_processing.registry import CreatedStream, RegisteredStream, StreamRegistry


def created(name: str, specification: str | None = 'select a from "/t"') -> CreatedStream:
    return CreatedStream(name, specification, NO_CONSTRAINTS)


@pytest.fixture
def registry() -> StreamRegistry:
    """Two streams on engine `e1`, one on `e2`, one that waits, and a registered topic."""
    known = StreamRegistry()
    for name, engine in (('a', 'e1'), ('b', 'e1'), ('c', 'e2')):
        known.add(created(name))
        known.place(name, engine, f'/streams/{name}')
    known.add(created('waiting'))
    known.add(RegisteredStream('battery', '/uav1/battery', 'sensor_msgs/msg/BatteryState'))
    return known


def test_only_streams_that_flow_are_listed(registry: StreamRegistry) -> None:
    assert registry.names() == ('a', 'b', 'battery', 'c')
    assert [stream.name for stream in registry.waiting()] == ['waiting']


def test_an_unknown_stream_is_answered_with_those_there_are(registry: StreamRegistry) -> None:
    with pytest.raises(StreamError, match=r"no stream 'z' \(there are: a, b, battery, c\)") as e:
        registry.find('z')
    assert e.value.code is ExitCode.NOT_FOUND


def test_a_name_is_given_once(registry: StreamRegistry) -> None:
    with pytest.raises(StreamError, match="a stream 'a' already") as error:
        registry.add(created('a'))
    assert error.value.code is ExitCode.ALREADY_EXISTS


def test_the_engine_with_the_fewest_streams_is_chosen(registry: StreamRegistry) -> None:
    assert registry.least_loaded(['e1', 'e2']) == 'e2'
    assert registry.least_loaded(['e1', 'e2', 'e3']) == 'e3'
    assert registry.least_loaded([]) is None


def test_the_streams_of_a_lost_engine_wait_for_another(registry: StreamRegistry) -> None:
    registry.lose('e1')
    assert [stream.name for stream in registry.waiting()] == ['a', 'b', 'waiting']
    assert registry.names() == ('battery', 'c')


def test_an_adopted_stream_cannot_be_made_anew(registry: StreamRegistry) -> None:
    registry.add(created('adopted', specification=None))
    registry.place('adopted', 'e1', '/streams/adopted')
    registry.lose('e1')
    with pytest.raises(StreamError, match="no stream 'adopted'"):
        registry.find('adopted')


def test_what_another_engine_makes_is_read_from_its_topic(registry: StreamRegistry) -> None:
    assert registry.text_for('sync(a, c, battery)', 'e1') == (
        'stream battery = "/uav1/battery";\nstream c = "/streams/c";\nsink sync(a, c, battery)'
    )


def test_what_waits_cannot_be_read(registry: StreamRegistry) -> None:
    with pytest.raises(StreamError, match="stream 'waiting' waits") as error:
        registry.text_for('select a from waiting', 'e1')
    assert error.value.code is ExitCode.UNAVAILABLE
