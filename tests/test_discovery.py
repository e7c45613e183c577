"""A participant of DyKnow discovers the others by their answers to its first announcement."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from domains import reserve_domain

PEERS = 3

STARTS = 16

MAX_LOST = 3
"""Starts that may lose an answer. Nothing makes Fast DDS receive before it announces: the thread
that is about to receive can lose the processor just after it has woken the one that announces. On
two cores with a load of four, 1 of 100 starts lost an answer with the profile of DyKnow, and 64
without.
"""

IN_TIME = 10.0
"""Seconds after which an answer is lost; it takes 0.05 on an idle machine."""

PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'

RARE_ANNOUNCEMENTS = """\
<profiles xmlns="http://www.eprosima.com">
  <participant profile_name="rare_announcements" is_default_profile="true">
    <rtps>
      <builtin>
        <discovery_config>
          <leaseDuration><sec>900</sec></leaseDuration>
          <leaseAnnouncement><sec>600</sec></leaseAnnouncement>
        </discovery_config>
      </builtin>
    </rtps>
  </participant>
</profiles>
"""
"""After a second, processes with this profile announce themselves in answers only."""

PEER_PROGRAM = f"""
import sys
import rclpy
from rclpy.context import Context
from rclpy.node import Node

nodes = []
for number in range({PEERS}):
    context = Context()
    rclpy.init(context=context)
    nodes.append(Node(f'peer{{number}}', context=context))
print('running', flush=True)
sys.stdin.read()
"""

NEW_PROGRAM = f"""
import time
import rclpy
from rclpy.context import Context
from rclpy.node import Node
from dyknow_common.ros import start_ros

start_ros()
lost = []
for _ in range({STARTS}):
    context = Context()
    rclpy.init(context=context)
    node = Node('new', context=context)
    end = time.monotonic() + {IN_TIME}
    while (found := node.count_publishers('/rosout') - 1) < {PEERS} and time.monotonic() < end:
        time.sleep(0.01)
    node.destroy_node()
    context.try_shutdown()
    if found < {PEERS}:
        lost.append({PEERS} - found)
        if len(lost) > {MAX_LOST}:
            break
print(lost)
rclpy.try_shutdown()
"""


def test_answers_to_the_first_announcement_are_received(tmp_path: Path) -> None:
    profile = tmp_path / 'rare_announcements.xml'
    profile.write_text(RARE_ANNOUNCEMENTS, encoding='utf-8')
    environment = {
        **{name: value for name, value in os.environ.items() if name != PROFILE},
        'ROS_DOMAIN_ID': str(reserve_domain()),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    with subprocess.Popen(  # Its end, at the end of its input, frees its shared memory.
        [sys.executable, '-c', PEER_PROGRAM],
        env={**environment, PROFILE: str(profile)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == 'running\n'
        new = [sys.executable, '-c', NEW_PROGRAM]
        # Fast DDS may print an error before.
        *_, answer = subprocess.check_output(new, env=environment, text=True).splitlines()
        lost = json.loads(answer)
    assert len(lost) <= MAX_LOST, (
        f'answers that were lost in {len(lost)} of {STARTS} starts: {lost}'
    )
