"""Two hosts with clocks and ROS domains of their own, joined by zenoh."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from dyknow_interfaces.msg import (
    EvaluationStatus,
    EvaluationStatusArray,
    ExitStatus,
    FormulaResult,
    GuardStatus,
    Sample,
)

from dyknow_bringup.processes.composition import NODES
from dyknow_bringup.security.systems import SecuredSystem, policy_text
from dyknow_bringup.simulation.link import FailingLink, free_port
from dyknow_common import Alternatives, Value, format_time
from dyknow_common.ros import LATCHED, STREAM, time_to_nanoseconds
from dyknow_configuration import RequestedFederation
from dyknow_federation.encoding import VERSION
from dyknow_federation.report import LinkState
from dyknow_federation.ros.transport import ZenohTransport
from dyknow_stream_processing.ros import sample_fields
from federations import BASE, CARRIER, ZENOH, Host, wait_for, wait_for_streams
from guards import guarded_base
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


@contextmanager
def listening(host: Host, topic: str, values: list[Value]) -> Iterator[None]:
    """Note the values of a stream of a peer."""
    node = host.client.node
    subscription = node.create_subscription(
        Sample, topic, lambda each: values.append(sample_fields(each)['value']), STREAM
    )
    yield
    node.destroy_subscription(subscription)


def is_asked(host: Host, *, here: bool) -> bool:
    """Return True if a host asks for nothing but the charge, or the verdict of a formula."""
    asked = host.reports[-1].peers[0].asked
    return len(asked) == 1 and asked[0].startswith('Charge_' if here else '_verdict_')


def running(heard: list[Any]) -> Any:
    """Return the evaluation that runs, as last reported; an empty status if there is none."""
    reported = [each for report in heard[-1:] for each in report.evaluations]
    found = (each for each in reported if each.phase != EvaluationStatus.ENDED)
    return next(found, EvaluationStatus())


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
    wait_for_streams(2, fleet.base, fleet.carrier)
    asked = fleet.base.ask('forall c in Carrier: always[0 s, 1 s] Charge[c] > 0.5')
    fleet.wait(asked.done, 'the answer')
    answer = asked.result()
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer
    assert answer.verdict == FormulaResult.TRUE, answer
    assert_permitted(recorders)


def test_a_verdict_crosses_after_an_outage(fleet: Fleet) -> None:
    """The formula is false during the outage, for a moment that no sample tells of."""
    wait_for_streams(2, fleet.base, fleet.carrier)
    fleet.wait(lambda: not fleet.base.reports[-1].peers[0].asked, 'the release')
    asked = fleet.base.ask('forall c in Carrier: always Charge[c] > 0.5')
    fleet.wait(lambda: is_asked(fleet.base, here=False), 'the request')
    fleet.link.cut()
    fleet.carrier.percentage = 0.25
    fleet.wait(lambda: fleet.base.link_to('carrier1') is LinkState.STALE, 'the outage')
    fleet.carrier.percentage = 0.9
    assert not asked.done()
    fleet.link.restore()
    fleet.wait(asked.done, 'the answer')
    answer = asked.result()
    assert answer.verdict == FormulaResult.FALSE, answer
    assert answer.explanation.startswith('Charge[carrier1] = 0.25')
    assert 'verdict' not in answer.explanation
    fleet.wait(lambda: not fleet.base.reports[-1].peers[0].asked, 'the release')


def test_a_host_waits_for_the_sensor_of_a_peer(fleet: Fleet) -> None:
    """No state is told that the peer has not evaluated, and no verdict is later than its state."""
    wait_for_streams(2, fleet.base, fleet.carrier)
    topic = '/stream_reasoning_coordinator/evaluations'
    heard = fleet.base.client.collect(EvaluationStatusArray, topic, LATCHED)
    fleet.wait(lambda: not fleet.base.reports[-1].peers[0].asked, 'the release')
    asked = fleet.base.ask('always Voltage[carrier1] > 5')
    fleet.wait(lambda: running(heard).states_progressed, 'a state')
    fleet.carrier.has_battery = False
    reason = "peer 'carrier1' waits: /carrier1/battery has fallen silent"
    fleet.wait(lambda: running(heard).waits_for == reason, reason)
    assert running(heard).phase == EvaluationStatus.WAITING
    fleet.carrier.has_battery, fleet.carrier.voltage = True, 3.0
    fleet.wait(asked.done, 'the answer')
    fleet.carrier.voltage = 12.0
    answer = asked.result()
    decided_at = format_time(time_to_nanoseconds(answer.decided_at))
    assert answer.verdict == FormulaResult.FALSE, answer
    assert answer.explanation.startswith(f'Voltage[carrier1] = 3.0 at {decided_at} is not > 5')


def test_of_a_feature_that_is_compared_only_the_comparison_is_known(fleet: Fleet) -> None:
    wait_for_streams(2, fleet.base, fleet.carrier)
    values: list[Value] = []
    with listening(fleet.base, '/dyknow/federation/carrier1/Voltage_carrier1', values):
        asked = fleet.base.ask('always[0 s, 1 s] Voltage[carrier1] > 10', here=True)
        fleet.wait(asked.done, 'the answer')
    assert asked.result().verdict == FormulaResult.TRUE, asked.result()
    assert isinstance(values[-1], Alternatives)
    assert values[-1].bounds[0] > 10
    assert 'base asks for Voltage_carrier1 as compared with 10.0 alone' in values[-1].reason


def test_a_change_is_seen_where_its_time_is_not_known(fleet: Fleet) -> None:
    """For a moment, the charge is one of two values; the verdict is that of the later one."""
    wait_for_streams(2, fleet.base, fleet.carrier)
    values: list[Value] = []
    with listening(fleet.base, '/dyknow/federation/carrier1/Charge_carrier1', values):
        asked = fleet.base.ask('always Charge[carrier1] > 0.5', here=True)
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


def test_bridges_lead_from_the_words_of_a_peer_to_own_ones(fleet: Fleet) -> None:
    wait_for_streams(2, fleet.base, fleet.carrier)
    asked = fleet.base.ask('forall v in Vehicle: always[0 s, 1 s] Level[v] > 0.5', here=True)
    fleet.wait(asked.done, 'the answer')
    answer = asked.result()
    assert answer.verdict == FormulaResult.TRUE, answer
    assert "'Level[carrier1] > 0.5' held" in answer.explanation, answer


def test_a_peer_makes_its_streams_anew_that_are_gone(fleet: Fleet) -> None:
    """Its nodes die, but not its federation: nobody else knows what peers read."""
    wait_for_streams(2, fleet.base, fleet.carrier)
    fleet.wait(lambda: not fleet.base.reports[-1].peers[0].asked, 'the release')
    evaluations = '/stream_reasoning_coordinator/evaluations'
    heard = fleet.base.client.collect(EvaluationStatusArray, evaluations, LATCHED)
    values: list[Value] = []
    with listening(fleet.base, '/dyknow/federation/carrier1/Charge_carrier1', values):
        asked = fleet.base.ask('always Charge[carrier1] > 0.5', here=True)
        fleet.wait(lambda: asked.done() or running(heard).states_progressed, 'a state')
        assert not asked.done(), asked.result()
        fleet.carrier.launcher.kill(NODES)
        fleet.carrier.start(NODES)
        reason = 'its host makes it anew, as it was gone there'
        fleet.wait(lambda: reason in ' '.join(running(heard).events), 'the gap')
        values.clear()
        fleet.wait(lambda: len(values) > 1, 'samples again')
        again = fleet.base.ask('always[0 s, 1 s] Charge[carrier1] > 0.5')
        fleet.wait(again.done, 'the answer')
        assert again.result().verdict == FormulaResult.TRUE, again.result()
        fleet.carrier.percentage = 0.25
        fleet.wait(asked.done, 'the other answer')
        fleet.carrier.percentage = 0.9
    assert asked.result().verdict != FormulaResult.TRUE, asked.result()


def test_a_host_of_another_version_is_reported(fleet: Fleet, tmp_path: Path) -> None:
    file = tmp_path / 'zenoh.json5'
    file.write_text(ZENOH)
    settings = RequestedFederation('old', (f'tcp/127.0.0.1:{fleet.link.port}',), zenoh=file)
    with closing(ZenohTransport(settings, time.time_ns, lambda: None)) as old:

        def is_reported() -> bool:
            old.send('', bytes([VERSION - 1]), is_urgent=False)
            refusal = f"peer 'old': a message is refused: it is of version {VERSION - 1}"
            return any(each.startswith(refusal) for each in fleet.base.reports[-1].faults)

        fleet.wait(is_reported, 'the report')


@pytest.mark.parametrize('here', [True, False])
def test_a_violation_at_another_host_ends_a_formula(fleet: Fleet, *, here: bool) -> None:
    """Whether the samples cross, or the verdict."""
    wait_for_streams(2, fleet.base, fleet.carrier)
    asked = fleet.base.ask('always Charge[carrier1] > 0.5', here=here)
    fleet.wait(lambda: is_asked(fleet.base, here=here), 'the request')
    fleet.carrier.battery_age_s = 10
    fleet.wait(asked.done, 'the answer')
    fleet.carrier.battery_age_s = 0
    status = asked.result().exit_status
    assert status.code == ExitStatus.CONSTRAINT_VIOLATION, status
    assert "peer 'carrier1' reports" in status.message, status
    assert 'max_delay' in status.message, status


def test_a_guard_closes_when_the_link_is_older_than_its_timeout(
    fleet: Fleet, tmp_path: Path
) -> None:
    """Long before the peer has left; it opens again when the link is back."""
    wait_for_streams(2, fleet.base, fleet.carrier)
    node, carrier = fleet.base.client.node, fleet.carrier.client.executor
    # The carrier publishes while others than it wait.
    timer = node.create_timer(0.01, lambda: carrier.spin_once(timeout_sec=0.0))
    of_commands = '"/cmd_vel_in".linear.x > 0.1 -> Charge[carrier1] > 0.4'
    formulas = f"['Charge[carrier1] > 0.5', '{of_commands}']"
    with guarded_base(fleet.base, tmp_path, formulas, timeout='2 s') as base:
        base.wait_until_open()
        fleet.link.cut()
        base.assert_safe_after(time.time(), 2.0)
        base.wait_for(GuardStatus.CLOSED, 'the latest state')
        assert fleet.base.link_to('carrier1') is not LinkState.LEFT
        fleet.link.restore()
        base.wait_until_open()
    node.destroy_timer(timer)


def test_a_peer_that_leaves_ends_a_formula(fleet: Fleet) -> None:
    wait_for_streams(2, fleet.base, fleet.carrier)
    asked = fleet.base.ask('always Charge[carrier1] > 0.5')
    fleet.wait(lambda: is_asked(fleet.base, here=False), 'the request')
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
