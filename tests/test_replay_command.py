"""The replay of a recording."""

from __future__ import annotations

from pathlib import Path

from dyknow_interfaces.msg import ExitStatus, FormulaResult
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import BatteryState

from commands import command, output_of, running
from dyknow_bringup.resources import share
from system import Client, System, private_environment

RECORDING = share() / 'recordings' / 'power_surge'


def test_a_recording_is_replayed_with_its_clock() -> None:
    environment = private_environment()
    client = Client(environment)
    batteries: list[BatteryState] = []
    clocks: list[int] = []
    client.node.create_subscription(BatteryState, '/uav1/battery', batteries.append, 100)
    client.node.create_subscription(Clock, '/clock', lambda m: clocks.append(m.clock.sec), 100)
    # On a busy machine discovery takes seconds.
    play = ('--clock', '--rate', '10', '--delay', '5')
    with running(command('replay', str(RECORDING), *play), environment) as process:
        client.spin_until(lambda: process.poll() is not None, 'the end of the recording')
        assert process.returncode == 0
    client.close()
    # The recording lasts 20 s, at five messages a second.
    assert len(batteries) == 100
    assert clocks == sorted(clocks)
    assert clocks[-1] - clocks[0] >= 19


def test_a_recording_that_is_not_there() -> None:
    done = output_of(command('replay', '/nowhere/at_all'), private_environment())
    assert done.returncode == 2
    assert '/nowhere/at_all: no such recording' in done.stderr
    assert 'Traceback' not in done.stderr


def test_a_recorded_flight_is_monitored_under_simulated_time(tmp_path: Path) -> None:
    with System(tmp_path, vehicles=3, use_sim_time=True) as system:
        surge = system.ask(
            'forall u in UAV: always (Power[u] > 150 -> '
            'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)',
            timeout=60.0,
        )
        system.wait_until_running(surge)
        line = command('replay', str(RECORDING), '--clock', '--rate', '2')
        with running(line, system.environment) as process:
            system.client.spin_until(lambda: process.poll() is not None, 'the end', 60.0)
        system.client.spin_until(surge.done, 'the verdict')
        answer = surge.result()
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    assert answer.verdict == FormulaResult.FALSE
    assert 'Power[uav2]' in answer.explanation
    # The simulation that was recorded began at 1 700 000 000 s.
    assert 1_700_000_013 <= answer.decided_at.sec <= 1_700_000_015
