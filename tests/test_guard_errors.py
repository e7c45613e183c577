"""Faults that a guard refuses at its start, naming the guard, the fault and its mend."""

from __future__ import annotations

from pathlib import Path

import pytest

from commands import command, output_of
from dyknow_common.executables import ERROR
from system import private_environment

GUARD = """\
guards:
  - name: base_guard
    input: /cmd_vel_in
    output: /cmd_vel
    type: geometry_msgs/msg/Twist
    formulas: '"/cmd_vel_in".linear.x < 0.5'
"""


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        (('Twist', 'Twits'), "message type 'geometry_msgs/msg/Twits' is not installed"),
        (('linear.x', 'linear.w'), "geometry_msgs/msg/Twist has no field 'linear.w'"),
        (
            ('    type', '    safe: {linear: {z1: 0}}\n    type'),
            "safe: field 'linear': geometry_msgs/msg/Vector3 has no field 'z1'; did you mean 'z'?",
        ),
        (
            ('"/cmd_vel_in".linear.x < 0.5', '"cmd_vel_in".linear.x < 0.5'),
            "names the input as 'cmd_vel_in'; write '/cmd_vel_in'",
        ),
        (('output: /cmd_vel', 'output: cmd_vel_in'), 'the output is the input'),
    ],
)
def test_a_guard_that_cannot_start(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(GUARD.replace(*change))
    done = output_of(command('dyknow', 'guard', str(path)), private_environment())
    assert done.returncode == ERROR
    assert message in done.stderr
    assert f'{path}:2:5: the ' in done.stderr


@pytest.mark.parametrize(
    ('topics', 'message'),
    [
        ('input: /other_in, output: cmd_vel', "the guard 'other' publishes cmd_vel already"),
        ('input: cmd_vel, output: cmd_vel_in', 'messages of /cmd_vel come back to /cmd_vel_in'),
    ],
)
def test_guards_that_name_one_topic_differently(topics: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(f'{GUARD}  - {{name: other, {topics}, formulas: p.x > 0}}\n')
    done = output_of(command('dyknow', 'guard', str(path), 'base_guard'), private_environment())
    assert done.returncode == ERROR
    assert f"{path}:2:5: the guard 'base_guard': {message}" in done.stderr


def test_the_choice_of_a_guard(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    second = GUARD.partition('\n')[2].replace('base_guard', 'other').replace(': /cmd', ': /arm')
    path.write_text(GUARD + second.replace('"/cmd', '"/arm'))
    for name, message in (
        ((), 'name one of the guards (there are: base_guard, other)'),
        (('third',), "there is no guard 'third' (there are: base_guard, other)"),
    ):
        done = output_of(command('dyknow', 'guard', str(path), *name), private_environment())
        assert done.returncode == ERROR
        assert message in done.stderr
