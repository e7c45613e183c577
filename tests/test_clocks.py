"""A sender on another computer, whose clock is behind."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from dyknow_interfaces.msg import ExitStatus, StreamStatusArray
from rich.console import Console

from batteries import Batteries
from dyknow_common import SECOND_NS
from dyknow_common.ros import LATCHED
from dyknow_stream_processing.reporting.stream_report import StreamReport
from dyknow_stream_processing.reporting.stream_table import stream_details
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message
from evaluations import Spares
from system import System

SHIM = Path(__file__).with_name('shifted_clock.c')


@pytest.fixture
def late_batteries(system: System, tmp_path: Path) -> Iterator[Batteries]:
    """The battery of `late1`, published by a process whose clock is 2 s behind."""
    library = tmp_path / 'shifted_clock.so'
    subprocess.run(['cc', '-shared', '-fPIC', '-o', str(library), str(SHIM), '-ldl'], check=True)
    shifted = {**system.environment, 'LD_PRELOAD': str(library), 'CLOCK_SHIFT_S': '-2'}
    publishers = Batteries(system.client, shifted, ['late1'])
    yield publishers
    publishers.close()


def test_a_clock_that_is_behind(system: System, spares: Spares, late_batteries: Batteries) -> None:
    """The stream allows the delay, so only the times of sending tell it from a slow pipeline."""
    spares.make('late', 'select voltage from "/late1/battery" with max_delay = 5 s')
    answer = system.evaluate('always late.voltage > 9', timeout=40.0)
    assert late_batteries.stamp
    assert answer.exit_status.code == ExitStatus.CONSTRAINT_VIOLATION, answer
    assert 'the clock of its sender is 2' in answer.exit_status.message
    assert 's behind the one here' in answer.exit_status.message
    report = late_report(system)
    assert 1.9 < report.sources[0].transport / SECOND_NS < 3
    assert ', clock of the sender 2' in shown(report)


def late_report(system: System) -> StreamReport:
    """The first report of the stream in which the clock is known to be wrong."""
    heard: list[StreamReport] = []

    def hear(message: StreamStatusArray) -> None:
        found = [report_from_message(each) for each in message.streams if each.name == 'late']
        heard.extend(each for each in found if each.sources[0].transport)

    node = system.client.node
    listener = node.create_subscription(StreamStatusArray, 'stream_manager/streams', hear, LATCHED)
    system.client.spin_until(lambda: bool(heard), 'a report')
    node.destroy_subscription(listener)
    return heard[-1]


def shown(report: StreamReport) -> str:
    console = Console(width=300)
    with console.capture() as capture:
        console.print(stream_details(report, 0))
    return capture.get()
