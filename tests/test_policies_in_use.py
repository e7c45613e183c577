"""The shipped SROS2 policy permits what the nodes of a running system use, and nothing else."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Self

import rclpy
from dyknow_interfaces.msg import EvaluationStatusArray, FormulaVerdict
from dyknow_interfaces.srv import AddSemanticSpecification
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

from commands import command, running, started
from dashboards import dashboard
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import (
    SystemConfiguration,
    formula_markers,
    formula_monitor,
    uav_simulation,
    watching_processes,
)
from dyknow_bringup.processes.robot import fleet_configuration
from dyknow_bringup.resources import (
    formulas_path,
    plan_path,
    scenario_path,
    share,
)
from dyknow_bringup.security.interfaces import COORDINATOR
from dyknow_bringup.security.systems import SecuredSystem, policy_text
from dyknow_bringup.simulation.missions import load_mission
from dyknow_bringup.simulation.vehicle import vehicle_names
from dyknow_common import BlackBoxOptions, Verdict
from dyknow_common.ros import LATCHED
from dyknow_configuration import read_robot
from dyknow_coordinator import Answer
from dyknow_coordinator.ros import FormulaClient
from page_client import open_page, post
from policies import GraphRecorder, Use, rules
from system import LIMIT, POLL, Client, private_environment, spinning

VEHICLES = 3
FORMULA = 'forall u in UAV: always[0 s, 2 s] Altitude[u] < 1000'

REACTIONS = f"""\
guards:
  - name: base_guard
    input: /cmd_vel_in
    output: /cmd_vel
    type: geometry_msgs/msg/Twist
    formulas: {FORMULA.replace('[0 s, 2 s]', '')!r}
triggers:
  report: {{publish: {{topic: faults, type: std_msgs/msg/String, message: {{data: '{{name}}'}}}}}}
  reset: {{call: {{service: /base_guard/reset, type: std_srvs/srv/Trigger, request: {{}}}}}}
  ask: {{send_goal: {{action: ask, type: dyknow_interfaces/action/MonitorFormula, goal: {{}}}}}}
formulas:
  - name: high
    formula: 'forall u in UAV: always Altitude[u] < 1000'
    on: {{false: [report, reset, ask, {{cancel_goal: navigate}}, {{run: [echo, '{{name}}']}}]}}
"""

NOT_USED_HERE = {'/clock', '/black_box_recorder/save_black_box'}
"""Permitted for simulated time, which the system of the test does without, and for a button of the
live page, whose client is on the graph for a moment only.
"""

SEARCH = Use('/dyknow_monitor', 'subscribe', f'/{COORDINATOR}/evaluations')
"""By which `dyknow monitor` learns, for a moment, if the formulas are monitored already."""

NEVER_USED = {'/dyknow_admin'}
"""The enclave for people, who may do more than they do."""

CLIENT = '/dyknow_client'
"""The enclave of the commands that ask a running system."""

ADDED = {'/my_client', '/base_guard', '/dyknow_monitor', '/dyknow_dashboard'}
"""The enclaves of a policy that is made for a robot."""

RECORDER = '/black_box_recorder'
"""The enclave of the recorder, which may read all topics of the robot, and reads some."""


@contextmanager
def system_of(environment: dict[str, str], folder: Path) -> Iterator[None]:
    """Run the seven nodes that `uav_monitoring.launch.py` starts, by `dyknow up`."""
    configuration = fleet_configuration(vehicle_names(VEHICLES))
    line = command(
        'dyknow', 'up', '--processes',
        '--ontology', *map(str, configuration.ontologies),
        '--annotations', *map(str, configuration.annotations),
        '--streams', *map(str, configuration.streams),
        '--logs', str(folder),
        '--record', str(folder / 'black_boxes'),
    )  # fmt: skip
    # Processes that are not forked: a start of less than a second might not be seen.
    with running([sys.executable, *line], environment):
        yield


@contextmanager
def fleet(environment: dict[str, str], folder: Path) -> Iterator[None]:
    """Run what else `uav_monitoring.launch.py` starts."""
    with Launcher(folder, environment=environment) as launcher:
        launcher.start_all(
            [
                uav_simulation(scenario_path('nominal'), VEHICLES),
                formula_monitor(formulas_path()),
                formula_markers(),
            ]
        )
        yield


@contextmanager
def node_in(enclave: str, domain: int, name: str) -> Iterator[Node]:
    """A node in an enclave, whose callbacks a thread runs."""
    context = Context()
    rclpy.init(context=context, domain_id=domain, args=['--ros-args', '--enclave', enclave])
    node = Node(name, context=context)
    try:
        with spinning(node, SingleThreadedExecutor(context=context)):
            yield node
    finally:
        node.destroy_node()
        context.try_shutdown()


class Commands:
    """The commands that ask a running system, in the enclave for clients."""

    LINES = (
        ('dyknow', 'evaluate', FORMULA),
        ('evaluations', '--watch'),
        ('streams', '--watch'),
        ('semantics',),
    )

    def __init__(self, environment: dict[str, str]) -> None:
        self._environment = environment
        self._running: dict[tuple[str, ...], subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._running.values():
            process.terminate()
            process.wait(30)

    def keep_running(self) -> None:
        """Start those that do not run: their nodes may be on the graph for a moment only."""
        for line in self.LINES:
            process = self._running.get(line)
            if process is None or process.poll() is not None:
                assert process is None or process.returncode == 0, line
                enclave = ('--ros-args', '--enclave', CLIENT)
                self._running[line] = started(
                    command(*line, *enclave), self._environment, stdout=subprocess.DEVNULL
                )


def keep_asking(client: FormulaClient, is_over: threading.Event) -> list[Answer]:
    """Ask again and again: the node that waits is on the graph for a moment only."""
    answers = [client.evaluate_blocking(FORMULA, wait=LIMIT)]
    while not is_over.is_set():
        answers.append(client.evaluate_blocking(FORMULA, wait=LIMIT))
    return answers


@contextmanager
def asking(enclave: str, domain: int) -> Iterator[None]:
    """A node that uses the whole client, and has the answers at the end."""
    plan = load_mission(plan_path('delivery')).plan
    with node_in(enclave, domain, 'my_client') as node, FormulaClient(node) as client:
        assert node.executor is not None
        node.create_subscription(FormulaVerdict, f'{COORDINATOR}/verdicts/geofence', id, 10)
        monitor = client.monitor_plan(plan, wait=LIMIT)
        reported = node.executor.create_task(monitor.started, plan.actions[0].name)
        answered = node.executor.create_task(partial(client.evaluate, FORMULA, wait=LIMIT))
        monitored = client.monitor(FORMULA, wait=LIMIT, record=BlackBoxOptions()).outcome
        is_over = threading.Event()
        with ThreadPoolExecutor() as threads:
            waited = threads.submit(keep_asking, client, is_over)
            try:
                yield
            finally:
                is_over.set()
        end = time.monotonic() + LIMIT
        while not (reported.done() and answered.done() and monitored.done()):
            assert time.monotonic() < end, 'the report of an action, and two verdicts'
            time.sleep(POLL)
        reported.result()
        for answer in (*waited.result(), answered.result(), monitored.result()):
            assert answer.verdict is Verdict.TRUE, answer


@contextmanager
def reactions(environment: dict[str, str], robot: Path, folder: Path) -> Iterator[None]:
    """Run a guard, `dyknow monitor` with triggers, and a live page with its buttons."""
    guards = watching_processes(SystemConfiguration(guards={'base_guard': robot}))
    line = command(
        'dyknow', 'monitor', str(robot), '--retry', '--ros-args', '--enclave', '/dyknow_monitor'
    )
    arguments = ('--ros-args', '--enclave', '/dyknow_dashboard')
    with (
        Launcher(folder, environment=environment) as launcher,
        running(line, environment),
        dashboard(environment, 0, *arguments) as address,
        open_page(address),
    ):
        launcher.start_all(guards)
        asked = {'every_state': False, 'margin': False, 'timeout_s': 3600}
        always = FORMULA.replace('[0 s, 2 s]', '')
        assert post(address, 'ask', formula=always, name='asked', **asked) == HTTPStatus.OK
        for action in ('cancel', 'save'):
            assert post(address, action, name='unknown') == HTTPStatus.NOT_FOUND
        yield


def assert_permitted(recorder: GraphRecorder, permitted: set[Use]) -> None:
    """Everything that the nodes use is permitted."""
    forbidden = sorted(
        use for use in recorder.uses if not any(rule.permits(use) for rule in permitted)
    )
    assert not forbidden, (
        'nodes use what their policy does not permit: complete dyknow_bringup/security/'
        f'interfaces.py and run tools/make_policies.py: {forbidden}'
    )


def test_nodes_use_what_their_policy_permits_and_nothing_is_permitted_that_none_uses(
    tmp_path: Path,
) -> None:
    environment = private_environment()
    domain = int(environment['ROS_DOMAIN_ID'])
    shipped = (share() / 'security' / 'uav_monitoring.policy.xml').read_text(encoding='utf-8')
    path = tmp_path / 'robot.yaml'
    path.write_text(REACTIONS, encoding='utf-8')
    robot = read_robot(path)
    triggers = tuple(each for _, each in robot.formulas[0].on)
    own = SecuredSystem(clients=('my_client',), guards=robot.guards, triggers=triggers).enclaves()
    added = [each for each in own if each.path in ADDED]
    permitted = rules(shipped) | rules(policy_text(added, 'clients and reactions'))
    with ExitStack() as stack:
        client = stack.enter_context(closing(Client(environment)))
        recorder = GraphRecorder(client.node)
        client.node.create_subscription(MarkerArray, 'formula_markers/markers', id, 10)
        reports: list[EvaluationStatusArray] = []
        client.node.create_subscription(
            EvaluationStatusArray, f'{COORDINATOR}/evaluations', reports.append, LATCHED
        )

        unseen = {each for each in permitted if each.name not in NOT_USED_HERE and each != SEARCH}

        def unused(enclaves: Collection[str]) -> list[Use]:
            recorder.look()
            for rule in [*unseen]:
                if any(rule.permits(use) for use in recorder.uses):
                    unseen.remove(rule)
            return sorted(rule for rule in unseen if rule.enclave in enclaves)

        stack.enter_context(system_of(environment, tmp_path))
        # Its node is on the graph until the others are ready.
        client.spin_until(lambda: not unused({'/dyknow_up'}), 'dyknow up was seen', pause=POLL)
        stack.enter_context(fleet(environment, tmp_path))
        client.wait_for_coordinator()
        run_commands = stack.enter_context(Commands(environment)).keep_running
        stack.enter_context(reactions(environment, path, tmp_path))
        # After what takes seconds to start: the node of a blocking call is gone with its verdict.
        stack.enter_context(asking('/my_client', domain))
        # Its type is unknown, so the stream manager is asked for it.
        client.call(
            AddSemanticSpecification,
            'stream_semantics_manager/add_semantic_specification',
            ssl_statement='stream unknown contains Power[uav1] = power',
        )
        everything = {rule.enclave for rule in permitted} - NEVER_USED - {RECORDER}

        def is_everything_used() -> bool:
            missing = unused(everything)
            if any(rule.enclave == CLIENT for rule in missing):
                run_commands()
            # `dyknow monitor` that ends before the first state has an exit code for that.
            is_monitored = bool(reports) and any(
                each.name == 'high' and each.states_progressed > 0
                for each in reports[-1].evaluations
            )
            return not missing and not recorder.without_enclave and is_monitored

        client.spin_until(
            is_everything_used,
            'everything is used that is permitted, by nodes of known enclaves',
            instead=lambda: (
                f'not used: {unused(everything)}, without enclave: {recorder.without_enclave}, '
                f'seen: {dict(recorder.names)}'
            ),
            pause=POLL,
        )
    assert_permitted(recorder, permitted)
    assert set(recorder.names) == everything | {RECORDER}, recorder.names


def test_two_robots_use_what_their_policy_permits(tmp_path: Path) -> None:
    environment = private_environment()
    shipped = (share() / 'security' / 'robots.policy.xml').read_text(encoding='utf-8')
    with ExitStack() as stack:
        client = stack.enter_context(closing(Client(environment)))
        recorder = GraphRecorder(client.node)
        for robot in ('robot1', 'robot2'):
            line = command(
                'dyknow', 'up', '--processes', '--namespace', robot, '--logs', str(tmp_path / robot)
            )
            stack.enter_context(running(line, environment))
        engines = {f'/{robot}/stream_processing_engine' for robot in ('robot1', 'robot2')}

        def missing() -> set[object]:
            recorder.look()
            watches = {
                Use(f'{engine.rpartition("/")[0]}/{node}', 'subscribe', f'{engine}/_heartbeat')
                for engine in engines
                for node in ('stream_manager', 'stream_reasoning_coordinator')
            }
            return {*recorder.without_enclave, *(watches - recorder.uses)}

        client.spin_until(
            lambda: not missing(), 'the engines are watched', instead=missing, pause=POLL
        )
    assert_permitted(recorder, rules(shipped))


def test_administrators_may_request_all_that_the_nodes_serve() -> None:
    permitted = rules((share() / 'security' / 'dyknow.policy.xml').read_text(encoding='utf-8'))
    plain = 'get_type_description'
    served = {
        rule.name
        for rule in permitted
        if rule.permission == 'reply'
        and not rule.name.endswith(plain)
        and '/_' not in rule.name
        and '_*/' not in rule.name  # The parameters of a command, which ends soon.
    }
    requested = {
        rule.name
        for rule in permitted
        if rule.permission == 'request' and rule.enclave == '/dyknow_admin'
    }
    assert requested == served
