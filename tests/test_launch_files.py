"""The launch files, where the launch package is installed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from rcl_interfaces.srv import GetParameters

from commands import output_of
from dyknow_bringup.resources import share
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
"""What `ros2 launch` does."""


def line(*arguments: str, name: str = 'dyknow') -> list[str]:
    path = str(share() / 'launch' / f'{name}.launch.py')
    return [sys.executable, '-c', LAUNCH, path, *arguments]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    return {**private_environment(), 'ROS_LOG_DIR': str(tmp_path / 'log')}


def parameter(client: Client, node: str, name: str) -> Any:
    answer = client.call(GetParameters, f'{node}/get_parameters', names=[name])
    return answer.values[0].double_value


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
            "ontology_manager cannot start:\nunknown reasoner 'guess'; choose one of ",
        ),
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
