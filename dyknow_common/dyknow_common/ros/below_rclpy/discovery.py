"""The discovery of processes by Fast DDS 2.

Fast DDS announces a process before it accepts messages. The others answer the first announcement
only, at once, so their answers may be lost. The process then discovers them at their next periodic
announcement, up to 3 s later. `discovery.xml` lets it announce itself in a thread. With the thread
this is rare: on a busy machine one start in a hundred loses an answer, where two of three did.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

from dyknow_common.ros.below_rclpy.versions import is_on

_PROFILE: Final = 'FASTRTPS_DEFAULT_PROFILES_FILE'
"""The variable that Fast DDS 2 reads, and no other middleware."""

_PROFILE_OF_FOLDER: Final = 'DEFAULT_FASTRTPS_PROFILES.xml'


def announce_in_thread() -> None:
    """Let Fast DDS 2 announce this process in a thread, unless the user has other settings.

    The security plugins have not been tested with this setting.
    """
    has_profile = _PROFILE in os.environ or Path(_PROFILE_OF_FOLDER).exists()
    if is_on() and not has_profile and os.environ.get('ROS_SECURITY_ENABLE') != 'true':
        os.environ[_PROFILE] = str(Path(__file__).with_name('discovery.xml'))
