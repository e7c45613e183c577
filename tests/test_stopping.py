"""Processes that are stopped by signals: at any moment, several times, with all their children."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from commands import command, started
from dyknow_common.executables import SIGNALLED
from dyknow_configuration import PACKAGES
from system import LIMIT, POLL, private_environment

MOMENTS = [each * 0.15 for each in range(11)]
"""Seconds after a process can handle signals: during its imports, its construction and its work."""


def wait_for(condition: Callable[[], bool], description: str, pause: float = POLL) -> None:
    """Wait for a condition; by default seldom, as a look at all processes takes long."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end, f'not within {LIMIT} s: {description}'
        time.sleep(pause)


def handles(pid: int, number: signal.Signals) -> bool:
    """Return True if a process has a handler for a signal."""
    status = Path(f'/proc/{pid}/status').read_text(encoding='utf-8')
    caught = int(re.findall(r'SigCgt:\s*(\w+)', status)[0], 16)
    return bool(caught >> (number - 1) & 1)


def members(domain: str) -> set[int]:
    """Return the processes in a ROS domain, except this one."""
    found = set()
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            variables = (folder / 'environ').read_bytes().split(b'\0')
        except OSError:
            continue  # It has ended, or is another user's.
        if f'ROS_DOMAIN_ID={domain}'.encode() in variables:
            found.add(int(folder.name))
    return found - {os.getpid()}


def stopped_at(
    line: list[str], environment: dict[str, str], delay: float, *signals: signal.Signals
) -> tuple[int, str]:
    """Stop a process some time after its start; return its exit code and its output."""
    with started(line, environment, start_new_session=True) as process:
        # Python itself handles SIGINT from its start, by an exception.
        wait_for(lambda: handles(process.pid, signal.SIGTERM), 'its first line', pause=0.005)
        time.sleep(delay)
        for number in signals:
            process.send_signal(number)
            time.sleep(0.03)
        output, _ = process.communicate(timeout=LIMIT)
    return process.returncode, output


@pytest.mark.parametrize(
    ('lines', 'code'),
    [
        ([command('stream_processing_engine'), command('ontology_manager')], 0),
        ([command('dyknow', 'up')], 0),
        ([command('dyknow', 'evaluate', 'always true'), command('streams')], SIGNALLED),
        ([command('dyknow', 'up', '--wait')], SIGNALLED),
    ],
    ids=['nodes', 'up', 'commands', 'wait'],
)
def test_a_process_stops_at_any_moment(lines: list[list[str]], code: int) -> None:
    """All nodes have one way to end, and so have all commands: those here take turns."""
    # Two systems, one for each processor: a second node of a name does not start in one.
    environments = (private_environment(), private_environment())
    kinds = (
        [signal.SIGINT],
        [signal.SIGTERM],
        [signal.SIGINT] * 3,
        [signal.SIGTERM, signal.SIGINT],
    )
    cases = [
        (lines[(number + number // 4) % len(lines)], delay, kinds[number % 4])
        for number, delay in enumerate(MOMENTS)
    ]

    def ends_in(system: int) -> list[tuple[int, str]]:
        return [
            stopped_at(line, environments[system], at, *sent) for line, at, sent in cases[system::2]
        ]

    with ThreadPoolExecutor(2) as pool:
        ends = [end for system in pool.map(ends_in, range(2)) for end in system]
    for case, (returned, output) in zip(cases[::2] + cases[1::2], ends, strict=True):
        # The first signal counts; of two that wait, any may be handled first.
        assert returned in ({code + each for each in case[2]} if code else {0}), (case, output)
        assert 'Traceback' not in output, (case, output)
        assert 'ignored' not in output, (case, output)
    domains = [environment['ROS_DOMAIN_ID'] for environment in environments]
    wait_for(lambda: not any(map(members, domains)), 'the end of all processes')


@pytest.mark.parametrize(
    ('name', 'options', 'number', 'code'),
    [
        ('dyknow', ['up'], signal.SIGHUP, 0),
        ('dyknow', ['up'], signal.SIGKILL, -signal.SIGKILL),
        ('dyknow', ['up', '--processes'], signal.SIGTERM, 0),
        ('dyknow', ['up', '--processes'], signal.SIGKILL, -signal.SIGKILL),
        ('uav_demo', [], signal.SIGHUP, SIGNALLED + signal.SIGHUP),
    ],
)
def test_nodes_end_with_their_launcher(
    name: str, options: list[str], number: signal.Signals, code: int
) -> None:
    """A process handles all signals that it can handle in one way."""
    environment = private_environment()
    domain = environment['ROS_DOMAIN_ID']
    line = command(name, *options)
    process = started(line, environment, stdout=subprocess.DEVNULL, start_new_session=True)
    nodes = len(PACKAGES) if '--processes' in options else 1
    wait_for(lambda: len(members(domain)) > nodes, 'the start of all nodes')
    process.send_signal(number)
    assert process.wait(LIMIT) == code
    wait_for(lambda: not members(domain), 'the end of all nodes')
