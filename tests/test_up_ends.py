"""The end of all processes of `dyknow up`, which these tests look for by /proc."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from commands import command, output_of, started
from system import LIMIT, private_environment
from terminals import Terminal, faulty
from test_stopping import members, wait_for


def test_without_respawn_the_end_of_a_process_ends_the_system() -> None:
    environment = private_environment()
    with started(command('dyknow', 'up', '--no-respawn'), environment) as process:
        terminal = Terminal(process)
        terminal.wait_for('DyKnow runs in /')
        os.kill(terminal.child('dyknow_nodes'), signal.SIGKILL)
        assert process.wait(LIMIT) == 2
        terminal.wait_for('dyknow: dyknow_nodes was killed by SIGKILL')
        terminal.join()
    assert not members(environment['ROS_DOMAIN_ID'])


@pytest.mark.parametrize(
    ('composition', 'message'),
    [
        ((), 'dyknow_nodes cannot start:\nstream_semantics_manager: /'),
        (('--processes',), 'stream_semantics_manager cannot start:\n/'),
    ],
    ids=['one_process', 'processes'],
)
def test_a_wrong_configuration_ends_the_command(
    tmp_path: Path, composition: tuple[str, ...], message: str
) -> None:
    environment = private_environment()
    options = [*composition, *faulty(tmp_path, 'ssl', 'stream "/rover1/x" contains;')]
    done = output_of(command('dyknow', 'up', *options), environment)
    assert done.returncode == 2, done.stderr
    assert message in done.stderr
    assert 'started again' not in done.stderr
    assert 'Traceback' not in done.stderr
    wait_for(lambda: not members(environment['ROS_DOMAIN_ID']), 'the end of all nodes')
