"""Start DyKnow, evaluate formulas, check recordings, and show what runs."""
# A package of its own: checking recordings imports nothing of the demonstration and the simulation,
# and works where only it is installed, without ROS and without dyknow_bringup.

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any, NoReturn

from dyknow_command.verbs import VERBS
from dyknow_common import DyKnowError, ExitCode, unknown
from dyknow_common.executables import SOURCE_ENVIRONMENT, run_main
from dyknow_main import without_collections

_EPILOG = """\
Examples:
  dyknow demo
  dyknow up
  dyknow evaluate 'always[0 s, 5 s] "/uav1/battery".voltage > 10'
  dyknow check flight.mcap --formula 'always "/uav1/battery".voltage > 10'

Exit code: 0 for true or done, 1 for a verdict of false, 2 for everything else.
Durations are in seconds unless a unit is given, as in '500 ms'."""


class _Version(argparse.Action):
    """Looks up the installed version, prints it, and ends the command."""

    def __init__(self, **options: Any) -> None:
        super().__init__(nargs=0, **options)

    def __call__(self, _: object, options: argparse.Namespace, *__: object) -> NoReturn:
        from dyknow_command.version import print_version  # noqa: PLC0415

        sys.exit(print_version(options))


def options_parser(verb: str) -> argparse.ArgumentParser:
    """Return the parser of the command line; only the chosen verb has its options."""
    parser = argparse.ArgumentParser(
        prog='dyknow',
        description=__doc__,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('--version', action=_Version, help='print the version, and end')
    commands = parser.add_subparsers(required=True, metavar='VERB')
    for name, each in VERBS.items():
        command = commands.add_parser(name, help=each.description)
        if name == verb:
            with without_collections():
                module = import_module(each.module)
            getattr(module, f'add_{name}_options')(command)
            command.set_defaults(refuse=command.error)
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the executable dyknow.

    Args:
        arguments: the arguments of the command; None: the arguments of the process.
    """
    given = sys.argv[1:] if arguments is None else list(arguments)
    if '_ARGCOMPLETE' in os.environ:
        return run_main('dyknow', _complete)
    return run_main('dyknow', lambda: _run_chosen(given))


def _complete() -> int:
    """Print the completions of an unfinished line for the shell (argcomplete)."""
    words = os.environ.get('COMP_LINE', '').split()
    with suppress(ImportError):
        import_module('argcomplete').autocomplete(options_parser(*words[1:2] or ['']))
    return 0


def _run_chosen(arguments: Sequence[str]) -> int:
    verb = VERBS.get(arguments[0]) if arguments else None
    if verb is not None and not verb.is_installed:
        text = (
            f'{arguments[0]} needs ROS 2 and the workspace of DyKnow, of which only the part '
            'without ROS is installed; build the workspace as its README.md says'
        )
        raise DyKnowError(text, ExitCode.UNAVAILABLE)
    if verb is None or not verb.needs_ros:
        chosen = _chosen(arguments)
        return int(chosen.command(chosen))
    try:
        ros, utilities = map(import_module, ('dyknow_common.ros', 'rclpy.utilities'))
    except ImportError as error:
        text = f'{arguments[0]} needs ROS: {error}; {SOURCE_ENVIRONMENT}'
        raise DyKnowError(text, ExitCode.UNAVAILABLE) from None

    def work() -> int:
        return int(ros.run_chosen(_chosen(utilities.remove_ros_args(arguments)), arguments))

    return int(ros.run_ros_main('dyknow', work))


def _chosen(arguments: Sequence[str]) -> argparse.Namespace:
    parser = options_parser(*arguments[:1] or [''])
    if arguments and not arguments[0].startswith('-') and arguments[0] not in VERBS:
        parser.error(unknown('verb', arguments[0], VERBS))
    chosen, others = parser.parse_known_args(arguments)
    if others:
        # argparse would show the usage of dyknow instead of the verb's.
        chosen.refuse(f'unrecognized arguments: {" ".join(others)}')
    return chosen
