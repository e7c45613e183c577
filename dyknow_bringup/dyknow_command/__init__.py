"""Start DyKnow for a robot, evaluate a formula with it, or check recordings without it."""
# A package of its own: checking recordings imports nothing of the demonstration and the simulation,
# and works where only it is installed, without ROS and without dyknow_bringup.

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Final

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.executables import SOURCE_ENVIRONMENT, run_main


@dataclass(frozen=True, slots=True)
class Verb:
    """A command of `dyknow`. Its module is imported only if it is chosen: most need ROS.

    Args:
        module: has the function `add_<verb>_options`.
        description: for the help.
        needs_ros: True if it needs rclpy.
    """

    module: str
    description: str
    needs_ros: bool = True

    @property
    def is_installed(self) -> bool:
        """False if only what needs no ROS is installed, and this is something else."""
        return find_spec(self.module.partition('.')[0]) is not None


VERBS: Final = {
    'up': Verb('dyknow_bringup.ros.up', 'start the seven nodes'),
    'evaluate': Verb(
        'dyknow_bringup.ros.evaluate',
        'evaluate a formula; exit code 0: true, 1: false, 2: no verdict',
    ),
    'check': Verb(
        'dyknow_recordings.check',
        'check formulas over recordings, without ROS; exit code 0: well, 1: false, 2: error',
        needs_ros=False,
    ),
    'policy': Verb(
        'dyknow_bringup.ros.policy', 'print the SROS2 policy of a system', needs_ros=False
    ),
}


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """Return the options on the command line."""
    parser = argparse.ArgumentParser(prog='dyknow', description=__doc__)
    commands = parser.add_subparsers(required=True, metavar='COMMAND')
    for name, verb in VERBS.items():
        command = commands.add_parser(name, help=verb.description)
        if name in arguments[:1]:
            getattr(import_module(verb.module), f'add_{name}_options')(command)
    return parser.parse_args(arguments)


def main() -> int:
    """Run the executable dyknow."""
    return run_main('dyknow', _run_chosen)


def _run_chosen() -> int:
    arguments = sys.argv[1:]
    verb = VERBS.get(arguments[0]) if arguments else None
    if verb is not None and not verb.is_installed:
        text = (
            f'{arguments[0]} needs ROS 2 and the workspace of DyKnow, of which only the part '
            'without ROS is installed; build the workspace as its README.md says'
        )
        raise DyKnowError(text, ExitCode.UNAVAILABLE)
    if verb is None or not verb.needs_ros:
        return _run(arguments)
    try:
        ros, utilities = map(import_module, ('dyknow_common.ros', 'rclpy.utilities'))
    except ImportError as error:
        text = f'{arguments[0]} needs ROS: {error}; {SOURCE_ENVIRONMENT}'
        raise DyKnowError(text, ExitCode.UNAVAILABLE) from None
    return int(ros.run_ros_main('dyknow', lambda: _run(utilities.remove_ros_args(sys.argv)[1:])))


def _run(arguments: Sequence[str]) -> int:
    chosen = options(arguments)
    return int(chosen.command(chosen))
