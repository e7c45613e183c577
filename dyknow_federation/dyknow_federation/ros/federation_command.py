"""The federation command: shows peers, links, clocks, and what is shared with whom."""

from __future__ import annotations

import argparse
import json
from typing import Any

from rich.console import RenderableType
from std_msgs.msg import String

from dyknow_common.executables import describe
from dyknow_common.ros import ReportCommand, add_report_options
from dyknow_federation.report import FederationReport, federation_table


def document(message: Any, _options: argparse.Namespace) -> dict[str, Any]:
    """Return the report of the federation node as JSON; durations are in nanoseconds."""
    return dict(json.loads(message.data))


def rendered(message: Any, options: argparse.Namespace) -> RenderableType:
    """Return the same for the terminal."""
    return federation_table(FederationReport.of(document(message, options)))


def add_federation_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=ReportCommand('federation', String, document, rendered))
    describe(
        parser,
        'Show the peers of this host: links, clocks, and what is shared with whom.',
        ('dyknow federation', 'dyknow federation --watch', 'dyknow federation --json'),
        '0 if they were shown, 2 if there is no report',
    )
    add_report_options(parser, 'federation', 'the federation node')
