"""Other streams under the name of a requested one: none of them is ever used in its place."""

from __future__ import annotations

import signal
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import (
    ConstraintViolation,
    ExitStatus,
    StreamIdentity,
    StreamSpec,
    StreamStatusArray,
)
from std_msgs.msg import Float64

from stream_nodes import LATCHED, TANK, StreamNodes

ONE, TWO = '/engine_one', '/engine_two'
FAR = '/far/engine'
MANAGER = '/stream_manager'
REQUESTED = f'select data as level from "{TANK}"'
OTHER = 'select data as level from "/pool/level"'
BOTH = REQUESTED, OTHER


def start_manager_with_level(nodes: StreamNodes, folder: Path) -> None:
    """Start a manager that is requested to make `level`, by a file."""
    streams = folder / 'level.streams'
    streams.write_text(f'stream level = {REQUESTED}; sink level')
    nodes.start_manager(streams=f'["{streams}"]')


def wait_for_conflict(nodes: StreamNodes, *words: str) -> None:
    nodes.until(
        lambda: all(word in nodes.status.message for word in (*BOTH, *words)), 'the conflict'
    )
    assert nodes.status.level == DiagnosticStatus.ERROR


def topic_of_level(nodes: StreamNodes) -> tuple[str, str]:
    """The topic of `level`, and the message if there is none."""
    found = nodes.call(MANAGER, srv.StreamGetTopic, stream_name='level')
    return found.topic_name, found.exit_status.message


def destroy_other(nodes: StreamNodes, engine: str) -> None:
    """Do what the message of the conflict says."""
    answer = nodes.call(engine, srv.StreamDestroy, stream_name='level')
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message


def test_a_stream_of_another_specification_is_not_adopted(
    nodes: StreamNodes, tmp_path: Path
) -> None:
    nodes.start(ONE)
    nodes.create('level', OTHER, node=ONE)
    start_manager_with_level(nodes, tmp_path)
    wait_for_conflict(nodes, f'{ONE} makes', 'stream_destroy')
    topic, message = topic_of_level(nodes)
    assert not topic
    assert all(text in message for text in BOTH)
    # Another stream in its namespace would be on the same topic.
    nodes.start(TWO)
    nodes.wait_for_engines(ONE, TWO)
    refused = nodes.call(
        MANAGER,
        srv.StreamCreateFromSpec,
        spec=StreamSpec(name='half', specification='select level as half from level'),
    )
    assert refused.exit_status.code == ExitStatus.UNAVAILABLE
    assert all(text in refused.exit_status.message for text in BOTH)
    assert 'level' not in nodes.call(TWO, srv.ListStreams).stream_names
    destroy_other(nodes, ONE)
    nodes.wait_until_flowing('level')
    nodes.until(lambda: nodes.status.level == DiagnosticStatus.OK, 'all is well')


def test_the_requested_stream_is_made_in_another_namespace(
    nodes: StreamNodes, tmp_path: Path
) -> None:
    nodes.start(ONE)
    nodes.start(FAR)
    nodes.create('level', OTHER, node=ONE)
    start_manager_with_level(nodes, tmp_path)
    nodes.until(lambda: nodes.engines_of() == {'level': FAR}, 'it is made')
    assert topic_of_level(nodes)[0] == '/far/dyknow/streams/level'
    wait_for_conflict(nodes, f'that of {FAR}', f'that of {ONE}')


def test_a_request_for_a_name_that_is_taken(nodes: StreamNodes) -> None:
    nodes.start(ONE)
    nodes.start_manager()
    nodes.wait_for_engines(ONE)
    nodes.create('level', OTHER, node=ONE)
    refused = nodes.call(
        MANAGER, srv.StreamCreateFromSpec, spec=StreamSpec(name='level', specification=REQUESTED)
    )
    assert refused.exit_status.code == ExitStatus.ALREADY_EXISTS
    assert not refused.stream_topic
    nodes.until(lambda: bool(nodes.report.streams), 'the manager reports the stream of the engine')
    refused = nodes.call(
        MANAGER, srv.StreamCreateFromSpec, spec=StreamSpec(name='level', specification=REQUESTED)
    )
    assert OTHER in refused.exit_status.message


def replace_level(nodes: StreamNodes) -> None:
    """Have an engine make another `level`; the manager sees the streams before and after."""
    nodes.signal(MANAGER, signal.SIGSTOP)
    # If the manager was asking just then, it hears of the stream before.
    nodes.call(ONE, srv.ListStreams)
    destroy_other(nodes, ONE)
    nodes.create('level', OTHER, node=ONE)


def make_level_and_half(nodes: StreamNodes) -> None:
    """Two streams; the second reads the topic of the first."""
    nodes.start(ONE)
    nodes.start(TWO)
    nodes.start_manager()
    nodes.wait_for_engines(ONE, TWO)
    nodes.create('level', REQUESTED)
    nodes.create('half', 'select level as half from level')
    nodes.until(
        lambda: nodes.engines_of() == {'level': ONE, 'half': TWO}, 'each engine makes one stream'
    )


def wait_until_nothing_flows(nodes: StreamNodes) -> None:
    def message() -> str:
        return next(each.message for each in nodes.report.streams if each.name == 'half')

    # What reads a topic ends first because it is another one, then because there is none.
    nodes.until(
        lambda: not nodes.engines_of() and "stream 'level' cannot be made" in message(),
        'what reads the topic has ended',
    )


def test_a_stream_that_is_replaced_at_its_engine(nodes: StreamNodes) -> None:
    make_level_and_half(nodes)
    replace_level(nodes)
    nodes.signal(MANAGER, signal.SIGCONT)
    wait_for_conflict(nodes, f'{ONE} makes')
    wait_until_nothing_flows(nodes)
    destroy_other(nodes, ONE)
    nodes.wait_until_flowing('level', 'half')


def ids(report: StreamStatusArray) -> dict[str, int]:
    """The id of each stream; 0 while it is uncertain."""
    return {each.name: each.stream_id for each in report.streams}


def test_a_stream_is_made_from_the_chosen_one_alone(nodes: StreamNodes) -> None:
    make_level_and_half(nodes)
    topic = '/dyknow/streams/level'
    nodes.until(lambda: all(ids(nodes.report).values()), 'the ids are known')
    chosen = ids(nodes.report)['level']
    spec = StreamSpec(name='third', specification=f'select level as third from "{topic}"')

    def make(node: str, stream_id: int) -> int:
        sources = [StreamIdentity(topic=topic, stream_id=stream_id)]
        made = nodes.call(node, srv.StreamCreateFromSpec, spec=spec, sources=sources)
        return int(made.exit_status.code)

    assert make(MANAGER, chosen + 1) == ExitStatus.UNAVAILABLE
    assert make(ONE, chosen + 1) == ExitStatus.UNAVAILABLE
    # Another engine may hear of the chosen stream later than who has chosen it.
    violations = '/dyknow/streams/third/violations'
    heard = nodes.client.collect(ConstraintViolation, violations, LATCHED)
    assert make(TWO, chosen + 1) == ExitStatus.SUCCESS
    nodes.until(lambda: bool(heard), 'a violation')
    assert {each.constraint for each in heard} == {'source'}
    nodes.call(TWO, srv.StreamDestroy, stream_name='third')
    heard.clear()
    nodes.listen('/dyknow/streams/third')
    assert make(TWO, ids(nodes.report)['level']) == ExitStatus.SUCCESS
    nodes.wait_for_samples()
    assert not heard


def test_a_stream_that_reads_another_one_than_requested_is_not_certain(nodes: StreamNodes) -> None:
    make_level_and_half(nodes)
    nodes.until(lambda: all(ids(nodes.report).values()), 'the ids are known')
    before = ids(nodes.report)
    made: list[StreamStatusArray] = []
    told: list[StreamStatusArray] = []
    node = nodes.client.node
    node.create_subscription(StreamStatusArray, f'{TWO}/streams', made.append, LATCHED)
    replace_level(nodes)
    pool = node.create_publisher(Float64, '/pool/level', 10)
    timer = node.create_timer(0.02, lambda: pool.publish(Float64(data=9.0)))
    nodes.until(
        lambda: bool(made) and ids(made[-1])['half'] != before['half'], 'half is another stream'
    )
    node.create_subscription(StreamStatusArray, f'{MANAGER}/streams', told.append, LATCHED)
    nodes.signal(MANAGER, signal.SIGCONT)
    wait_for_conflict(nodes, f'{ONE} makes')
    node.destroy_timer(timer)
    # Of streams that the manager did not request, it never tells the ids.
    for name, stream_id in before.items():
        assert {ids(each).get(name, 0) for each in told} <= {0, stream_id}


def test_another_stream_on_the_same_topic(nodes: StreamNodes) -> None:
    make_level_and_half(nodes)
    nodes.create('level', OTHER, node=TWO)
    wait_for_conflict(nodes, f'{TWO} makes')
    wait_until_nothing_flows(nodes)
    assert not topic_of_level(nodes)[0]
    destroy_other(nodes, TWO)
    nodes.wait_until_flowing('level', 'half')
    nodes.until(lambda: nodes.status.level == DiagnosticStatus.OK, 'all is well')


def test_the_namespaces_of_engines(nodes: StreamNodes) -> None:
    nodes.start(ONE)
    nodes.start(FAR)
    nodes.start('/farther/engine')
    nodes.start_manager(engine_namespaces='["far"]')
    nodes.wait_for_engines(FAR)
    nodes.create('level', REQUESTED)
    nodes.until(lambda: nodes.engines_of() == {'level': FAR}, 'it is made')
    nodes.wait_for_engines(FAR)


def test_an_invalid_namespace_is_named(nodes: StreamNodes, tmp_path: Path) -> None:
    nodes.start(MANAGER, 'stream_manager', engine_namespaces='["/far robot"]')
    assert nodes.end(MANAGER) == 1
    log = (tmp_path / 'stream_manager.log').read_text()
    assert "'/far robot' cannot be a namespace" in log
