"""Targets of triggers that the running system lacks or has with other types, at the start."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.action import MonitorFormula
from rclpy.action import ActionServer
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from commands import command, output_of
from dyknow_configuration import ConfigurationError
from dyknow_coordinator import Progress
from dyknow_reactions.ros.triggers import TargetFault, Triggers, find_target_faults, targets
from system import Client, private_environment
from test_triggers import SECOND, VIOLATED, formula

BOOL = 'std_srvs/srv/SetBool'
EMPTY = 'std_srvs/srv/Trigger'
STRING = 'std_msgs/msg/String'
FLOAT = 'std_msgs/msg/Float64'
MONITOR = 'dyknow_interfaces/action/MonitorFormula'
EVALUATE = 'dyknow_interfaces/action/MonitorPlan'

WRONG = {
    f'publish: {{topic: /words, type: {FLOAT}}}': (
        f'the topic /words has the type {STRING}, not {FLOAT}'
    ),
    f'publish: {{topic: /texts, type: {FLOAT}}}': (
        f'the topic /texts has the type {STRING}, not {FLOAT}'
    ),
    f'call: {{service: /alarm, type: {EMPTY}}}': (
        f'the service /alarm has the type {BOOL}, not {EMPTY}'
    ),
    f'send_goal: {{action: /dock, type: {EVALUATE}}}': (
        f'the action /dock has the type {MONITOR}, not {EVALUATE}'
    ),
}
"""Triggers with other types than the running system has; /texts is published only."""

RIGHT = (
    f'publish: {{topic: /words, type: {STRING}}}',
    f'publish: {{topic: /texts_and_words, type: {STRING}}}',
    f'call: {{service: /alarm, type: {BOOL}}}',
    f'send_goal: {{action: /dock, type: {MONITOR}}}',
    'cancel_goal: /dock',
    'run: ["true"]',
)

MISSING = {
    f'publish: {{topic: /faults, type: {STRING}}}': 'no node is known to subscribe to /faults',
    f'publish: {{topic: /texts, type: {STRING}}}': 'no node is known to subscribe to /texts',
    f'call: {{service: /alarms, type: {BOOL}}}': 'no node is known to offer the service /alarms',
    # A client is no server, and an action is no service.
    f'call: {{service: /asked, type: {BOOL}}}': 'no node is known to offer the service /asked',
    f'call: {{service: /dock, type: {BOOL}}}': 'no node is known to offer the service /dock',
    f'send_goal: {{action: /park, type: {MONITOR}}}': 'no node is known to offer the action /park',
    'cancel_goal: /park': 'no node is known to offer the action /park',
}


def serve(node: Any) -> None:
    """Offer /words, /alarm and /dock."""
    node.create_subscription(String, '/words', lambda _: None, 10)
    node.create_subscription(String, '/texts_and_words', lambda _: None, 10)
    node.create_publisher(String, '/texts', 10)
    node.create_service(SetBool, '/alarm', lambda _, response: response)
    node.create_client(SetBool, '/asked')
    ActionServer(node, MonitorFormula, '/dock', lambda _: MonitorFormula.Result())


@pytest.fixture
def robot() -> Iterator[Client]:
    """The node of a robot, and nothing else in its domain."""
    with closing(Client(private_environment())) as robot:
        serve(robot.node)
        yield robot


@pytest.fixture
def monitoring(robot: Client) -> Iterator[Client]:
    """A node that discovers the robot."""
    with closing(Client({'ROS_DOMAIN_ID': str(robot.context.get_domain_id())})) as monitoring:
        yield monitoring


def faults(client: Client, folder: Path, actions: Iterable[str]) -> list[TargetFault]:
    """Return the faults of triggers in one file."""
    triggers = ', '.join(f'{{{each}}}' for each in actions)
    return find_target_faults(client.node, [formula(folder, f'{{false: [{triggers}]}}')])


def test_another_type_is_an_error_at_its_place(monitoring: Client, tmp_path: Path) -> None:
    found = faults(monitoring, tmp_path, WRONG)
    assert [(each.text, each.is_missing) for each in found] == [
        (each, False) for each in WRONG.values()
    ]
    for each in found:
        assert str(each.error).startswith(f'{tmp_path}/robot.yaml:2:')
        shown, caret = str(each.error).splitlines()[-2:]
        assert shown[caret.index('^') :].startswith(each.trigger.type_name), each.error


def test_what_nobody_offers_may_come_later(monitoring: Client, tmp_path: Path) -> None:
    found = faults(monitoring, tmp_path, MISSING)
    assert [(each.text, each.is_missing) for each in found] == [
        (each, True) for each in MISSING.values()
    ]
    for each in found:
        assert each.warning.startswith(f'{tmp_path}/robot.yaml:2:')
        assert each.warning.endswith(each.text)
        shown, caret = str(each.error).splitlines()[-2:]
        assert shown[caret.index('^') :].startswith(each.trigger.target), each.error


def test_what_is_there_is_no_fault(monitoring: Client, tmp_path: Path) -> None:
    assert faults(monitoring, tmp_path, RIGHT) == []


def test_a_start_does_not_wait_for_targets(
    monitoring: Client,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    """What lacks or has another type is logged later."""
    logged: list[str] = []

    def has_logged() -> bool:
        logged.extend(each for each in capfd.readouterr().err.splitlines() if 'trigger: ' in each)
        return len(logged) > 1

    wrong, missing = (
        next(each for each in found if '/alarm' in each) for found in (WRONG, MISSING)
    )
    requested = [formula(tmp_path, f'{{false: [{{{wrong}}}, {{{missing}}}]}}')]
    monkeypatch.setattr(targets, 'DISCOVERY_S', 3600.0)
    with Triggers(monitoring.node, requested):
        monitoring.spin_until(
            lambda: any('/alarm' in name for name, _ in services_of(monitoring)), 'discovery'
        )
    monkeypatch.setattr(targets, 'DISCOVERY_S', 0.0)
    with Triggers(monitoring.node, requested):
        monitoring.spin_until(has_logged, 'the log')
    for line, level, text in zip(
        logged, ('[ERROR]', '[WARN]'), (WRONG[wrong], MISSING[missing]), strict=True
    ):
        assert line.startswith(level)
        assert f'trigger: {tmp_path}/robot.yaml:2:' in line
        assert line.endswith(text)


def test_two_triggers_with_different_types(monitoring: Client, tmp_path: Path) -> None:
    one, other = (f'{{publish: {{topic: /a, type: {each}}}}}' for each in (STRING, FLOAT))
    with pytest.raises(ConfigurationError) as error:
        Triggers(monitoring.node, [formula(tmp_path, f'{{false: [{one}, {other}]}}')])
    assert f'another trigger uses the topic /a with the type {STRING}' in str(error.value)
    assert str(error.value).startswith(f'{tmp_path}/robot.yaml:2:')


def test_two_names_of_one_topic_with_different_types(monitoring: Client, tmp_path: Path) -> None:
    """This node has no namespace."""
    one, other = (
        f'{{publish: {{topic: {topic}, type: {kind}}}}}'
        for topic, kind in (('/a', STRING), ('a', FLOAT))
    )
    message = f'robot.yaml:2:.*another trigger uses the topic /a with the type {STRING}'
    with pytest.raises(ConfigurationError, match=message):
        Triggers(monitoring.node, [formula(tmp_path, f'{{false: [{one}, {other}]}}')])


def test_runs_with_two_names_of_one_target_keep_their_order(
    monitoring: Client, tmp_path: Path
) -> None:
    """A retry of the alarm must not follow the report that it is over."""
    first, second = (
        f'{{call: {{service: {name}, type: {BOOL}, request: {{data: {data}}}}}, retries: 2}}'
        for name, data in (('alarm', 'true'), ('/alarm', 'false'))
    )
    requested = formula(tmp_path, f'{{false: {first}, clear: {second}}}')
    with Triggers(monitoring.node, [requested], logs_targets=False) as triggers:
        one, other = triggers.uses
        assert one.target == other.target


def test_types_that_the_middleware_refuses(monitoring: Client, tmp_path: Path) -> None:
    monitoring.node.create_publisher(String, '/a', 10)
    requested = formula(tmp_path, f'{{false: {{publish: {{topic: a, type: {FLOAT}}}}}}}')
    with pytest.raises(ConfigurationError, match=r'robot\.yaml:2:.*incompatible type'):
        Triggers(monitoring.node, [requested])


def test_a_subscriber_that_requests_another_quality(
    robot: Client, monitoring: Client, tmp_path: Path
) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    robot.node.create_subscription(String, '/latched', lambda _: None, latched)
    monitoring.spin_until(
        lambda: monitoring.node.count_subscribers('/latched') > 0, 'the subscriber'
    )
    requested = formula(tmp_path, f'{{false: {{publish: {{topic: /latched, type: {STRING}}}}}}}')
    with Triggers(monitoring.node, [requested]) as triggers:
        triggers.on_progress(requested, Progress(4, SECOND, '', episodes=VIOLATED))
        monitoring.spin_until(lambda: triggers.is_idle, 'the end of the run')
        assert triggers.uses[0].text == (
            'no subscriber of /latched requests a quality of service that triggers offer: '
            'reliable, volatile, without deadlines'
        )


def test_a_type_that_comes_after_the_start(
    robot: Client, monitoring: Client, tmp_path: Path
) -> None:
    requested = formula(
        tmp_path,
        f'{{false: {{call: {{service: /late, type: {BOOL}}}, retries: 1, timeout: 200 ms}}}}',
    )
    with Triggers(monitoring.node, [requested]) as triggers:
        robot.node.create_service(Trigger, '/late', lambda _, response: response)
        monitoring.spin_until(
            lambda: any('/late' in name for name, _ in services_of(monitoring)), 'discovery'
        )
        triggers.on_progress(requested, Progress(4, SECOND, '', episodes=VIOLATED))
        monitoring.spin_until(lambda: triggers.is_idle, 'the end of the run')
        assert triggers.uses[0].text == (
            'service /late is not available '
            f'(the service /late has the type {EMPTY}, not {BOOL}) within 200 ms'
        )


def services_of(client: Client) -> Any:
    return client.node.get_service_names_and_types_by_node('test_client', '/')


def test_the_monitor_refuses_and_warns(robot: Client, tmp_path: Path) -> None:
    environment = {'ROS_DOMAIN_ID': str(robot.context.get_domain_id())}
    formula(tmp_path, f'{{false: {{call: {{service: /alarm, type: {EMPTY}}}}}}}')
    line = command('dyknow', 'monitor', str(tmp_path / 'robot.yaml'))
    done = output_of(line, environment)
    assert done.returncode == 2
    assert f'the service /alarm has the type {BOOL}, not {EMPTY}' in done.stderr
    assert f'dyknow: {tmp_path}/robot.yaml:2:' in done.stderr
    formula(tmp_path, f'{{false: {{call: {{service: /alarms, type: {BOOL}}}}}}}')
    done = output_of([*line, '--wait', f'{targets.DISCOVERY_S + 1}'], environment)
    assert done.stderr.count('no node is known to offer the service /alarms') == 1


def test_lint_sees_the_running_system(robot: Client, tmp_path: Path) -> None:
    environment = {'ROS_DOMAIN_ID': str(robot.context.get_domain_id())}
    wrong = f'{{call: {{service: /alarm, type: {EMPTY}}}}}'
    missing = f'{{call: {{service: /alarms, type: {BOOL}}}}}'
    formula(tmp_path, f'{{false: [{wrong}, {missing}]}}')
    path = str(tmp_path / 'robot.yaml')
    line = command('dyknow', 'lint', path, '--live', '--duration', '1', '--json')
    done = output_of(line, environment)
    found = [json.loads(each) for each in done.stdout.splitlines()]
    columns = [each['column'] for each in found if 'alarm' in each['message']]
    assert [(each['level'], each['message']) for each in found if 'alarm' in each['message']] == [
        (
            'error',
            f"trigger 'call /alarm': the service /alarm has the type {BOOL}, not {EMPTY}",
        ),
        ('warning', "trigger 'call /alarms': no node is known to offer the service /alarms"),
    ], done.stderr
    written = (tmp_path / 'robot.yaml').read_text(encoding='utf-8').splitlines()[1]
    for column, place in zip(columns, (EMPTY, '/alarms'), strict=True):
        assert written[column - 1 :].startswith(place)
