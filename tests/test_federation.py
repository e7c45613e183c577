"""Two hosts with clocks and ROS domains of their own, joined by zenoh."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult, Sample
from dyknow_interfaces.srv import ListSemanticSpecifications

from dyknow_bringup.security.systems import SecuredSystem, policy_text
from dyknow_bringup.simulation.link import FailingLink, free_port
from dyknow_common import Alternatives, Value
from dyknow_common.ros import STREAM
from dyknow_federation.report import LinkState
from dyknow_stream_processing.ros import sample_fields
from federations import BASE, CARRIER, Host, wait_for
from policies import GraphRecorder, rules


class Fleet(NamedTuple):
    base: Host
    carrier: Host
    link: FailingLink

    def wait(self, until: Callable[[], bool], what: str) -> None:
        """Wait until a condition holds, while the carrier publishes."""
        wait_for(self.base, self.carrier, until=until, what=what)


@pytest.fixture(scope='module')
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp('fleet')
    port = free_port()
    link = FailingLink(port)
    base = Host(folder / 'base', BASE.format(ends=f'listen: tcp/127.0.0.1:{port}'))
    ends = f'connect: tcp/127.0.0.1:{link.port}'
    carrier = Host(folder / 'carrier1', CARRIER.format(name='carrier1', ends=ends))
    carrier.publish_battery('carrier1')
    with ExitStack() as stack:
        for each in (link, base, carrier):
            stack.enter_context(each)
        yield Fleet(base, carrier, link)


def wait_for_streams(fleet: Fleet, number: int) -> None:
    """Wait until the base knows this number of streams of peers."""
    service = '/stream_semantics_manager/list_semantic_specifications'
    asked = fleet.base.client.request(ListSemanticSpecifications, service)

    def are_known() -> bool:
        nonlocal asked
        if not asked.done():
            return False
        if len(asked.result().ssl_statements) == number:
            return True
        asked = fleet.base.client.request(ListSemanticSpecifications, service)
        return False

    fleet.wait(are_known, f'{number} streams of peers')


@contextmanager
def listening(host: Host, topic: str, values: list[Value]) -> Iterator[None]:
    """Note the values of a stream of a peer."""
    node = host.client.node
    subscription = node.create_subscription(
        Sample, topic, lambda each: values.append(sample_fields(each)['value']), STREAM
    )
    yield
    node.destroy_subscription(subscription)


def assert_permitted(recorders: list[GraphRecorder]) -> None:
    """What the federation nodes use is in the policy of a host with peers."""
    policy = policy_text(SecuredSystem(has_peers=True).enclaves(), 'a host with peers')
    permitted = rules(policy)
    for recorder in recorders:
        recorder.look()
        used = {each for each in recorder.uses if each.enclave == '/federation'}
        forbidden = {each for each in used if not any(rule.permits(each) for rule in permitted)}
        assert used, 'the federation node is not on the graph'
        assert not forbidden, f'complete dyknow_bringup/security/interfaces.py: {forbidden}'


def test_a_formula_is_about_another_host(fleet: Fleet) -> None:
    recorders = [GraphRecorder(each.client.node) for each in (fleet.base, fleet.carrier)]
    wait_for_streams(fleet, 2)
    asked = fleet.base.ask('forall c in Carrier: always[0 s, 1 s] Charge[c] > 0.5')
    fleet.wait(asked.done, 'the answer')
    answer = asked.result()
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer
    assert answer.verdict == FormulaResult.TRUE, answer
    assert_permitted(recorders)


def test_of_a_feature_that_is_compared_only_the_comparison_is_known(fleet: Fleet) -> None:
    wait_for_streams(fleet, 2)
    values: list[Value] = []
    with listening(fleet.base, '/dyknow/federation/carrier1/Voltage_carrier1', values):
        asked = fleet.base.ask('always[0 s, 1 s] Voltage[carrier1] > 10')
        fleet.wait(asked.done, 'the answer')
    assert asked.result().verdict == FormulaResult.TRUE, asked.result()
    assert isinstance(values[-1], Alternatives)
    assert values[-1].bounds[0] > 10
    assert 'base asks for Voltage_carrier1 as compared with 10.0 alone' in values[-1].reason


def test_a_change_is_seen_where_its_time_is_not_known(fleet: Fleet) -> None:
    """For a moment, the charge is one of two values; the verdict is that of the later one."""
    wait_for_streams(fleet, 2)
    values: list[Value] = []
    with listening(fleet.base, '/dyknow/federation/carrier1/Charge_carrier1', values):
        asked = fleet.base.ask('always Charge[carrier1] > 0.5')
        fleet.wait(lambda: len(values) > 1, 'samples')
        assert not asked.done()
        fleet.carrier.percentage = 0.25
        fleet.wait(asked.done, 'the answer')
        found = next(each for each in values if isinstance(each, Alternatives))
        fleet.carrier.percentage = 0.9
        fleet.wait(lambda: values[-1] == values[0], 'the former charge')
    answer = asked.result()
    assert answer.verdict == FormulaResult.FALSE, answer
    assert 'Charge[carrier1] = 0.25' in answer.explanation
    assert found.values == (values[0], 0.25)
    assert 'the clocks of base and carrier1 differ by' in found.reason


def test_a_violation_at_another_host_ends_a_formula(fleet: Fleet) -> None:
    wait_for_streams(fleet, 2)
    asked = fleet.base.ask('always Charge[carrier1] > 0.5')
    fleet.wait(lambda: fleet.base.reports[-1].peers[0].asked == ['Charge_carrier1'], 'the request')
    fleet.carrier.battery_age_s = 10
    fleet.wait(asked.done, 'the answer')
    fleet.carrier.battery_age_s = 0
    status = asked.result().exit_status
    assert status.code == ExitStatus.CONSTRAINT_VIOLATION, status
    assert "peer 'carrier1' reports" in status.message, status
    assert 'max_delay' in status.message, status


def test_a_peer_that_leaves_ends_a_formula(fleet: Fleet) -> None:
    wait_for_streams(fleet, 2)
    asked = fleet.base.ask('always Charge[carrier1] > 0.5')
    fleet.wait(lambda: fleet.base.reports[-1].peers[0].asked == ['Charge_carrier1'], 'the request')
    fleet.link.cut()
    fleet.wait(asked.done, 'the answer')
    status = asked.result().exit_status
    assert status.code == ExitStatus.CONSTRAINT_VIOLATION, status
    assert "peer 'carrier1' has not been heard for" in status.message
    fleet.link.restore()
    fleet.wait(lambda: fleet.base.link_to('carrier1') is LinkState.LINKED, 'the peer is back')
    asked = fleet.base.ask('always[0 s, 1 s] Charge[carrier1] > 0.5')
    fleet.wait(asked.done, 'the answer')
    assert asked.result().verdict == FormulaResult.TRUE, asked.result()
