"""Samples and simulated time, whose steps come by another topic."""

from __future__ import annotations

from nav_msgs.msg import Odometry
from rclpy.parameter import Parameter
from rclpy.time import Time

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
