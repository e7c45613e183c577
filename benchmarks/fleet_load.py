"""The processor time of one DyKnow for a fleet: its knee in robots and messages a second.

python benchmarks/fleet_load.py [--json] [--quick] [--robots 1 3 10] [--seconds 15]

Each robot publishes an odometry at 100 Hz and a scan of 360 ranges at 10 Hz. Three formulas read
the speed and the nearest obstacle of each robot. A row has the share of one core that each process
takes, and the delays of alarms: from the message of the last robot that is too fast to the answer
of the formula. The baseline is a bare rclpy node which subscribes to the same topics and reads the
same fields. The first row with an error, or with an alarm after more than half a second, is the
last: the knee.
"""

from __future__ import annotations

import select
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import rclpy
from dyknow_interfaces.srv import EvaluateFormula
from nav_msgs.msg import Odometry
from parts import measure
from processes import Client, costs, percentile, tell, use_private_domain, wait_until_begun, worker
from rclpy.serialization import serialize_message
from running_system import EVALUATE, running_formulas, timed
from sensor_msgs.msg import LaserScan
from workers import FLEET_QUALITY

from commands import command, running
from dyknow_common import SECOND_NS

PROGRAM = Path(__file__)
ODOMETRY_HZ = 100
SCAN_EVERY = 10
"""A scan for each tenth odometry."""

STAMP = slice(4, 12)
"""Where a serialised header has its stamp."""

MAX_DELAY_MS = 500.0
ALARMS = 10
CALM = 1.0
ALARM_PERIOD_S = 0.5
ANSWER_LIMIT_S = 60.0
FORMULAS = (
    'forall r in Robot: always Speed[r] < 1000',
    'forall r in Robot: always Near[r] > 0.3',
    'forall r in Robot: always (Speed[r] > 100 -> eventually[0 s, 2 s] Speed[r] < 100)',
)


def robot_file(robots: int) -> str:
    """Return a robot.yaml of a fleet."""
    names = ', '.join(f'r{number}' for number in range(robots))
    return f"""\
objects:
  Robot: [{names}]
features:
  Speed:
    of: {{r: Robot}}
    from: {{topic: '/{{r}}/odom', field: twist.twist.linear.x, max_delay: 200 ms, max_gap: 500 ms}}
  Near:
    of: {{r: Robot}}
    from: {{topic: '/{{r}}/scan', field: min(ranges), max_delay: 200 ms, max_gap: 500 ms}}
"""


def publish(robots: int) -> None:
    """Publish the topics of a fleet until the process is killed."""
    rclpy.init()
    node = rclpy.create_node('fleet')
    odometry = Odometry()
    odometry.header.frame_id, odometry.child_frame_id = 'odom', 'base_link'
    odometry.twist.twist.linear.x = CALM
    scan = LaserScan(ranges=[5.0] * 360)
    scan.header.frame_id = 'laser'
    messages = [bytearray(serialize_message(each)) for each in (odometry, scan)]
    publishers = [
        [
            node.create_publisher(kind, f'/r{number}/{topic}', FLEET_QUALITY)
            for number in range(robots)
        ]
        for kind, topic in ((Odometry, 'odom'), (LaserScan, 'scan'))
    ]
    print('begun', flush=True)
    start, tick = time.time_ns(), 0
    while True:
        for kind in (0, 1) if tick % SCAN_EVERY == 0 else (0,):
            for each in publishers[kind]:
                each.publish(stamped(messages[kind]))
        tick += 1
        wait = start + tick * SECOND_NS // ODOMETRY_HZ - time.time_ns()
        if select.select([sys.stdin], [], [], max(0, wait) / SECOND_NS)[0]:
            # The speed of the last robot, for one message.
            odometry.twist.twist.linear.x = float(sys.stdin.readline())
            sent = time.time_ns()
            publishers[0][-1].publish(stamped(bytearray(serialize_message(odometry))))
            print(sent, flush=True)


def stamped(message: bytearray) -> bytes:
    """Return a serialised message with the stamp of now."""
    seconds, nanoseconds = divmod(time.time_ns(), SECOND_NS)
    message[STAMP] = seconds.to_bytes(4, 'little') + nanoseconds.to_bytes(4, 'little')
    return bytes(message)


def row(robots: int, seconds: float) -> dict[str, Any]:
    """Measure one size of the fleet."""
    with ExitStack() as stack:
        fleet = stack.enter_context(worker('publish', robots, program=PROGRAM))
        wait_until_begun(fleet)
        client = stack.enter_context(Client())
        with worker('fleet_reader', '--number', robots) as bare:
            wait_until_begun(bare)
            client.wait(2.0)
            baseline = costs({'bare': bare.pid}, client.wait, seconds)['bare']['share']
        path = Path(stack.enter_context(tempfile.TemporaryDirectory()), 'robot.yaml')
        path.write_text(robot_file(robots), encoding='utf-8')
        line = command('dyknow', 'up', str(path), '--no-monitor', '--logs', f'{path.parent}/logs')
        up = stack.enter_context(running(line, {}))
        futures = ask_all(client, robots)
        found = costs({str(each): each for each in children(up.pid)}, client.wait, seconds).values()
        delays = [
            alarm(client, fleet, CALM + 1.0 + number, each)
            for number, each in enumerate(futures[len(FORMULAS) :])
        ]
        answers = [each.result() for each in futures if each.done()]
        return {
            'robots': robots,
            'messages_s': robots * (ODOMETRY_HZ + ODOMETRY_HZ // SCAN_EVERY),
            'bare_share': baseline,
            'shares': sorted((each['share'] for each in found), reverse=True),
            'memory_mb': round(sum(each['memory_mb'] for each in found)),
            'alarm_median_ms': round(percentile(delays, 50), 1),
            'alarm_max_ms': round(max(delays), 1),
            'errors': [each.exit_status.message[:200] for each in answers if each.exit_status.code],
        }


def ask_all(client: Client, robots: int) -> list[Any]:
    """Ask for all formulas and alarms, and return their futures once each has had a state."""
    running = running_formulas(client)
    alarms = [f'always Speed[r{robots - 1}] < {CALM + each + 0.5}' for each in range(ALARMS)]
    futures = [
        client.request(EvaluateFormula, EVALUATE, formula=each) for each in (*FORMULAS, *alarms)
    ]
    client.spin_until(lambda: len(running) >= len(futures), 'states', 120.0)
    return futures


def alarm(client: Client, fleet: subprocess.Popen[str], speed: float, answer: Any) -> float:
    """Return the milliseconds from a message with a speed to the answer of a formula."""
    client.wait(ALARM_PERIOD_S)
    found = timed(answer)
    sent = int(tell(fleet, speed))
    client.spin_until(lambda: bool(found), 'an alarm', ANSWER_LIMIT_S)
    return (found[0] - sent) / 1e6


def children(process: int) -> list[int]:
    """Return a process and all that it has started."""
    found = [process]
    for each in found:
        path = Path(f'/proc/{each}/task/{each}/children')
        found += map(int, path.read_text(encoding='ascii').split())
    return found


def fleet_load(*, robots: list[int], seconds: float, quick: bool) -> list[dict[str, Any]]:
    """Measure fleets of growing size, until one is beyond the knee."""
    rows: list[dict[str, Any]] = []
    for number in robots:
        rows.append(row(number, seconds / 5 if quick else seconds))
        if rows[-1]['alarm_max_ms'] > MAX_DELAY_MS or rows[-1]['errors']:
            break
    return rows


if __name__ == '__main__':
    if sys.argv[1:2] == ['publish']:
        publish(int(sys.argv[2]))
    use_private_domain()
    measure(__doc__, fleet_load, robots=[1, 3, 10, 20, 40], seconds=15.0)
