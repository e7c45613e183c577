"""Samples and simulated time, whose steps come by another topic."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from std_msgs.msg import Header

from dyknow_stream_processing import Sample, Violation
from dyknow_stream_processing.ros import StreamProxy
from services import time_of
from system import Client

MS = 1_000_000


def test_a_sample_ahead_of_the_clock_is_processed_before_its_successor(client: Client) -> None:
    """The clock advances, and the next sample comes, before the timer that follows the clock."""
    client.node.set_parameters([Parameter('use_sim_time', value=True)])
    samples: list[Sample] = []
    violations: list[Violation] = []
    publisher = client.node.create_publisher(Odometry, '/odom', 10)
    StreamProxy(client.node, '/odom', on_sample=samples.append, on_violation=violations.append)
    client.spin_until(lambda: publisher.get_subscription_count() > 0, 'the subscription')
    (subscription,) = (each for each in client.node.subscriptions if each.topic_name == '/odom')
    clock = client.node.get_clock()

    def receive(stamp: int) -> None:
        message = Odometry()
        message.header.stamp = time_of(stamp)
        subscription.callback(message, {'publication_sequence_number': stamp // (100 * MS)})

    clock.set_ros_time_override(Time(nanoseconds=1000 * MS))
    receive(1300 * MS)
    assert samples == []
    clock.set_ros_time_override(Time(nanoseconds=1400 * MS))
    receive(1400 * MS)
    # If this process was stopped just before, the samples wait for messages from before.
    client.spin_until(lambda: len(samples) > 1, 'both samples')
    assert [each.valid_time for each in samples] == [1300 * MS, 1400 * MS]
    assert violations == []


def test_a_value_that_was_kept_is_not_late(client: Client) -> None:
    """Its sending has a time of the system clock alone, as has the subscription."""
    kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = client.node.create_publisher(Odometry, '/odom', kept)
    publisher.publish(Odometry(header=Header(stamp=time_of(3_000 * MS))))
    client.node.set_parameters([Parameter('use_sim_time', value=True)])
    client.node.get_clock().set_ros_time_override(Time(nanoseconds=100_000 * MS))
    samples: list[Sample] = []
    violations: list[Violation] = []
    StreamProxy(client.node, '/odom', on_sample=samples.append, on_violation=violations.append)
    client.spin_until(lambda: bool(samples or violations), 'the sample')
    assert [each.valid_time for each in samples] == [3_000 * MS]
    publisher.publish(Odometry(header=Header(stamp=time_of(4_000 * MS))))
    client.spin_until(lambda: bool(violations), 'a late one')
    client.node.set_parameters([Parameter('use_sim_time', value=False)])
    assert [each.constraint for each in violations[:1]] == ['max_delay']
    assert 'use_sim_time was changed; all streams restart' in violations[1].message
