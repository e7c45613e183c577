"""`soon` over a forecast in the running system, and the same over a recording."""

from __future__ import annotations

import json
from pathlib import Path

from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from commands import command, dyknow_up, output_beside, output_of
from dyknow_common.ros import LATCHED, nanoseconds_to_time
from system import Client, private_environment

ROBOT = """\
features:
  Height:
    unit: m
    from: {topic: /odom, field: pose.pose.position.z, max_delay: 10 s, reorder: false}
    forecast:
      by: constant_velocity
      fields: {rate: twist.twist.linear.z}
      horizons: 1 s
      step: 250 ms
formulas:
  - {name: ceiling, formula: 'always not soon[1 s] Height > 5 m'}
"""
SPEED = 2.5
STEP = 0.25  # The climb of a message: floats hold it, and its multiples, exactly.
PERIOD_NS = 100_000_000


def odometry(climbed: int, time: int) -> Odometry:
    message = Odometry()
    message.header.stamp = nanoseconds_to_time(time)
    message.pose.pose.position.z = STEP * climbed
    message.twist.twist.linear.z = SPEED if climbed else 0.0
    return message


def recorded(path: Path) -> str:
    start = 1_700_000_000_000_000_000
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    name = 'nav_msgs/msg/Odometry'
    with writer:
        connection = writer.add_connection(
            '/odom', name, typestore=get_typestore(Stores.ROS2_JAZZY)
        )
        for index in range(30):
            time = start + index * PERIOD_NS
            writer.write(connection, time, serialize_message(odometry(max(0, index - 5), time)))
    return str(path)


def test_an_announced_limit_live_and_recorded(tmp_path: Path) -> None:
    robot = tmp_path / 'robot.yaml'
    robot.write_text(ROBOT)
    environment = private_environment()
    with dyknow_up(environment, str(robot)):
        client = Client(environment)
        climbed = 0
        has_state = False
        publisher = client.node.create_publisher(Odometry, '/odom', 10)

        def publish() -> None:
            nonlocal climbed
            climbed += has_state
            now = client.node.get_clock().now().nanoseconds
            publisher.publish(odometry(climbed, now))

        def follow(report: EvaluationStatusArray) -> None:
            nonlocal has_state
            has_state = has_state or any(
                each.phase == EvaluationStatus.RUNNING and each.states_progressed
                for each in report.evaluations
            )

        client.node.create_timer(PERIOD_NS / 1e9, publish)
        topic = 'stream_reasoning_coordinator/evaluations'
        client.node.create_subscription(EvaluationStatusArray, topic, follow, LATCHED)
        done = output_beside(
            client, command('dyknow', 'monitor', str(robot), '--json'), environment
        )
        client.close()
    assert done.returncode == 1, done.stdout
    live = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{')][-1]
    checked = output_of(
        command('dyknow', 'check', recorded(tmp_path / 'bag'), '--config', str(robot), '--json'),
        environment,
    )
    ((later,),) = [each['episodes'] for each in json.loads(checked.stdout)['formulas']]
    # The first height above 2.5 m is 2.75 m: within 1 s, 5.25 m are reached.
    for found in (live['explanation'], later['explanation']):
        assert found.startswith('Height_high_1s = 5.25 at ')
        assert 'is not <= 5 m' in found
        assert found.endswith('(not calibrated: Height_high_1s)')
    assert (live['outcome'], later['verdict']) == ('false', 'false')
