"""The launch files, where the launch package is installed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from commands import output_of
from dyknow_bringup.resources import share
from dyknow_configuration import PACKAGES
from system import LIMIT, Client, private_environment
from test_stopping import members, wait_for

pytest.importorskip('launch_ros', reason='ROS 2 is not installed')

LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

path, *given = sys.argv[1:]
source = PythonLaunchDescriptionSource(path)
included = IncludeLaunchDescription(
    source, launch_arguments=[each.split(':=', 1) for each in given]
)
service = LaunchService(argv=given)
service.include_launch_description(LaunchDescription([included]))
sys.exit(service.run())
"""
"""The work of `ros2 launch`."""


def line(*arguments: str, name: str = 'dyknow') -> list[str]:
    path = str(share() / 'launch' / f'{name}.launch.py')
    return [sys.executable, '-c', LAUNCH, path, *arguments]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    return {**private_environment(), 'ROS_LOG_DIR': str(tmp_path / 'log')}


def parameter(client: Client, node: str, name: str) -> Any:
    answer = client.call(GetParameters, f'{node}/get_parameters', names=[name])
    return parameter_value_to_python(answer.values[0])


def assert_stops(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGINT)
    process.communicate(timeout=LIMIT)
    assert process.returncode == 0


@contextmanager
def launched(
    environment: dict[str, str], *arguments: str, name: str = 'dyknow'
) -> Iterator[subprocess.Popen[str]]:
    """Run a launch in a process group of its own, as a terminal does."""
    with subprocess.Popen(
        # What a shell runs in the background ignores interrupts, and so would the nodes.
        ['env', '--default-signal=INT', *line(*arguments, name=name)],
        env={**os.environ, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)


def nodes_of(environment: dict[str, str], executable: str) -> set[int]:
    """Return the processes of an executable in the domain of a launch."""
    return {
        pid
        for pid in members(environment['ROS_DOMAIN_ID'])
        if f'/{executable}\0'.encode() in Path(f'/proc/{pid}/cmdline').read_bytes()
    }


def test_parameters_engines_and_a_namespace(environment: dict[str, str], tmp_path: Path) -> None:
    parameters = tmp_path / 'parameters.yaml'
    parameters.write_text(
        '/**:\n  ros__parameters:\n    hang_limit: 33.0\n'
        '/**/stream_reasoning_coordinator:\n  ros__parameters:\n    silence_limit: 7.0\n'
    )
    robot = tmp_path / 'robot.yaml'
    robot.write_text('nodes:\n  stream_reasoning_coordinator: {silence_limit: 10.0}\n')
    launch = line(
        f'params_file:={parameters}', f'config:={robot}', 'engines:=2', 'namespace:=robot'
    )
    with (
        subprocess.Popen(launch, env={**os.environ, **environment}) as process,
        closing(Client(environment)) as client,
    ):
        for node in ('stream_manager', 'stream_processing_engine', 'stream_processing_engine_2'):
            assert parameter(client, f'/robot/{node}', 'hang_limit') == 33.0
        assert parameter(client, '/robot/stream_reasoning_coordinator', 'silence_limit') == 7.0
        process.send_signal(signal.SIGINT)
        assert process.wait(LIMIT) == 0


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (
            ['reasoner:=guess', 'use_respawn:=true'],
            "dyknow_nodes cannot start:\nontology_manager: unknown reasoner 'guess'; choose ",
        ),
        (
            ['reasoner:=guess', 'composition:=false'],
            "ontology_manager cannot start:\nunknown reasoner 'guess'; choose one of ",
        ),
        (['config:=/nowhere.yaml'], 'cannot read the configuration in /nowhere.yaml: No such file'),
        (['engines:=many'], "engines: 'many' is not a whole number"),
        (['engines:=0'], '0 is no number of stream processing engines; use 1 to 32'),
        (['params_file:=/nowhere.yaml'], 'params_file: there is no file /nowhere.yaml'),
        (['use_respawn:=maybe'], "use_respawn: 'maybe' is neither true nor false"),
    ],
)
def test_what_cannot_start_ends_the_launch(
    arguments: list[str], message: str, environment: dict[str, str]
) -> None:
    done = output_of(line(*arguments), environment)
    assert done.returncode == 1
    assert message in done.stdout + done.stderr
    wait_for(lambda: not members(environment['ROS_DOMAIN_ID']), 'the end of all nodes')


def test_ctrl_c_ends_all_nodes(environment: dict[str, str]) -> None:
    with (
        launched(environment, 'composition:=false', 'log_level:=debug') as process,
        closing(Client(environment)) as client,
    ):
        for node in PACKAGES:
            parameter(client, f'/{node}', 'hang_limit')
        os.killpg(process.pid, signal.SIGINT)
        output, _ = process.communicate(timeout=LIMIT)
        assert process.returncode == 0
        assert '[DEBUG]' in output
        assert 'Traceback' not in output
        assert 'failed to terminate' not in output
        assert output.count('process has finished cleanly') == len(PACKAGES)


@pytest.mark.parametrize('number', [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize('composition', ['true', 'false'])
def test_no_node_outlives_the_launch(
    environment: dict[str, str], composition: str, number: signal.Signals
) -> None:
    with (
        launched(environment, f'composition:={composition}') as process,
        closing(Client(environment)) as client,
    ):
        parameter(client, '/stream_manager', 'hang_limit')
        process.send_signal(number)
        process.communicate(timeout=LIMIT)
        wait_for(lambda: not members(environment['ROS_DOMAIN_ID']), 'the end of all nodes')


@pytest.mark.parametrize(
    ('composition', 'executable'), [('true', 'dyknow_nodes'), ('false', 'ontology_manager')]
)
def test_a_killed_process_is_started_again(
    environment: dict[str, str], composition: str, executable: str
) -> None:
    with launched(environment, f'composition:={composition}', 'use_respawn:=true') as process:
        with closing(Client(environment)) as client:
            parameter(client, '/ontology_manager', 'hang_limit')
        (first,) = nodes_of(environment, executable)
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: bool(nodes_of(environment, executable) - {first}), 'the restart')
        # A client that knew the killed node might still send its request there.
        with closing(Client(environment)) as client:
            parameter(client, '/ontology_manager', 'hang_limit')
        assert_stops(process)


def test_parameters_of_nodes_without_their_namespace(
    environment: dict[str, str], tmp_path: Path
) -> None:
    """Nav2's files name nodes without the namespace that a launch argument gives them."""
    path = tmp_path / 'parameters.yaml'
    path.write_text('stream_manager:\n  ros__parameters:\n    hang_limit: 33.0\n')
    arguments = [f'params_file:={path}', 'namespace:=uav1', 'use_sim_time:=true']
    with (
        launched(environment, *arguments) as process,
        closing(Client(environment)) as client,
    ):
        assert parameter(client, '/uav1/stream_manager', 'hang_limit') == 33.0
        assert parameter(client, '/uav1/ontology_manager', 'hang_limit') != 33.0
        assert parameter(client, '/uav1/ontology_manager', 'use_sim_time') is True
        assert_stops(process)


def test_a_parameter_of_a_launch_file_that_includes_ours(
    environment: dict[str, str], tmp_path: Path
) -> None:
    """As in Nav2's launch files, which set `use_sim_time` once for all nodes."""
    (tmp_path / 'outer.launch.py').write_text(
        'from launch import LaunchDescription\n'
        'from launch.actions import IncludeLaunchDescription\n'
        'from launch_ros.actions import PushRosNamespace, SetParameter\n'
        'def generate_launch_description():\n'
        '    return LaunchDescription([\n'
        "        SetParameter('use_sim_time', True), PushRosNamespace('uav1'),\n"
        f"        IncludeLaunchDescription('{share() / 'launch' / 'dyknow.launch.py'}')])\n"
    )
    with (
        launched(environment, name=str(tmp_path / 'outer')) as process,
        closing(Client(environment)) as client,
    ):
        assert parameter(client, '/uav1/ontology_manager', 'use_sim_time') is True
        assert_stops(process)
