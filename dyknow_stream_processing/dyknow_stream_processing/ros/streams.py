"""The streams command: shows the state of each stream."""

from __future__ import annotations

import argparse
from typing import Any

from dyknow_interfaces.msg import StreamStatusArray
from rich.console import RenderableType

from dyknow_common.executables import describe
from dyknow_common.ros import (
    ReportCommand,
    add_report_options,
    command_main,
    time_to_nanoseconds,
)
from dyknow_stream_processing.errors import unknown_stream
from dyknow_stream_processing.reporting.stream_report import StreamReport, is_hidden
from dyknow_stream_processing.reporting.stream_table import as_json, stream_details, stream_table
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message


def document(message: Any, options: argparse.Namespace) -> dict[str, Any]:
    """Return the reports of the streams, or of the named one, as JSON.

    Raises:
        StreamError: NOT_FOUND, if there is no such stream.
    """
    if options.name:
        return as_json(_find(message, options.name))
    reports = map(as_json, _reports(message, options))
    return {'engines': list(message.engines), 'streams': list(reports)}


def rendered(message: Any, options: argparse.Namespace) -> RenderableType:
    """Return what `document` returns, for the terminal."""
    if options.name:
        return stream_details(_find(message, options.name), time_to_nanoseconds(message.stamp))
    reports = _reports(message, options)
    hidden = len(message.streams) - len(reports)
    return stream_table(reports, list(message.engines), hidden)


def _reports(message: Any, options: argparse.Namespace) -> list[StreamReport]:
    """Return the reports of all streams, or of those that are not hidden, as ROS has it."""
    shown = (each for each in message.streams if options.all or not is_hidden(each.name))
    return [report_from_message(each) for each in shown]


def _find(message: Any, name: str) -> StreamReport:
    reports = {status.name: report_from_message(status) for status in message.streams}
    if name not in reports:
        raise unknown_stream(name, reports)
    return reports[name]


def add_streams_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=ReportCommand('streams', StreamStatusArray, document, rendered))
    describe(
        parser,
        'Show the state of each stream.',
        (
            'dyknow streams',
            'dyknow streams uav1_power',
            'dyknow streams --watch',
            'dyknow streams --all',
        ),
        '0 if the streams were shown, 2 if there is no such stream, or no report',
    )
    parser.add_argument(
        'name', nargs='?', default='', metavar='NAME', help='show the details of this stream'
    )
    parser.add_argument(
        '--all', action='store_true', help="also show DyKnow's own streams, such as states"
    )
    add_report_options(parser, 'stream_manager', 'the stream manager, or the engine,')


def main() -> int:
    """Run the executable streams."""
    return command_main('streams', add_streams_options)
