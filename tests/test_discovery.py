"""A process of DyKnow discovers the others by their answers to its first announcement."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from domains import reserve_domain
from system import LIMIT

PEERS = 3

STARTS = 8
"""On a busy machine, one of three starts lost an answer without the profile of DyKnow."""

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
from rclpy.node import Node
from dyknow_common.ros import start_ros

start_ros()
node = Node('new')
end = time.monotonic() + {LIMIT}
while node.count_publishers('/rosout') <= {PEERS} and time.monotonic() < end:
    time.sleep(0.01)
print(node.count_publishers('/rosout') - 1)
node.destroy_node()
rclpy.try_shutdown()
"""


def test_no_answer_to_the_first_announcement_is_lost(tmp_path: Path) -> None:
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
        for _ in range(STARTS):
            new = [sys.executable, '-c', NEW_PROGRAM]
            assert subprocess.check_output(new, env=environment, text=True) == f'{PEERS}\n'
