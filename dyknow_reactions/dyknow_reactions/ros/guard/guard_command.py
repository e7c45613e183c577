"""The command `dyknow guard`: runs a guard of a robot.yaml."""

from __future__ import annotations

import argparse
from pathlib import Path

from dyknow_common.executables import describe
from dyknow_common.ros import run
from dyknow_configuration import read_robot
from dyknow_reactions.ros.guard.guard import GuardNode, chosen_guard


def guard(options: argparse.Namespace) -> int:
    """Run a guard until SIGINT or SIGTERM."""
    path = str(options.robot.resolve())
    chosen = chosen_guard(read_robot(options.robot).guards, options.name, path)
    arguments = ['--ros-args', '-r', f'__node:={chosen.name}']
    if options.namespace:
        arguments += ['-r', f'__ns:=/{options.namespace.strip("/")}']
    for name, value in {
        'robot': path,
        'guard': chosen.name,
        'use_sim_time': options.use_sim_time,
    }.items():
        arguments += ['-p', f'{name}:={value}']
    return run(GuardNode, arguments=arguments)


def add_guard_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=guard)
    describe(
        parser,
        'Run a guard of a robot.yaml: messages pass from its input to its output while its '
        'formulas hold. "dyknow up robot.yaml" starts all guards of the file.',
        ('dyknow guard robot.yaml', 'dyknow guard robot.yaml base_guard --namespace /robot1'),
        '0 after a stop by a signal, 2 for an error',
    )
    parser.add_argument('robot', type=Path, help='robot.yaml, which describes the guard')
    parser.add_argument(
        'name', nargs='?', default='', help='of the guard; may be left out for the only one'
    )
    parser.add_argument('--namespace', default='', help='of the guard (default: none)')
    parser.add_argument('--use-sim-time', action='store_true', help='take time from /clock')
