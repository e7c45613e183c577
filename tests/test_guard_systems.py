"""Guards of other systems: of nodes in one process, by simulated time, and of a simulated rover."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from dyknow_interfaces.msg import GuardStatus

from commands import command, running
from dyknow_bringup.processes.composition import NODES
from guarded_rover import GuardedDrive, write_guarded_robot
from guards import guarded_base
from system import Client, System, private_environment
from test_sim_time_jumps import Simulation

POWER = "['Power[uav1] < 150']"
TIMEOUT_S = 0.6


@pytest.fixture(scope='module')
def one_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[System]:
    with System(tmp_path_factory.mktemp('system'), composition=True) as running:
        yield running


@pytest.mark.parametrize('end', ['false', 'SIGSTOP', 'SIGKILL'])
def test_the_end_of_the_process_of_all_nodes(one_process: System, tmp_path: Path, end: str) -> None:
    system = one_process
    system.batteries.reset()
    with guarded_base(system, tmp_path, POWER) as base:
        base.wait_until_open()
        event = time.time()
        if end == 'false':
            system.batteries.power['uav1'] = 200.0
            base.assert_safe_after(event, TIMEOUT_S)
        else:
            with system.stopped(NODES) if end == 'SIGSTOP' else system.killed(NODES):
                base.assert_safe_after(event, TIMEOUT_S)
                base.wait_for(GuardStatus.CLOSED)
            system.client.wait_for_coordinator()
            system.client.spin_until(
                lambda: system.streams() >= system.fleet_streams, 'the streams', pause=0.1
            )
        system.batteries.reset()
        base.wait_until_open()


def test_a_clock_that_jumps(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> None:
    with System(tmp_path_factory.mktemp('system'), use_sim_time=True) as system:
        simulation = Simulation(system)
        with guarded_base(system, tmp_path, POWER) as base:
            base.wait_until_open()
            for jump in (60_000_000_000, -60_000_000_000):
                known = len(base.statuses)
                simulation.now += jump
                base.client.spin_until(
                    lambda: any(
                        each.state == GuardStatus.CLOSED
                        for each in base.statuses[known:]  # noqa: B023
                    ),
                    'the guard is closed',
                )
                reasons = {each.reason for each in base.statuses[known:]}
                assert reasons - {''}, reasons
                base.wait_until_open()
            known = len(base.statuses)
            simulation.speed = 0
            base.assert_safe_after(time.time(), TIMEOUT_S)
            base.wait_for(GuardStatus.CLOSED, 'the latest state')
            simulation.speed = 1
            base.wait_until_open()


def test_a_rover_stops_before_an_obstacle(tmp_path: Path) -> None:
    """With `dyknow up`, which starts the guard of the file."""
    environment = private_environment()
    with (
        running(command('dyknow', 'up', str(write_guarded_robot(tmp_path))), environment),
        closing(Client(environment)) as client,
    ):
        drive = GuardedDrive(client, ahead=1.5)
        client.spin_until(
            lambda: drive.has_stopped, 'the rover stops', 120.0, lambda: drive.rover.ahead
        )
        client.wait(2.0)
    assert not drive.driving_after
    assert drive.rover.speed == 0.0
    assert drive.closest > 0.2
