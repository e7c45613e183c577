"""Ten fake robots that fetch goods from three aisles, one robot in each aisle at a time.

The robots of an aisle take turns of 6 s: they drive in from the left, and back.
"""

from itertools import pairwise

from geometry_msgs.msg import PoseStamped

STEP_S = 0.02
TURN_S = 6.0
ROBOTS = [f'robot{number}' for number in range(1, 11)]
AISLES = (1.5, 4.5, 7.5)
"""The middle of each aisle, in metres."""

ENTRANCE_M = 3.0
BREACH_S = 2.6
WAY = ((0.0, 1.0), (1.0, 3.0), (2.5, 9.0), (3.0, 9.0), (4.5, 3.0), (5.5, 1.0), (6.0, 1.0))
"""When a robot of the turn is how far, in seconds and metres."""


class FakeRobot:
    """The movement and the messages of all robots, in steps of 20 ms.

    Args:
        faults: what they do wrong, names of `FAULTS`.
    """

    FAULTS = {
        'shortcut': 'robot2 drives over a shelf',
        'follow': 'robot5 follows robot2 into its aisle',
        'stuck': 'robot1 stays in its aisle',
        'breach': 'robot3 is beyond the barrier for 0.1 s',
        'close': 'robot9 passes the pillar at less than 0.3 m',
    }
    TOPICS = {f'/{robot}/pose': PoseStamped for robot in ROBOTS}

    def __init__(self, faults=()):
        self._faults = faults
        self._steps = 0

    def step(self):
        """Move for 20 ms, and return the messages of that time with their topics."""
        time = self._steps * STEP_S
        self._steps += 1
        if self._steps % 5 != 1:
            return []
        return [(f'/{robot}/pose', self._pose(index, time)) for index, robot in enumerate(ROBOTS)]

    def _pose(self, index, time):
        robot, aisle = ROBOTS[index], index % 3
        rank, robots = index // 3, len(ROBOTS[aisle::3])
        turn, elapsed = divmod(time, TURN_S)
        if 'follow' in self._faults and robot == 'robot5' and turn == 0:
            elapsed, is_driving = max(elapsed - 1.5, 0.0), True
        else:
            is_driving = turn % robots == rank
        if 'stuck' in self._faults and robot == 'robot1':
            elapsed, is_driving = min(time, 2.5), True
        x = _at(elapsed) if is_driving else 1.0
        home = AISLES[aisle] + (rank - 1.5) * 0.5
        y = home + (AISLES[aisle] - home) * min((x - 1.0) / 2.0, 1.0)
        if 'shortcut' in self._faults and robot == 'robot2' and x > ENTRANCE_M:
            y -= 1.5
        if (
            'breach' in self._faults
            and robot == 'robot3'
            and is_driving
            and abs(elapsed - BREACH_S) < STEP_S
        ):
            x = 12.0
        if 'close' in self._faults and robot == 'robot9' and is_driving:
            y += 0.6
        message = PoseStamped()
        message.header.frame_id = 'map'
        message.pose.position.x, message.pose.position.y = x, y
        return message


def _at(elapsed):
    """Return how far a robot is at a time of its turn."""
    for (begin, first), (end, last) in pairwise(WAY):
        if elapsed <= end:
            return first + (last - first) * (elapsed - begin) / (end - begin)
    return WAY[-1][1]
