"""The manager loses no stream while any of many engines dies, stops or comes back."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, StreamSpec, StreamStatusArray
from rclpy.node import Node
from std_msgs.msg import Float64

from stream_nodes import LATCHED, TANK, StreamNodes
from system import POLL

ONE, TWO = '/engine_one', '/engine_two'
FAR = '/far/engine'
MANAGER = '/stream_manager'
LEVEL = f'select data as level from "{TANK}"'
CHAIN = {
    'level': 'select data as level from tank',
    'half': 'select level as half from level',
    'quarter': 'select half as quarter from half',
    'both': 'sync(level, quarter)',
}


def topics(*names: str, prefix: str = '/dyknow/streams') -> list[str]:
    return [f'{prefix}/{name}' for name in names]


def register_tank(nodes: StreamNodes) -> None:
    answer = nodes.call(
        MANAGER,
        srv.StreamRegister,
        stream_name='tank',
        topic_name=TANK,
        message_type='std_msgs/msg/Float64',
    )
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message


def make_chain(nodes: StreamNodes) -> None:
    """Streams made from each other, spread over two engines."""
    register_tank(nodes)
    for name, text in CHAIN.items():
        nodes.create(name, text)
    nodes.wait_until_flowing(*CHAIN)
    assert set(nodes.engines_of().values()) == {ONE, TWO}
    nodes.listen(*topics(*CHAIN))
    nodes.wait_for_samples()


def start_two(nodes: StreamNodes, **manager: str) -> None:
    nodes.start(ONE)
    nodes.start(TWO)
    nodes.start_manager(**manager)
    nodes.wait_for_engines(ONE, TWO)


def test_no_stream_is_lost_when_an_engine_is_killed(nodes: StreamNodes) -> None:
    start_two(nodes)
    make_chain(nodes)
    moved = {name for name, engine in nodes.engines_of().items() if engine == ONE}
    nodes.kill(ONE)
    nodes.wait_until_flowing(*CHAIN, off=ONE)
    nodes.wait_for_samples()

    def said() -> dict[str, str]:
        return {each.key: each.value for each in nodes.status.values}

    nodes.until(lambda: said().keys() >= moved, 'the status tells of the streams that have moved')
    for name in moved:
        assert said()[name].startswith(f'recreated on {TWO} at ')
        assert said()[name].endswith(f'{ONE} is gone')
    # Those that another engine makes went on.
    assert not said().keys() & (CHAIN.keys() - moved)


def test_windows_of_a_moved_stream_are_complete(nodes: StreamNodes) -> None:
    start_two(nodes)
    register_tank(nodes)
    nodes.create(
        'average',
        'compunit average: float mean(level: float);'
        'sink mean(select data as level from tank, window = 4 s)',
    )
    nodes.wait_until_flowing('average')
    (made_by,) = nodes.engines_of().values()
    nodes.kill(made_by)
    reason = 'average was recreated: its window of 4 s has not passed yet'
    nodes.until(lambda: any(reason in each.message for each in nodes.report.streams), reason)
    nodes.wait_until_flowing('average', off=made_by)


def test_what_streams_are_made_of(nodes: StreamNodes) -> None:
    start_two(nodes)
    make_chain(nodes)

    def sources() -> dict[str, set[str]]:
        return {
            each.name: {source.topic for source in each.sources if source.samples}
            for each in nodes.report.streams
        }

    nodes.until(lambda: all(sources()[name] for name in CHAIN), 'all sources are told')
    assert sources()['tank'] == set()
    made_of = set().union(*(sources()[name] for name in CHAIN))
    assert TANK in made_of
    # An engine needs no topic for its own streams, and subscribes to the other's like any.
    assert made_of - {TANK}
    assert made_of - {TANK} <= set(topics(*CHAIN))


def test_streams_of_a_stream_that_stays_silent_begin_with_its_value(nodes: StreamNodes) -> None:
    start_two(nodes)
    limit = nodes.client.node.create_publisher(Float64, '/limit', LATCHED)
    limit.publish(Float64(data=0.5))
    nodes.create('limit', 'select data as limit from "/limit"')
    nodes.wait_until_flowing('limit')
    for name in ('first', 'second', 'third'):
        nodes.create(name, f'sync(limit, select data as level from "{TANK}")')
    nodes.wait_until_flowing('first', 'second', 'third')
    assert len(set(nodes.engines_of().values())) == 1, 'Engines keep no samples for each other.'


def test_streams_wait_until_an_engine_is_there(nodes: StreamNodes) -> None:
    start_two(nodes)
    make_chain(nodes)
    nodes.kill(ONE)
    nodes.kill(TWO)
    nodes.until(lambda: nodes.status.level == DiagnosticStatus.WARN, 'streams wait')
    nodes.until(lambda: '4 streams wait' in nodes.status.message, 'all streams wait')
    refused = nodes.call(
        MANAGER,
        srv.StreamCreateFromSpec,
        spec=StreamSpec(name='half', specification=LEVEL),
    )
    assert refused.exit_status.code == ExitStatus.ALREADY_EXISTS
    assert 'not made yet' in refused.exit_status.message
    nodes.start(FAR)
    nodes.wait_until_flowing(*CHAIN, off=ONE)
    nodes.listen(*topics(*CHAIN, prefix='/far/dyknow/streams'))
    nodes.until(lambda: nodes.status.level == DiagnosticStatus.OK, 'all is well')


def test_a_manager_that_is_killed_learns_all_from_the_engines(nodes: StreamNodes) -> None:
    nodes.start(ONE, stream_prefix='made/by_one')
    nodes.start(TWO)
    nodes.start_manager()
    nodes.wait_for_engines(ONE, TWO)
    first = nodes.create('level', LEVEL)
    nodes.create('half', 'select level as half from level')
    assert first.stream_topic == '/made/by_one/level'
    nodes.wait_until_flowing('level', 'half')
    nodes.listen('/dyknow/streams/half')
    nodes.kill(MANAGER)
    nodes.start_manager()
    nodes.wait_until_flowing('level', 'half')
    found = nodes.call(MANAGER, srv.StreamGetTopic, stream_name='level')
    assert found.topic_name == '/made/by_one/level'
    # What a stream is made from is known again too: it follows to where that is recreated.
    nodes.kill(ONE)
    nodes.wait_until_flowing('level', 'half', off=ONE)
    nodes.wait_for_samples()
    refused = nodes.call(MANAGER, srv.StreamDestroy, stream_name='level')
    assert 'half is made from it' in refused.exit_status.message


def test_an_engine_dies_while_the_manager_is_down(nodes: StreamNodes, tmp_path: Path) -> None:
    memory = str(tmp_path / 'memory' / 'streams.json')
    start_two(nodes, memory=memory)
    make_chain(nodes)
    nodes.kill(MANAGER)
    nodes.kill(ONE)
    nodes.start_manager(memory=memory)
    nodes.wait_until_flowing(*CHAIN, off=ONE)
    nodes.wait_for_samples()
    found = nodes.call(MANAGER, srv.StreamGetTopic, stream_name='tank')
    assert found.topic_name == TANK


def test_streams_follow_what_they_are_made_from(nodes: StreamNodes) -> None:
    """When a stream is recreated in another namespace, its topic is another one."""
    nodes.start(FAR)
    nodes.start_manager()
    nodes.wait_for_engines(FAR)
    relative = TANK.lstrip('/')
    made = nodes.create('level', f'select data as level from "{relative}"')
    assert made.stream_topic == '/far/dyknow/streams/level'
    nodes.start(ONE)
    nodes.wait_for_engines(ONE, FAR)
    names = 'level', 'half', 'quarter'
    for name in names[1:]:
        nodes.create(name, CHAIN[name])
    nodes.wait_until_flowing(*names)
    assert nodes.engines_of() == {'level': FAR, 'half': ONE, 'quarter': ONE}
    nodes.listen(*topics('half', 'quarter'))
    nodes.wait_for_samples()
    nodes.kill(FAR)
    nodes.wait_until_flowing(*names, off=FAR)
    nodes.wait_for_samples()


def test_an_engine_that_was_unreachable(nodes: StreamNodes) -> None:
    start_two(nodes)
    make_chain(nodes)
    nodes.signal(ONE, signal.SIGSTOP)
    nodes.wait_until_flowing(*CHAIN, off=ONE)
    nodes.signal(ONE, signal.SIGCONT)
    nodes.wait_for_engines(ONE, TWO)
    count = nodes.client.node.count_publishers
    nodes.until(
        lambda: all(count(topic) == 1 for topic in topics(*CHAIN)), 'each stream is made once'
    )
    nodes.wait_for_samples()
    assert set(nodes.engines_of().values()) == {TWO}


def test_an_engine_that_stops_while_it_is_asked(nodes: StreamNodes) -> None:
    start_two(nodes)
    nodes.signal(ONE, signal.SIGSTOP)
    # The first of two that have no stream is asked, and never answers.
    made = nodes.create('level', LEVEL)
    assert nodes.engines_of().get('level', TWO) == TWO
    nodes.signal(ONE, signal.SIGCONT)
    nodes.wait_for_engines(ONE, TWO)
    count = nodes.client.node.count_publishers
    nodes.until(lambda: count(made.stream_topic) == 1, 'it is made once')
    nodes.client.spin_until(
        lambda: list(nodes.call(ONE, srv.ListStreams).stream_names) == [],
        'the other has none',
        pause=POLL,
    )
    assert list(nodes.call(TWO, srv.ListStreams).stream_names) == ['level']


def test_two_streams_of_one_name(nodes: StreamNodes) -> None:
    nodes.start(ONE)
    nodes.start(FAR)
    nodes.create('level', LEVEL, node=ONE)
    nodes.start_manager()
    nodes.wait_for_engines(ONE, FAR)
    nodes.create('level', 'select data as other from "/b"', node=FAR)
    nodes.until(lambda: 'two streams' in nodes.status.message, 'the manager complains')
    assert nodes.status.level == DiagnosticStatus.ERROR
    assert "'level'" in nodes.status.message
    assert FAR in nodes.status.message
    nodes.call(FAR, srv.StreamDestroy, stream_name='level')
    nodes.until(lambda: nodes.status.level == DiagnosticStatus.OK, 'all is well')
    assert nodes.engines_of() == {'level': ONE}


def test_what_is_done_at_an_engine_is_known(nodes: StreamNodes) -> None:
    nodes.start(ONE)
    nodes.start_manager()
    nodes.wait_for_engines(ONE)
    nodes.create('level', LEVEL, node=ONE)
    nodes.until(lambda: 'level' in nodes.engines_of(), 'it is known')
    nodes.call(ONE, srv.StreamDestroy, stream_name='level')
    nodes.until(lambda: not nodes.engines_of(), 'it is known to be no more')


def test_an_engine_that_was_restarted_before_its_heartbeat_says_so(nodes: StreamNodes) -> None:
    """Its services may be discovered first: they know of no streams."""
    nodes.start(ONE)
    nodes.start_manager()
    nodes.wait_for_engines(ONE)
    nodes.create('level', LEVEL)
    nodes.wait_until_flowing('level')
    nodes.kill(ONE)
    asked: list[None] = []

    def list_no_streams(_: Any, response: Any) -> Any:
        asked.append(None)
        return response

    restarted = Node(ONE.strip('/'), context=nodes.client.context)
    nodes.client.executor.add_node(restarted)
    restarted.create_service(srv.ListStreams, '~/list_streams', list_no_streams)
    reports = restarted.create_publisher(StreamStatusArray, '~/streams', LATCHED)
    reports.publish(StreamStatusArray(engines=[ONE]))
    nodes.until(lambda: bool(asked), 'the manager asks for the streams')
    restarted.destroy_node()
    nodes.start(ONE)
    nodes.until(lambda: 'recreated' in nodes.report.streams[0].message, 'the stream is back')
    nodes.wait_until_flowing('level')


def test_requests_that_come_together(nodes: StreamNodes) -> None:
    nodes.start(ONE)
    nodes.start_manager()
    nodes.wait_for_engines(ONE)
    spec = StreamSpec(name='level', specification=LEVEL)
    twice = [nodes.request(MANAGER, srv.StreamCreateFromSpec, spec=spec) for _ in range(2)]
    nodes.until(lambda: all(future.done() for future in twice), 'answers')
    codes = sorted(future.result().exit_status.code for future in twice)
    assert codes == [ExitStatus.SUCCESS, ExitStatus.ALREADY_EXISTS]
    spec.name = 'brief'
    creation = nodes.request(MANAGER, srv.StreamCreateFromSpec, spec=spec)
    destruction = nodes.request(MANAGER, srv.StreamDestroy, stream_name='brief')
    nodes.until(lambda: creation.done() and destruction.done(), 'answers')
    assert creation.result().exit_status.code == ExitStatus.SUCCESS
    if destruction.result().exit_status.code == ExitStatus.NOT_FOUND:
        # Two services: the second request may be read first.
        nodes.call(MANAGER, srv.StreamDestroy, stream_name='brief')
    assert list(nodes.call(ONE, srv.ListStreams).stream_names) == ['level']


def test_an_engine_that_was_just_started(nodes: StreamNodes) -> None:
    nodes.start_manager()
    nodes.start(ONE)
    # It answers; whether the manager has met it by now does not matter.
    nodes.call(ONE, srv.ListStreams)
    nodes.create('level', LEVEL)


def test_managers_are_no_engines(nodes: StreamNodes) -> None:
    nodes.start('/far/stream_manager', 'stream_manager')
    nodes.start(ONE)
    nodes.start_manager()
    nodes.wait_for_engines(ONE)
    nodes.create('level', LEVEL)
    nodes.wait_for_engines(ONE)
