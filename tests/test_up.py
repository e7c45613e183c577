"""The command `dyknow up`: the processes that it starts again, and the end of all of them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from commands import command, output_of, started
from system import LIMIT, private_environment
from terminals import ROVER, Terminal, faulty, up
from test_rover import Rover
from test_stopping import members, wait_for


def node(environment: dict[str, str], executable: str) -> int:
    """Return the process of a node."""
    for pid in members(environment['ROS_DOMAIN_ID']):
        if (
            f'/{executable}'.encode()
            in Path(f'/proc/{pid}/cmdline').read_bytes().split(b'--ros')[0]
        ):
            return pid
    raise AssertionError(f'{executable} does not run')


@pytest.mark.parametrize(
    ('composition', 'killed'),
    [((), 'dyknow_nodes'), (('--processes',), 'stream_processing_engine')],
    ids=['one_process', 'processes'],
)
def test_a_killed_process_is_restarted_and_formulas_are_evaluated(
    composition: tuple[str, ...], killed: str
) -> None:
    environment = private_environment()
    with up(environment, *ROVER, *composition) as terminal:
        terminal.wait_for('DyKnow runs in /: 1 ontology (3 concepts, 2 features, 1 object), ')
        terminal.wait_for('2 annotations, 0 refused, 1 stream, 0 refused; logs are in ')
        os.kill(node(environment, killed), signal.SIGKILL)
        terminal.wait_for(f'{killed} was killed by SIGKILL; it will be started again')
        terminal.wait_for(f'{killed} was started again')
        rover = Rover(environment)
        rover.client.wait_for_coordinator()
        formula = 'forall r in Rover: always[0 s, 1 s] Speed[r] < 1.5'
        line = command('dyknow', 'evaluate', formula, '--timeout', '30 s')
        # The streams may still be on their way to the new engine.
        outcomes = [rover.run(line, environment) for _ in range(2)]
        rover.close()
    assert outcomes[-1][0] == 0, outcomes


def test_without_respawn_the_end_of_a_process_ends_the_system() -> None:
    environment = private_environment()
    with started(command('dyknow', 'up', '--no-respawn'), environment) as process:
        terminal = Terminal(process)
        terminal.wait_for('DyKnow runs in /')
        os.kill(node(environment, 'dyknow_nodes'), signal.SIGKILL)
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
