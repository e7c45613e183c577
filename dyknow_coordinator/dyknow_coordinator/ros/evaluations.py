"""The evaluations command: show the formulas that are evaluated, and end them."""

from __future__ import annotations

import argparse
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import EvaluationStatusArray
from dyknow_interfaces.srv import CancelEvaluation
from rich.console import RenderableType

from dyknow_common import ExitCode
from dyknow_common.executables import describe
from dyknow_common.ros import (
    CommandNode,
    ReportCommand,
    add_report_options,
    command_main,
    run_with_node,
    time_to_nanoseconds,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus
from dyknow_coordinator.reporting.evaluation_table import (
    as_json,
    evaluation_details,
    evaluation_table,
)
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message


def document(report: Any, options: argparse.Namespace) -> dict[str, Any]:
    """Return a report as JSON; if a name is given, only the evaluations of that name.

    Raises:
        CoordinationError: NOT_FOUND, if there is none of that name.
    """
    return {'evaluations': [as_json(status) for status in _statuses(report, options.name)]}


def rendered(report: Any, options: argparse.Namespace) -> RenderableType:
    """Return a report for the terminal; if a name is given, the details of its evaluations.

    Raises:
        CoordinationError: NOT_FOUND, if there is none of that name.
    """
    statuses = _statuses(report, options.name)
    if options.name:
        return evaluation_details(statuses)
    return evaluation_table(statuses, time_to_nanoseconds(report.stamp))


def _statuses(report: Any, name: str) -> list[EvaluationStatus]:
    statuses = [status_from_message(each) for each in report.evaluations]
    found = [status for status in statuses if name in ('', status.name)]
    if name and not found:
        known = ', '.join(dict.fromkeys(status.name for status in statuses)) or 'none'
        raise CoordinationError(
            f"there is no evaluation '{name}' (there are: {known})", ExitCode.NOT_FOUND
        )
    return found


def cancel(options: argparse.Namespace, command: CommandNode) -> None:
    """End the evaluations of a name.

    Raises:
        DyKnowError: NOT_FOUND, if there is none of that name.
    """
    response = command.call(CancelEvaluation, options.node, options.timeout, name=options.cancel)
    number = response.cancelled
    things = 'evaluation' if number == 1 else 'evaluations'
    print(f"cancelled {number} {things} named '{options.cancel}'")  # noqa: T201 - this is a command


_SHOW: Final = ReportCommand(
    'evaluations', EvaluationStatusArray, document, rendered, is_fresh=True
)


def show_or_cancel(options: argparse.Namespace) -> int:
    """Run the command and return its exit code."""
    if options.cancel is None:
        return _SHOW(options)
    return run_with_node('evaluations', partial(cancel, options))


def add_evaluations_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=show_or_cancel)
    describe(
        parser,
        'Show the formulas that are evaluated, and their status, or end some of them.',
        (
            'dyknow evaluations',
            'dyknow evaluations --watch',
            "dyknow evaluations 'no surge' --json",
            "dyknow evaluations --cancel 'no surge'",
        ),
        '0 if the evaluations were shown or ended, 2 if there is no such evaluation, or no report',
    )
    parser.add_argument(
        'name',
        nargs='?',
        default='',
        metavar='NAME',
        help='show all details of the evaluations of this name',
    )
    parser.add_argument(
        '--cancel',
        metavar='NAME',
        help='end the evaluations of this name; their callers are answered CANCELLED',
    )
    add_report_options(parser, 'stream_reasoning_coordinator', 'the coordinator')


def main() -> int:
    """Run the executable evaluations."""
    return command_main('evaluations', add_evaluations_options)
