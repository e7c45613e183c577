"""Two fake robots that hand a part to each other: left to right, right to left, and so on.

They meet every 6 s. The giver holds the part until the taker has held it for 0.4 s.
"""

from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

STEP_S = 0.02
CYCLE_S = 6.0
GRASP_S = 3.0
"""When the taker grasps the part, counted from the begin of a cycle."""

RELEASE_S = 3.4
GRIP_N = 20.0
MEETING_M = 0.05
APART_M = 1.0


class FakeRobot:
    """The movement and the messages of both robots, in steps of 20 ms.

    Args:
        faults: what they do wrong, names of `FAULTS`.
    """

    FAULTS = {
        'drop': 'the giver lets go before the taker has grasped the part',
        'hasty_release': 'the giver lets go as soon as the taker has grasped the part',
        'tug': 'the giver holds the part for 1 s more',
        'squeeze': 'the taker grips with 60 N',
        'far': 'the giver grasps and lets go away from the taker',
    }
    TOPICS = {
        f'/{robot}/{name}': message_type
        for robot in ('left', 'right')
        for name, message_type in (('gripper', JointState), ('tool', PoseStamped))
    }

    def __init__(self, faults=()):
        self._faults = faults
        self._steps = 0

    def step(self):
        """Move for 20 ms, and return the messages of that time with their topics."""
        cycle, elapsed = divmod(self._steps * STEP_S, CYCLE_S)
        giver, taker = ('left', 'right') if cycle % 2 == 0 else ('right', 'left')
        force = 60.0 if 'squeeze' in self._faults else GRIP_N
        forces = {
            giver: GRIP_N if elapsed < self._release() else 0.0,
            taker: force if elapsed >= GRASP_S else 0.0,
        }
        due = []
        if self._steps % 2 == 0:
            due += [(f'/{robot}/gripper', _gripper(forces[robot])) for robot in forces]
        if self._steps % 5 == 0:
            due += [(f'/{robot}/tool', self._tool(robot, elapsed)) for robot in forces]
        self._steps += 1
        return due

    def _release(self):
        if 'drop' in self._faults:
            return GRASP_S - 0.2
        if 'hasty_release' in self._faults:
            return GRASP_S + 0.1
        return RELEASE_S + (1.0 if 'tug' in self._faults else 0.0)

    def _tool(self, robot, elapsed):
        """Return where a tool is: both meet at x = 0 between 2 s and 4.5 s of a cycle."""
        away = max(0.0, 2.0 - elapsed, elapsed - 4.5) * APART_M
        if 'far' in self._faults:
            away += 0.5
        message = PoseStamped()
        message.header.frame_id = 'cell'
        message.pose.position.x = (MEETING_M / 2 + away) * (-1 if robot == 'left' else 1)
        return message


def _gripper(force):
    return JointState(name=['finger'], position=[0.03 if force else 0.08], effort=[force])
