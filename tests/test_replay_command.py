"""The replay of a recording; `test_recordings_as_live` monitors one under simulated time."""

from __future__ import annotations

from contextlib import closing
from functools import partial
from pathlib import Path

from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState
from std_msgs.msg import Bool

from commands import command, running
from dyknow_bringup.resources import share
from dyknow_common import SECOND_NS
from dyknow_recordings import offered_profile
from system import Client, private_environment

RECORDING = share() / 'recordings' / 'power_surge'


def test_a_recording_is_replayed_with_its_clock() -> None:
    environment = private_environment()
    client = Client(environment)
    batteries: list[BatteryState] = []
    clocks: list[int] = []
    client.node.create_subscription(BatteryState, '/uav1/battery', batteries.append, 100)
    client.node.create_subscription(Clock, '/clock', lambda m: clocks.append(m.clock.sec), 100)
    # On a busy machine discovery takes seconds.
    play = ('--clock', '--rate', '10', '--delay', '5')
    with running(command('replay', str(RECORDING), *play), environment) as process:
        client.spin_until(lambda: process.poll() is not None, 'the end of the recording')
        assert process.returncode == 0
    client.close()
    # The recording lasts 20 s, at five messages a second.
    assert len(batteries) == 100
    assert clocks == sorted(clocks)
    assert clocks[-1] - clocks[0] >= 19


def test_topics_of_several_publishers_have_several_again(tmp_path: Path) -> None:
    """Otherwise, an engine would take them for one publisher that stamps in order."""
    types, kind = get_typestore(Stores.ROS2_JAZZY), 'std_msgs/msg/Bool'
    offered = offered_profile(reliable=True, latched=False, depth=10)
    with Writer(tmp_path / 'bag', version=9) as writer:
        for topic, count in (('/one', 1), ('/several', 3)):
            connection = writer.add_connection(
                topic, kind, typestore=types, offered_qos_profiles=[offered] * count
            )
            data = types.serialize_cdr(types.types[kind](True), kind)
            writer.write(connection, SECOND_NS, data)
    environment = private_environment()
    received: list[str] = []
    line = command('replay', str(tmp_path / 'bag'), '--delay', '5')
    with closing(Client(environment)) as client, running(line, environment) as process:
        for topic in ('/one', '/several'):
            client.node.create_subscription(Bool, topic, partial(_add, received, topic), 10)
        publishers = client.node.count_publishers
        client.spin_until(
            lambda: publishers('/several') > 1 and publishers('/one') > 0, 'the publishers'
        )
        assert (publishers('/one'), publishers('/several')) == (1, 2)
        client.spin_until(lambda: process.poll() is not None, 'the end of the recording')
    assert sorted(received) == ['/one', '/several']


def _add(received: list[str], topic: str, _: Bool) -> None:
    received.append(topic)
