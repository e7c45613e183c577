"""The streams command: shows the state of each stream, and the topics that formulas use."""

from __future__ import annotations

import argparse
from typing import Any

from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray, StreamStatusArray
from rich.console import Group, RenderableType
from rich.text import Text

from dyknow_common.executables import describe
from dyknow_common.ros import (
    ReportCommand,
    add_report_options,
    command_main,
    time_to_nanoseconds,
)
from dyknow_stream_processing.errors import unknown_stream
from dyknow_stream_processing.reporting.stream_report import StreamReport, is_hidden
from dyknow_stream_processing.reporting.stream_table import (
    as_json,
    stream_details,
    stream_table,
    topic_as_json,
    topic_table,
)
from dyknow_stream_processing.reporting.stream_users import StreamUser, used_topics
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message


def document(both: tuple[Any, Any], options: argparse.Namespace) -> dict[str, Any]:
    """Return the reports of the streams and their topics, or of the named stream, as JSON.

    Args:
        both: the reports on streams and on evaluations; without a coordinator, the latter is None.
        options: the options of the command.

    Raises:
        StreamError: NOT_FOUND, if there is no such stream.
    """
    message, users = both[0], _users(both[1])
    if options.name:
        return as_json(_find(message, options.name), users)
    reports = _reports(message)
    return {
        'engines': list(message.engines),
        'streams': [as_json(each, users) for each in _shown(reports, options)],
        'topics': [topic_as_json(each) for each in used_topics(reports, users)],
    }


def rendered(both: tuple[Any, Any], options: argparse.Namespace) -> RenderableType:
    """Return what `document` returns, for the terminal."""
    message, users = both[0], _users(both[1])
    if options.name:
        return stream_details(_find(message, options.name), time_to_nanoseconds(message.stamp))
    reports = _reports(message)
    shown = _shown(reports, options)
    hidden = len(reports) - len(shown)
    streams = stream_table(shown, list(message.engines), hidden, users)
    topics = used_topics(reports, users)
    return Group(streams, Text(), topic_table(topics)) if topics else streams


def _users(message: Any) -> list[StreamUser]:
    """Return the formulas in a report on evaluations that have not ended."""
    return [
        StreamUser(each.name, each.state_stream, tuple(each.topics))
        for each in ([] if message is None else message.evaluations)
        if each.phase != EvaluationStatus.ENDED
    ]


def _reports(message: Any) -> list[StreamReport]:
    return [report_from_message(each) for each in message.streams]


def _shown(reports: list[StreamReport], options: argparse.Namespace) -> list[StreamReport]:
    """Return the reports of the streams to show; hidden ones only with --all."""
    return [each for each in reports if options.all or not is_hidden(each.name)]


def _find(message: Any, name: str) -> StreamReport:
    reports = {each.name: each for each in _reports(message)}
    if name not in reports:
        raise unknown_stream(name, reports)
    return reports[name]


def add_streams_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    beside = 'stream_reasoning_coordinator/evaluations', EvaluationStatusArray
    command = ReportCommand('streams', StreamStatusArray, document, rendered, beside)
    parser.set_defaults(command=command)
    describe(
        parser,
        'Show the state of each stream, and the topics that streams and formulas use.',
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
