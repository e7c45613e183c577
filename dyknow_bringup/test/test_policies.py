"""SROS2 policies: their schema, what they permit, and that the shipped ones are up to date."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from dyknow_bringup.errors import BringupError
from dyknow_bringup.security.interfaces import (
    ACTIONS,
    COORDINATOR,
    SERVICES,
    Interfaces,
    monitor_interfaces,
)
from dyknow_bringup.security.systems import (
    Enclave,
    SecuredSystem,
    outputs_of,
    policy_text,
    shipped_policies,
    topics_of,
)
from dyknow_common import LanguageError
from dyknow_configuration import ACTION_KEYS, RequestedFormula, RequestedGuard, Trigger, TriggerKind

FOLDER = Path(__file__).parent.parent / 'security'
NAMES = sorted(shipped_policies())

CHILDREN = {
    'policy': {'enclaves'},
    'enclaves': {'enclave'},
    'enclave': {'profiles'},
    'profiles': {'profile'},
    'profile': {'topics', 'services', 'actions'},
    'topics': {'topic'},
    'services': {'service'},
    'actions': {'action'},
}
ATTRIBUTES = {
    'policy': {'version'},
    'enclave': {'path'},
    'profile': {'ns', 'node'},
}
PERMISSIONS = {
    'topics': {'publish', 'subscribe'},
    'services': {'reply', 'request'},
    'actions': {'call', 'execute'},
}


def check_schema(element: ET.Element) -> None:
    """Check an element of a policy of version 0.2.0, and the elements in it."""
    tag = element.tag
    if tag in PERMISSIONS:
        assert set(element.attrib.values()) == {'ALLOW'}
        assert set(element.attrib) <= PERMISSIONS[tag]
    else:
        assert set(element.attrib) == ATTRIBUTES.get(tag, set())
    assert {child.tag for child in element} <= CHILDREN.get(tag, set())
    assert bool(len(element)) == (tag in CHILDREN), f'{tag} must not be empty'
    for child in element:
        check_schema(child)


def enclaves(text: str) -> dict[str, ET.Element]:
    """The enclaves of a policy, by path."""
    found = list(ET.fromstring(text).iter('enclave'))  # noqa: S314 - our own text
    by_path = {each.attrib['path']: each for each in found}
    assert len(by_path) == len(found), 'one enclave for each path'
    return by_path


def permitted(enclave: ET.Element, permission: str) -> set[str]:
    """The names for which an enclave has a permission."""
    return {name.text or '' for each in enclave.findall(f'.//*[@{permission}]') for name in each}


@pytest.mark.parametrize('name', NAMES)
def test_shipped_policies_are_up_to_date(name: str) -> None:
    shipped = (FOLDER / f'{name}.policy.xml').read_text(encoding='utf-8')
    assert shipped == shipped_policies()[name], 'run: python tools/make_policies.py'


def test_no_other_policy_is_shipped() -> None:
    assert sorted(path.name for path in FOLDER.iterdir()) == [
        f'{name}.policy.xml' for name in NAMES
    ]


@pytest.mark.parametrize('name', NAMES)
def test_policies_have_the_schema_of_sros2(name: str) -> None:
    policy = ET.fromstring(shipped_policies()[name])  # noqa: S314 - our own text
    assert (policy.tag, policy.attrib) == ('policy', {'version': '0.2.0'})
    check_schema(policy)


@pytest.mark.parametrize('name', NAMES)
def test_sros2_reads_the_policies(name: str) -> None:
    sros2 = pytest.importorskip('sros2.policy', reason='sros2 is not installed')
    sros2.load_policy(FOLDER / f'{name}.policy.xml')


def test_each_robot_has_enclaves_of_its_own() -> None:
    found = enclaves(shipped_policies()['robots'])
    for path, enclave in found.items():
        robot = path.split('/')[1]
        names = {
            name
            for permission in set().union(*PERMISSIONS.values())
            for name in permitted(enclave, permission)
        }
        common = {'/clock', '/diagnostics', '/parameter_events', '/rosout'}
        own = (f'/{robot}/', '/_ros2cli')
        assert [name for name in names - common if not name.startswith(own)] == []


def test_only_the_engine_publishes_streams_and_only_the_reasoning_engine_results() -> None:
    found = enclaves(shipped_policies()['dyknow'])

    def publishers(start: str) -> set[str]:
        return {
            path
            for path, each in found.items()
            if any(name.startswith(start) for name in permitted(each, 'publish'))
        }

    assert publishers('/dyknow/streams') == {'/stream_processing_engine'}
    assert publishers(f'/{COORDINATOR}/_results') == {'/stream_reasoning_engine'}
    assert all(
        '*' not in name.removesuffix('*')
        for each in found.values()
        for name in permitted(each, 'publish')
    )


def test_clients_ask_the_coordinator_alone_and_change_nothing() -> None:
    own = enclaves(policy_text(SecuredSystem(clients=('/arm/pilot',)).enclaves(), ''))['/arm/pilot']
    for_others = {f'/{COORDINATOR}/cancel_evaluation'}
    services = {f'/{COORDINATOR}/{name}' for name in SERVICES[COORDINATOR]}
    assert permitted(own, 'request') == services - for_others
    assert permitted(own, 'call') == {f'/{COORDINATOR}/{name}' for name in ACTIONS}
    assert permitted(own, 'publish') == {'/parameter_events', '/rosout'}


def test_engines_in_other_namespaces_read_the_streams_of_each_other() -> None:
    system = SecuredSystem('robot1', frozenset({'odom', '/map'}), ('engine', 'arm/engine'))
    found = enclaves(policy_text(system.enclaves(), ''))
    base, arm = found['/robot1/engine'], found['/robot1/arm/engine']
    assert '/robot1/arm/dyknow/streams/*' in permitted(base, 'subscribe') & permitted(
        arm, 'publish'
    )
    assert {'/robot1/odom', '/map'} <= permitted(arm, 'subscribe')
    assert '/robot1/dyknow/streams/*' in permitted(arm, 'subscribe') - permitted(arm, 'publish')
    manager = found['/robot1/stream_manager']
    assert '/robot1/arm/engine/stream_destroy' in permitted(manager, 'request')


def test_topics_are_those_that_a_text_does_not_make() -> None:
    text = """
        source (x: float) scan;
        stream a = select x from scan;
        stream b = sync(a, "/odom", elsewhere);
        sink b
    """
    assert topics_of(text) == {'scan', '/odom'}
    with pytest.raises(LanguageError):
        topics_of('stream')


def test_topics_of_frames_actions_and_sinks() -> None:
    text = """
        stream a = sync(tf("map", "base"), action("dock"));
        stream b = select yaw from a;
        sink a as std_msgs/msg/Float64 (data = yaw) on "yaw";
        sink b as std_msgs/msg/Float64
    """
    topics, outputs = topics_of(text), outputs_of(text)
    assert topics == {'/tf', '/tf_static', 'dock/_action/status'}
    assert outputs == {'yaw'}
    system = SecuredSystem('robot1', topics, outputs=outputs)
    engine = enclaves(policy_text(system.enclaves(), ''))['/robot1/stream_processing_engine']
    assert '/robot1/dock/_action/status' in permitted(engine, 'subscribe')
    assert '/robot1/yaw' in permitted(engine, 'publish')


@pytest.mark.parametrize('name', ['/*', 'a b', '/a[0-9]', 'a/?', '/a//b', '<a>', 'ü'])
def test_a_name_does_not_permit_others(name: str) -> None:
    for field in ('namespace', 'topics', 'engines', 'clients', 'outputs', 'snapshots'):
        value = name if field == 'namespace' else [name]
        with pytest.raises(BringupError, match=f"'{re.escape(name)}' is no name"):
            SecuredSystem(**{field: value})  # type: ignore[arg-type]


def test_names_are_escaped() -> None:
    used = Interfaces(subscribes=frozenset({'/<a>&b'}))
    (enclave,) = enclaves(policy_text([Enclave('/"<', {'/n': used})], 'c')).values()
    assert enclave.attrib['path'] == '/"<'
    assert permitted(enclave, 'subscribe') == {'/<a>&b'}


def test_a_guard_may_do_what_it_must_and_no_more() -> None:
    formulas = (RequestedFormula('p'),)
    guard = RequestedGuard('base_guard', '/cmd_vel_in', 'cmd_vel', formulas)
    text = policy_text(SecuredSystem('robot1', guards=(guard,)).enclaves(), '')
    enclave = enclaves(text)['/robot1/base_guard']
    check_schema(ET.fromstring(text))  # noqa: S314 - our own text
    published = {each.text for each in enclave.iterfind('.//topics[@publish]/topic')}
    subscribed = {each.text for each in enclave.iterfind('.//topics[@subscribe]/topic')}
    assert {'/robot1/cmd_vel', '/robot1/base_guard/_status', '/diagnostics'} < published
    assert '/cmd_vel_in' not in published
    assert {
        '/cmd_vel_in',
        '/robot1/stream_manager/_pulse',
        '/robot1/stream_reasoning_coordinator/evaluations',
        '/robot1/dyknow/streams/*',
    } < subscribed
    served = {each.text for each in enclave.iterfind('.//services[@reply]/service')}
    assert '/robot1/base_guard/reset' in served
    admin = enclaves(text)['/robot1/dyknow_admin']
    assert permitted(enclave, 'reply') - permitted(admin, 'request') == {
        '/robot1/base_guard/get_type_description'
    }


@pytest.mark.parametrize('has_peers', [False, True])
def test_the_recorder_reads_what_the_engines_read(*, has_peers: bool) -> None:
    system = SecuredSystem('robot1', frozenset({'/odom'}), has_peers=has_peers)
    found = enclaves(policy_text(system.enclaves(), ''))
    remote = '/robot1/dyknow/federation/*'
    for name in 'stream_processing_engine', 'black_box_recorder':
        read = permitted(found[f'/robot1/{name}'], 'subscribe')
        assert ('/odom' in read, remote in read) == (True, has_peers), name


def test_the_recorder_calls_its_snapshot_service() -> None:
    system = SecuredSystem('robot1', snapshots=('rosbag2_recorder/snapshot',))
    recorder = enclaves(policy_text(system.enclaves(), ''))['/robot1/black_box_recorder']
    assert '/robot1/rosbag2_recorder/snapshot' in permitted(recorder, 'request')


@pytest.mark.parametrize('kind', ACTION_KEYS)
def test_a_monitor_may_use_the_targets_of_its_triggers(kind: TriggerKind) -> None:
    assert '/target' in str(monitor_interfaces([Trigger('t', kind, '/target')]))
