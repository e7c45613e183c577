"""The command `dyknow up`: what it loads, shows, refuses and starts again."""

from __future__ import annotations

import json
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray
from rcl_interfaces.srv import GetParameters
from std_msgs.msg import Float64, String

from commands import command, output_of
from dyknow_bringup.processes.processes import MONITOR
from dyknow_common.ros import LATCHED
from node_processes import process_of
from system import LIMIT, Client, private_environment
from terminals import ROVER, Terminal, faulty, up
from test_rover import EXAMPLES, Rover


@pytest.mark.parametrize(
    ('composition', 'killed'),
    [((), 'dyknow_nodes'), (('--processes',), 'stream_processing_engine')],
    ids=['one_process', 'processes'],
)
def test_a_killed_process_is_restarted_and_formulas_are_evaluated(
    composition: tuple[str, ...], killed: str
) -> None:
    environment = private_environment()
    with up(environment, *ROVER, *composition) as terminal:
        terminal.wait_for('DyKnow runs in /: 1 ontology (3 concepts, 2 features, 1 object), ')
        terminal.wait_for('2 annotations, 0 refused, 1 stream, 0 refused; logs are in ')
        os.kill(terminal.child(killed), signal.SIGKILL)
        terminal.wait_for(f'{killed} was killed by SIGKILL; it will be started again')
        terminal.wait_for(f'{killed} was started again')
        rover = Rover(environment)
        rover.client.wait_for_coordinator()
        formula = 'forall r in Rover: always[0 s, 1 s] Speed[r] < 1.5'
        line = command('dyknow', 'evaluate', formula, '--timeout', '30 s')
        # The streams may still be on their way to the new engine.
        outcomes = [rover.run(line, environment) for _ in range(2)]
        rover.close()
    assert outcomes[-1][0] == 0, outcomes


def test_faults_of_the_configuration_are_shown(tmp_path: Path) -> None:
    annotations = """
        stream "/rover1/x" contains Sped[rover1] = speed;
        stream "/rover1/y" contains Speed[rover7] = speed;
        stream "/rover1/z" contains Speed[rover1] = speed [apples];
        """
    streams = """;
        compunit nothing: float invented((x: float));
        stream broken = invented(select speed as x from rover1_speed);
        sink broken;
        stream narrow = select breadth as x from rover1_speed;
        sink narrow
        """
    options = [*faulty(tmp_path, 'ssl', annotations), *faulty(tmp_path, 'streams', streams)]
    environment = private_environment()
    with up(environment, '--namespace', 'robot1', *ROVER[:2], *options) as terminal:
        terminal.wait_for('DyKnow runs in /robot1: ')
        terminal.wait_for("ERROR stream_manager: stream 'broken' is not made: ")
        terminal.wait_for("there is no computational unit 'invented'")
        terminal.wait_for("stream 'rover1_speed' has no field 'breadth'")
        for text in ("'Sped'", "'rover7'", 'apples'):
            terminal.wait_for(text)
        assert 'ERROR stream_semantics_manager: ' in terminal.text
        assert '2 annotations, 3 refused, 1 stream, 2 refused' in terminal.text
        assert '\x1b[' not in terminal.text, 'colour only on a terminal'
        assert terminal.text.count("no object: unknown instance 'rover7'") == 1, terminal.text


def test_no_temporary_folder_is_left(tmp_path: Path) -> None:
    environment = {**private_environment(), 'TMPDIR': str(tmp_path)}
    with up(environment, str(EXAMPLES / 'rover.yaml')) as terminal:
        terminal.wait_for(f'logs are in {tmp_path}/dyknow_')
        assert list(tmp_path.iterdir())
        terminal.send_signal(signal.SIGINT)
        terminal.join()
    assert list(tmp_path.iterdir()) == []


def test_the_logs_of_an_error_are_left(tmp_path: Path) -> None:
    environment = {**private_environment(), 'TMPDIR': str(tmp_path)}
    done = output_of(command('dyknow', 'up', '--reasoner', 'guess'), environment)
    assert done.returncode == 2
    (logs,) = tmp_path.iterdir()
    assert "dyknow_nodes cannot start:\nontology_manager: unknown reasoner 'guess'" in done.stderr
    assert done.stderr.endswith(f'logs are in {logs}\n')
    assert 'started again' not in done.stderr
    assert 'Traceback' not in done.stderr
    assert 'unknown reasoner' in (logs / 'dyknow_nodes.log').read_text(encoding='utf-8')


def test_formulas_are_monitored_from_the_start_on(tmp_path: Path) -> None:
    """Another monitor of the same formulas shows what this one finds."""
    robot = tmp_path / 'robot.yaml'
    formula = '\'always "/level".data < 5\''
    robot.write_text(f'formulas: [{{name: calm, severity: error, formula: {formula}}}]')
    environment = private_environment()
    levels = [3.0]
    reports: list[Any] = []
    with (
        up(environment, str(robot)) as terminal,
        closing(Client(environment)) as client,
        ThreadPoolExecutor() as threads,
    ):
        node = client.node
        topic = 'stream_reasoning_coordinator/evaluations'
        node.create_subscription(EvaluationStatusArray, topic, reports.append, LATCHED)
        publisher = node.create_publisher(Float64, '/level', 10)
        node.create_timer(0.1, lambda: publisher.publish(Float64(data=levels[-1])))
        # Perhaps before it has asked for its formulas.
        client.spin_until(lambda: MONITOR in node.get_node_names(), MONITOR)
        line = command('dyknow', 'monitor', str(robot), '--json')
        other = threads.submit(output_of, line, environment)
        client.spin_until(
            lambda: any(each.startswith('dyknow_monitor_') for each in node.get_node_names()),
            'the other monitor',
        )
        client.spin_until(lambda: bool(reports and reports[-1].evaluations), 'an evaluation')
        levels.append(7.0)
        alarm = 'ERROR formula_monitor: calm: false at '
        client.spin_until(
            lambda: alarm in terminal.text, 'the alarm', instead=lambda: terminal.text
        )
        done = client.result(other, 'the end of the other monitor')
        assert 'as the system evaluates them already, for formula_monitor' in done.stderr
        outcomes = [json.loads(each)['outcome'] for each in done.stdout.splitlines()]
        assert (done.returncode, outcomes[-1]) == (1, 'false')
        # One that a busy machine has ended is begun anew.
        open_at_once = [
            sum(each.phase != EvaluationStatus.ENDED for each in report.evaluations)
            for report in reports
        ]
        assert max(open_at_once) == 1


def test_another_monitor_tells_that_nothing_is_evaluated_any_more(tmp_path: Path) -> None:
    """It shows no outcome of a system that has ended, and follows the next one."""
    robot = tmp_path / 'robot.yaml'
    robot.write_text('formulas: [{name: calm, formula: \'always "/level".data < 5\'}]')
    environment = private_environment()
    level = 3.0
    with closing(Client(environment)) as client, ExitStack() as monitor:
        publisher = client.node.create_publisher(Float64, '/level', 10)
        client.node.create_timer(0.1, lambda: publisher.publish(Float64(data=level)))

        def wait_for(terminal: Terminal, text: str, count: int = 1) -> None:
            client.spin_until(
                lambda: terminal.text.count(text) >= count, text, instead=lambda: terminal.text
            )

        with up(environment, str(robot)) as system:
            wait_for(system, 'DyKnow runs in')
            line = command('dyknow', 'monitor', str(robot), '--json')
            process = monitor.enter_context(process_of(*line, environment=environment))
            shown = Terminal(process)
            wait_for(shown, '"undecided"')
        wait_for(shown, 'does not answer any more')
        with up(environment, str(robot)):
            wait_for(shown, '"undecided"', 2)
            level = 7.0
            wait_for(shown, '"false"')
            assert process.wait(LIMIT) == 1


def test_a_topic_has_the_right_type_later(tmp_path: Path) -> None:
    robot = tmp_path / 'robot.yaml'
    calm, lost = '\'always "/level".data < 5\'', 'always Sped < 5'
    robot.write_text(f'formulas: [{{name: calm, formula: {calm}}}, {{name: l, formula: {lost}}}]')
    environment = private_environment()

    def publish_until(message: String | Float64, outcome: str) -> None:
        with closing(Client(environment)) as client:
            publisher = client.node.create_publisher(type(message), '/level', 10)
            client.node.create_timer(0.1, lambda: publisher.publish(message))
            client.spin_until(lambda: f'calm: {outcome}' in terminal.text, outcome)

    with up(environment, str(robot)) as terminal:
        publish_until(String(), 'INVALID_ARGUMENT')
        publish_until(Float64(data=7.0), 'false')
        terminal.wait_for('l: NOT_FOUND')
        assert 'does the system run with the file' not in terminal.text


def test_parameters_and_engines(tmp_path: Path) -> None:
    """A parameter file takes precedence over the robot's parameters."""
    parameters, robot = tmp_path / 'parameters.yaml', tmp_path / 'robot.yaml'
    parameters.write_text('/**:\n  ros__parameters: {hang_limit: 33.0, silence_limit: 7.0}\n')
    robot.write_text(
        'objects: {Robot: [r1]}\nnodes:\n  stream_reasoning_coordinator: {silence_limit: 10.0}\n'
    )
    environment = private_environment()
    options = [str(robot), '--params-file', str(parameters), '--engines', '2']
    with up(environment, *options) as terminal, closing(Client(environment)) as client:
        terminal.wait_for('DyKnow runs in /: 1 ontology')

        def value(node: str, name: str) -> float:
            answer = client.call(GetParameters, f'{node}/get_parameters', names=[name])
            return float(answer.values[0].double_value)

        for node in ('stream_manager', 'stream_processing_engine', 'stream_processing_engine_2'):
            assert value(node, 'hang_limit') == 33.0
        assert value('stream_reasoning_coordinator', 'silence_limit') == 7.0
        second = output_of(command('dyknow', 'up'), environment)
        assert second.returncode == 2, second.stdout
        assert 'is already running (started at ' in second.stderr
        # Its own nodes may run for a moment; it must not take the running ones for them.
        assert '1 ontology' not in second.stdout
