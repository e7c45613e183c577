"""The modules that the command writes, and its errors."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from inspect import isclass
from pathlib import Path
from typing import Any

import pytest
from geometry_msgs.msg import Point
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan

from dyknow_stream_processing.ros import message_conversion
from dyknow_stream_processing.ros.messages.conversions import module_text
from dyknow_stream_processing.ros.messages.generate_conversions import main

ROOT = Path(__file__).parents[3]
GOLDEN = Path(__file__).parents[1] / 'golden'


@pytest.fixture
def run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    def run(*arguments: str) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, 'argv', ['generate_conversions', *arguments])
        try:
            code = main()
        except SystemExit as end:  # of argparse
            code = int(end.code or 0)
        return (code, *capsys.readouterr())

    return run


def module(text: str) -> dict[str, Any]:
    names: dict[str, Any] = {}
    exec(text, names)  # noqa: S102
    return names


def of_package(package: str) -> str:
    names = vars(import_module(f'{package}.msg')).values()
    return module_text([each for each in names if isclass(each)], None, 'a test')


@pytest.mark.parametrize(
    ('name', 'arguments'),
    [
        ('laser_scan', ['sensor_msgs/msg/LaserScan']),
        ('marker', ['visualization_msgs/msg/Marker', '--fields', 'ns', 'points[2].x']),
    ],
)
def test_what_is_written(run: Any, name: str, arguments: list[str]) -> None:
    assert run(*arguments) == (0, (GOLDEN / f'{name}.expected').read_text(encoding='utf-8'), '')


def test_the_module_and_the_run_time_agree(run: Any, tmp_path: Path) -> None:
    path = tmp_path / 'conversions.py'
    types = ['nav_msgs/msg/Odometry', 'sensor_msgs/msg/LaserScan', 'geometry_msgs/msg/Point']
    assert run(*types, '--output', str(path)) == (0, '', '')
    functions = module(path.read_text(encoding='utf-8'))
    messages = {
        'odometry': Odometry(child_frame_id='base'),
        'laser_scan': LaserScan(ranges=[1.0, 2.5], angle_min=-1.0),
        'point': Point(x=3.0),
    }
    messages['odometry'].pose.covariance[7] = 0.25
    for name, message in messages.items():
        fields = functions[f'{name}_to_fields'](message)
        assert fields == message_conversion(type(message)).to_fields(message)
        assert functions[f'{name}_from_fields'](fields) == message
    assert run(*reversed(types))[1] == path.read_text(encoding='utf-8')


def test_functions_are_named_as_ros_writes_types_in_snake_case(run: Any) -> None:
    text = run('sensor_msgs/msg/MultiDOFJointState', 'sensor_msgs/msg/PointCloud2')[1]
    assert 'def multi_dof_joint_state_to_fields(' in text
    assert 'def point_cloud2_from_fields(' in text


def test_certain_fields(run: Any) -> None:
    code, text, _ = run(
        'sensor_msgs/msg/LaserScan', '--fields', 'ranges[1]', 'ranges[9]', 'header.frame_id'
    )
    assert code == 0
    message = LaserScan(ranges=[0.0, 2.0])
    message.header.frame_id = 'map'
    fields = module(text)['laser_scan_to_fields'](message)
    assert fields == {'ranges[1]': 2.0, 'header.frame_id': 'map'}


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['std_msgs/Bool'], "message type 'std_msgs/Bool' is not installed"),
        (['std_msgs/msg/Thing'], "message type 'std_msgs/msg/Thing' is not installed"),
        (['std_msgs/msg/Bool', '--fields', 'x'], "has no field 'x' (it has: data)"),
        (['sensor_msgs/msg/Image', '--fields', 'data'], 'not a single value; ask for data[0]'),
        (['std_msgs/msg/Bool', 'std_msgs/msg/Int8', '--fields', 'data'], 'a single message type'),
        (['std_msgs/msg/Byte', 'no_msgs/msg/Byte'], "are called 'Byte'"),
        (['std_msgs/msg/Bool', '--output', '/no/such/folder/a.py'], 'No such file or directory'),
        ([], 'the following arguments are required: TYPE'),
    ],
)
def test_what_is_refused(run: Any, arguments: list[str], message: str) -> None:
    code, out, error = run(*arguments)
    assert (code, out) == (2, '')
    assert message in error


def test_help(run: Any) -> None:
    code, out, _ = run('--help')
    assert code == 0
    for word in ('--fields', '--output', 'odometry_from_fields', 'exit codes', 'points[2].x'):
        assert word in out


@pytest.mark.parametrize('package', ['nav_msgs', 'rcl_interfaces', 'visualization_msgs'])
def test_modules_are_as_the_formatter_has_them(package: str, tmp_path: Path) -> None:
    path = tmp_path / 'conversions.py'
    path.write_text(of_package(package), encoding='utf-8')
    configuration = str(ROOT / 'pyproject.toml')
    formatter = ['ruff', 'format', '--check', '--config', configuration, str(path)]
    assert subprocess.run(formatter, check=False).returncode == 0


def test_a_module_is_typed_in_the_package_of_a_user(run: Any, tmp_path: Path) -> None:
    whole, part = tmp_path / 'whole.py', tmp_path / 'part.py'
    run('visualization_msgs/msg/Marker', 'sensor_msgs/msg/LaserScan', '--output', str(whole))
    run('sensor_msgs/msg/LaserScan', '--fields', 'ranges[0]', '--output', str(part))
    settings = ['--strict', '--follow-imports=silent', '--ignore-missing-imports', '--config-file=']
    checker = [sys.executable, '-m', 'mypy', *settings, str(whole), str(part)]
    paths = {'MYPYPATH': str(ROOT / 'dyknow_stream_processing')}
    checked = subprocess.run(
        checker,
        check=False,
        capture_output=True,
        text=True,
        env=os.environ | paths,
        cwd=tmp_path,
    )
    assert checked.returncode == 0, checked.stdout
