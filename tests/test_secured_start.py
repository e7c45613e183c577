"""Nodes where ROS security is enabled: they run in their enclave, or do not run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.msg import ConstraintViolation, Sample
from std_msgs.msg import Float64

from commands import command, output_of
from dyknow_common.executables import CANNOT_START
from dyknow_common.ros import STREAM, VIOLATIONS, RCLError
from dyknow_stream_processing.ros import StreamProxy
from dyknow_stream_processing.ros.topics.node_topics import NodeTopics
from system import Client, private_environment

MANAGER = command('stream_manager', '--ros-args', '--enclave', '/stream_manager')


def secured(keystore: Path) -> dict[str, str]:
    """Variables with which processes run in their enclaves of a keystore only."""
    (keystore / 'enclaves').mkdir(exist_ok=True)
    return {
        **private_environment(),
        'ROS_SECURITY_ENABLE': 'true',
        'ROS_SECURITY_STRATEGY': 'Enforce',
        'ROS_SECURITY_KEYSTORE': str(keystore),
    }


@pytest.mark.parametrize(
    ('line', 'code', 'enclave'),
    [
        (MANAGER, CANNOT_START, 'stream_manager'),
        (command('dyknow', 'up', '--namespace', 'robot1'), 2, 'robot1/dyknow_up'),
        (
            command('dyknow', 'evaluate', 'true', '--ros-args', '--enclave', '/dyknow_client'),
            2,
            'dyknow_client',
        ),
    ],
    ids=['a node', 'dyknow up in its own', 'a command in the named one'],
)
def test_nothing_runs_without_its_enclave(
    tmp_path: Path, line: list[str], code: int, enclave: str
) -> None:
    ended = output_of(line, secured(tmp_path))
    assert ended.returncode == code
    assert f"'{tmp_path}/enclaves/{enclave}' does not exist" in ended.stderr


def test_a_node_that_cannot_be_secured_does_not_run(tmp_path: Path) -> None:
    """Its enclave has no keys; and the middleware from PyPI has no security plugins."""
    environment = secured(tmp_path)
    (tmp_path / 'enclaves' / 'stream_manager').mkdir()
    ended = output_of(MANAGER, environment)
    assert ended.returncode == CANNOT_START
    assert 'Traceback' not in ended.stderr
    assert 'error creating node' in ended.stderr


def refuse(client: Client, monkeypatch: pytest.MonkeyPatch, refused: str) -> list[str]:
    """Refuse the first three subscriptions to a topic, as the middleware does; return them."""
    refusals: list[str] = []
    create = client.node.create_subscription

    def create_permitted(class_: Any, topic: str, *arguments: Any, **options: Any) -> Any:
        if topic == refused and len(refusals) < 3:
            refusals.append(topic)
            raise RCLError('could not create\n subscription')
        return create(class_, topic, *arguments, **options)

    monkeypatch.setattr(client.node, 'create_subscription', create_permitted)
    return refusals


def test_a_topic_that_may_not_be_read_harms_no_other(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The middleware refuses a subscription that the policy of the node does not permit."""
    refusals = refuse(client, monkeypatch, '/secret')
    logged: list[str] = []
    monkeypatch.setattr(client.node.get_logger(), 'error', logged.append)
    publishers = {
        topic: client.node.create_publisher(Float64, topic, 10) for topic in ('/secret', '/open')
    }
    samples: dict[str, list[Any]] = {topic: [] for topic in publishers}
    proxies = [
        StreamProxy(client.node, topic, on_sample=samples[topic].append, message_type=Float64)
        for topic in publishers
    ]

    def publish_until(topic: str) -> None:
        def is_received() -> bool:
            for publisher in publishers.values():
                publisher.publish(Float64())
            return bool(samples[topic])

        client.spin_until(is_received, f'a sample of {topic}', pause=0.05)

    publish_until('/open')
    assert refusals
    publish_until('/secret')
    assert len(refusals) == 3
    (text,) = [each for each in logged if '/secret' in each]
    assert text == (
        "topic '/secret' cannot be subscribed to: could not create subscription; where ROS "
        'security is enabled, the policy of this node must permit it'
    )
    for proxy in proxies:
        proxy.destroy()


def test_violations_that_may_not_be_read_harm_no_other(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stream whose violations are unknown is not used."""
    refusals = refuse(client, monkeypatch, '/s/violations')
    publisher = client.node.create_publisher(Sample, '/s', STREAM)
    samples: list[Any] = []
    specification = 'source (x: int) "/s"; stream a = select x from "/s"; sink a'
    proxy = StreamProxy(client.node, specification, on_sample=samples.append)
    client.spin_until(lambda: publisher.get_subscription_count() > 0, 'the proxy subscribes')
    client.node.create_publisher(ConstraintViolation, '/s/violations', VIOLATIONS)
    client.spin_until(lambda: len(refusals) == 3, 'violations are refused')
    client.spin_until(
        lambda: NodeTopics.of(client.node).fault('/s') == '', 'the topic is subscribed to'
    )
    assert not samples
    proxy.destroy()
