"""All nodes in one process: what differs from a process for each of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from dyknow_interfaces.msg import ExitStatus, FormulaResult, Sample

from dyknow_bringup.processes.composition import NODES, composed, name_in
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process, SystemConfiguration, dyknow_processes
from dyknow_common.executables import CANNOT_START, FAULT
from dyknow_common.ros import STREAM
from dyknow_configuration import PACKAGES
from node_processes import end_of, process_of
from system import ALWAYS, SOON, Batteries, System, private_environment


@pytest.fixture(scope='module')
def system(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with System(tmp_path_factory.mktemp('one'), composition=True, short_lease=True) as running:
        yield running


def test_each_node_is_on_the_graph_with_its_own_parameters(system: System) -> None:
    assert set(system.running) == {NODES}
    names = set(system.client.node.get_node_names())
    assert set(PACKAGES) <= names
    assert system.streams() == system.fleet_streams


def test_a_state_stream_that_others_also_receive_has_the_same_verdict(
    system: System, batteries: Batteries
) -> None:
    """Each state is progressed once, and the other subscriber has all from its first one on."""
    future = system.ask(ALWAYS, timeout=60.0)
    system.wait_until_running(future)
    (states,) = system.streams() - system.fleet_streams
    received: list[Sample] = []
    listener = system.client.node.create_subscription(
        Sample, f'dyknow/streams/{states}', received.append, STREAM
    )
    system.client.spin_until(lambda: len(received) >= 5, 'states')
    batteries.power['uav2'] = 240.0
    system.client.spin_until(future.done, 'the verdict')
    system.client.node.destroy_subscription(listener)
    assert future.result().verdict == FormulaResult.FALSE, future.result()
    numbers = [each.number for each in received]
    assert numbers == list(range(1, 1 + len(numbers)))


def test_states_of_an_engine_in_another_process(
    system: System, batteries: Batteries, tmp_path: Path
) -> None:
    """The streams of the fleet stay; the least used engine, the other one, makes the states."""
    with Launcher(tmp_path, namespace='far', environment=system.environment) as launcher:
        launcher.start(Process('dyknow_stream_processing', 'stream_processing_engine'))
        far = '/far/stream_processing_engine'
        system.client.spin_until(lambda: far in system.engines(), 'the other engine')
        assert system.evaluate(SOON).verdict == FormulaResult.TRUE
        future = system.ask(ALWAYS, timeout=60.0)
        system.wait_until_running(future)
        launcher.kill('stream_processing_engine')
        # The states are made in this process from then on: with a gap, or an error within seconds.
        batteries.power['uav2'] = 240.0
        answer = system.client.result(future, 'the answer')
        decided = answer.verdict == FormulaResult.FALSE
        assert decided or answer.exit_status.code == ExitStatus.UNAVAILABLE, answer
    batteries.reset()
    system.client.spin_until(lambda: far not in system.engines(), 'the end of the other engine')


def test_a_process_that_is_killed_and_started_again(system: System, batteries: Batteries) -> None:
    future = system.ask(ALWAYS, timeout=60.0)
    system.wait_until_running(future)
    with system.killed(NODES):
        time.sleep(0.1)
        assert not future.done()
    system.client.wait_for_coordinator()
    system.wait_for_streams()
    batteries.reset()
    assert system.evaluate(SOON).verdict == FormulaResult.TRUE


PROGRAM = """
from dyknow_common.ros import DyKnowNode, run

class GoodNode(DyKnowNode):
    def __init__(self):
        super().__init__('good_node')

class BadNode(DyKnowNode):
    def __init__(self):
        {at_start}
        super().__init__('bad_node')
        self.create_timer(0.1, self.work)

    def work(self):
        {work}

raise SystemExit(run(GoodNode, BadNode))
"""
ERRORS = 'from dyknow_common import DyKnowError; raise DyKnowError("no file x")'
SLOW_END = (
    f'import threading, time; threading.Thread(target=time.sleep, args=(60,)).start(); {ERRORS}'
)
END = 'from dyknow_common.ros.guards import NodeEndError; raise NodeEndError("the end")'

SAVE = 'import threading; self.made_in = threading.get_ident()'
SAY_THREADS = (
    'import threading; from dyknow_common.ros.guards import NodeEndError; '
    'raise NodeEndError('
    "f'in the thread that has made it: {self.made_in == threading.get_ident()}')"
)


@pytest.mark.parametrize(
    ('at_start', 'work', 'code', 'said'),
    [
        (ERRORS, 'pass', CANNOT_START, 'bad_node: no file x\n'),
        (SLOW_END, 'pass', CANNOT_START, 'bad_node: no file x\n'),
        ('pass', END, CANNOT_START, 'bad_node: the end\n'),
        (SAVE, SAY_THREADS, CANNOT_START, 'bad_node: in the thread that has made it: True\n'),
        ('pass', 'self.executor.create_task(lambda: 1 / 0)', FAULT, 'ZeroDivisionError'),
        ('pass', 'import threading; threading.Event().wait()', FAULT, 'executor of bad_node'),
    ],
    ids=['start', 'slow end', 'end', 'thread', 'fault', 'hang'],
)
def test_a_node_that_ends_ends_the_process(at_start: str, work: str, code: int, said: str) -> None:
    program = PROGRAM.format(at_start=at_start, work=work)
    line = ('python', '-c', program, '--ros-args', '-p', 'hang_limit:=2.0')
    with process_of(*line, environment=private_environment()) as process:
        found, errors = end_of(process, 40.0)
    assert (found, said in errors) == (code, True), errors


def test_nodes_keep_their_processes_where_keys_belong_to_processes() -> None:
    nodes = dyknow_processes(SystemConfiguration())
    assert composed(nodes, {'ROS_SECURITY_ENABLE': 'true'}) == nodes
    simulation = Process('dyknow_bringup', 'uav_simulation')
    (one, other) = composed([*nodes, simulation], {})
    assert (one.executable, other) == (NODES, simulation)


def test_the_seven_nodes_of_a_namespace_are_joined_and_no_others() -> None:
    nodes = dyknow_processes(SystemConfiguration())
    robots = [replace(each, namespace=name) for name in ('a', 'b') for each in nodes]
    engine = Process('dyknow_stream_processing', 'stream_processing_engine', {'n': 1})
    far = replace(engine, namespace='far')
    a, b, *others = composed([*robots, engine, far], {})
    assert [(each.executable, each.namespace) for each in (a, b)] == [(NODES, 'a'), (NODES, 'b')]
    assert others == [engine, far]
    one, *more = composed([*nodes, engine], {})
    assert (one.executable, more) == (NODES, [engine])


def test_messages_are_shown_under_the_names_of_their_nodes() -> None:
    (process,) = composed(dyknow_processes(SystemConfiguration()), {})
    assert name_in(process, 'robot1.stream_manager') == 'stream_manager'
    assert name_in(process, 'rcl') == NODES
    assert name_in(Process('a', 'b'), 'stream_manager') == 'b'
