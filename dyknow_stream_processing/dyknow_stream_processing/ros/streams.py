"""The streams command: what has become of each stream."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

from dyknow_interfaces.msg import StreamStatusArray
from rich.console import RenderableType

from dyknow_common import ExitCode
from dyknow_common.ros import ReportCommand, add_report_options, time_to_nanoseconds
from dyknow_stream_processing.errors import StreamError
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.reporting.stream_table import as_json, stream_details, stream_table
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message


def document(report: Any, name: str) -> dict[str, Any]:
    """A report, or what it says of one stream, as JSON.

    Raises:
        StreamError: NOT_FOUND, when the stream asked for is not there.
    """
    if name:
        return as_json(_find(report, name))
    accounts = [as_json(report_from_message(status)) for status in report.streams]
    return {'engines': list(report.engines), 'streams': accounts}


def rendered(report: Any, name: str) -> RenderableType:
    """A report, or what it says of one stream, for the terminal.

    Raises:
        StreamError: NOT_FOUND, when the stream asked for is not there.
    """
    if name:
        return stream_details(_find(report, name), time_to_nanoseconds(report.stamp))
    return stream_table(map(report_from_message, report.streams), list(report.engines))


def _find(report: Any, name: str) -> StreamReport:
    accounts = {status.name: report_from_message(status) for status in report.streams}
    if name not in accounts:
        known = ', '.join(accounts) or 'none'
        raise StreamError(f"there is no stream '{name}' (there are: {known})", ExitCode.NOT_FOUND)
    return accounts[name]


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options on the command line."""
    parser = argparse.ArgumentParser(
        prog='streams',
        description=f'{__doc__} Exit code 0: shown, 1: no such stream, 2: nobody reports.',
    )
    parser.add_argument(
        'name', nargs='?', default='', metavar='NAME', help='show all about this stream'
    )
    add_report_options(parser, 'stream_manager', 'the stream manager, or the engine,')
    return parser.parse_args(arguments)


def main() -> int:
    """The executable streams."""
    return ReportCommand('streams', StreamStatusArray, document, rendered).run(options)
