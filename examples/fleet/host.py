"""One host of the fleet: DyKnow in a ROS domain of its own, and the robot that it is about.

    python3 examples/fleet/host.py carrier1

The carriers drive on circles around the base station, which has no robot. Ctrl-C ends the host.
"""

import argparse
import os
import subprocess
import sys
from contextlib import suppress

try:
    import rclpy  # noqa: F401
except ModuleNotFoundError:
    sys.stderr.write('host.py: there is no ROS here; run first: source env.sh\n')
    sys.exit(2)

from dyknow_bringup.resources import executable_path, host_path
from dyknow_common.executables import interruptible

HOSTS = ('basestation', 'carrier1', 'carrier2', 'carrier3')
FIRST_DOMAIN = 60


def commands(name):
    """Return the command lines of a host: DyKnow, and the robot, which the base station lacks."""
    yield ['dyknow', 'up', str(host_path(name))]
    number = HOSTS.index(name)
    if number:
        parameters = ('-p', f'carrier:={name}', '-p', f'radius:={2.0 * number}')
        simulation = executable_path('dyknow_bringup', 'carrier_simulation')
        yield [str(simulation), '--ros-args', *parameters]


def main():
    """Run DyKnow and the robot until a signal, or the end of DyKnow, ends both."""
    parser = argparse.ArgumentParser(description='Run one host of the fleet.')
    parser.add_argument('name', choices=HOSTS)
    name = parser.parse_args().name
    environment = {**os.environ, 'ROS_DOMAIN_ID': str(FIRST_DOMAIN + HOSTS.index(name))}
    processes = [subprocess.Popen(line, env=environment) for line in commands(name)]
    with suppress(KeyboardInterrupt), interruptible():
        processes[0].wait()
    for each in processes:
        each.terminate()
    return max(each.wait() for each in processes)


if __name__ == '__main__':
    sys.exit(main())
