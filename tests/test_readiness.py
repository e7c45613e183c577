"""Readiness of a system, for scripts and for other nodes."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

from std_msgs.msg import Bool

from commands import command, output_of
from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import SystemConfiguration, dyknow_processes
from dyknow_common.ros import LATCHED
from system import Client, private_environment

EXAMPLES = Path(__file__).parent.parent / 'docs' / 'examples'


def test_a_system_is_ready_when_the_last_of_its_nodes_is(tmp_path: Path) -> None:
    environment = private_environment()
    configuration = SystemConfiguration(streams=(EXAMPLES / 'rover.streams',), engines=2)
    *others, last = dyknow_processes(configuration)
    assert last.name == 'stream_processing_engine_2'
    with (
        Launcher(tmp_path, environment=environment, namespace='robot') as launcher,
        closing(Client(environment, launcher.check_running)) as client,
    ):
        heard: list[bool] = []
        client.node.create_subscription(
            Bool,
            '/robot/stream_reasoning_coordinator/ready',
            lambda message: heard.append(message.data),
            LATCHED,
        )
        matching = next(each for each in others if 'matching' in each.name)
        launcher.start_all([each for each in others if each is not matching])
        client.spin_until(lambda: heard == [False], 'it is not ready yet')
        line = command(
            'dyknow', 'up', '--wait', '--timeout', '1 s', '--namespace', 'robot',
            '--engines', '2',
        )  # fmt: skip
        done = output_of(line, environment)
        assert (done.returncode, done.stdout) == (2, '')
        assert 'no status of ' in done.stderr
        assert 'it is not ready within 1 s' in done.stderr
        launcher.start(matching)
        client.spin_until(lambda: heard == [False, True], 'it is ready')
        launcher.start(last)
        line[line.index('1 s')] = '60 s'
        done = output_of(line, environment)
        assert done.returncode == 0, done.stderr
        assert done.stdout.startswith('DyKnow runs in /robot: 0 ontologies')
        assert '1 stream, 0 refused' in done.stdout
        launcher.kill(matching.name)
        client.spin_until(lambda: heard[-1] is False, 'it is not ready any more')


def test_who_waits_starts_nothing() -> None:
    line = command('dyknow', 'up', '--wait', '--streams', str(EXAMPLES / 'rover.streams'))
    done = output_of(line, private_environment())
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith('dyknow: with --wait, nothing is started: run ')
