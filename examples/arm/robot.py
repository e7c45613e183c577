"""A fake arm of three joints, which moves between two postures and holds each of them.

Its commands come every 4 s on /joint_commands. It reaches the next posture within 1 s.
"""

import math

from sensor_msgs.msg import JointState

STEP_S = 0.02
HOLD_S = 4.0
SETTLING_S = 0.15
"""The time constant of its controllers."""

MAX_SPEED = 1.6
"""Of a joint, in rad/s."""

FAULT_PERIOD_S = 10.0
FAULT_BEGIN_S = 5.0

POSTURES = (
    {'shoulder': 0.0, 'elbow': 0.4, 'wrist': 0.0},
    {'shoulder': 0.8, 'elbow': 1.5, 'wrist': -0.6},
)


class FakeRobot:
    """The movement and the messages of the arm, in steps of 20 ms.

    Args:
        faults: what it does wrong, names of `FAULTS`.
    """

    FAULTS = {
        'joint_limit': 'its elbow moves beyond 2 rad',
        'slow_wrist': 'its wrist needs more than 2 s to settle',
        'overload': 'its shoulder needs 50 N m, for 1 s in every 10 s',
        'lost_torque': 'the torque of its elbow is unknown (NaN), for 2 s in every 10 s',
        'lost_joint': 'its wrist is not reported, for 2 s in every 10 s',
    }
    TOPICS = {'/joint_states': JointState, '/joint_commands': JointState}

    def __init__(self, faults=()):
        self._faults = faults
        self._steps = 0
        self._angles = dict(POSTURES[0])
        self._speeds = dict.fromkeys(self._angles, 0.0)

    def step(self):
        """Move for 20 ms, and return the messages of that time with their topics."""
        targets = self._targets()
        for joint in self._angles:
            self._move(joint, targets[joint])
        due = [('/joint_states', self._states())]
        if self._steps % 5 == 0:
            due.append(('/joint_commands', _joint_state(targets)))
        self._steps += 1
        return due

    def _targets(self):
        targets = dict(POSTURES[int(self._time / HOLD_S) % 2])
        if 'joint_limit' in self._faults and targets['elbow'] > 1.0:
            targets['elbow'] = 2.2
        return targets

    @property
    def _time(self):
        return self._steps * STEP_S

    def _happens(self, fault, duration=1.0):
        return fault in self._faults and 0 <= self._time % FAULT_PERIOD_S - FAULT_BEGIN_S < duration

    def _move(self, joint, target):
        slowness = 8 if joint == 'wrist' and 'slow_wrist' in self._faults else 1
        speed = (target - self._angles[joint]) / (SETTLING_S * slowness)
        self._speeds[joint] = min(max(speed, -MAX_SPEED), MAX_SPEED)
        self._angles[joint] += self._speeds[joint] * STEP_S

    def _states(self):
        efforts = {'shoulder': 20.0, 'elbow': 12.0, 'wrist': 3.0}
        if self._happens('overload'):
            efforts['shoulder'] = 50.0
        if self._happens('lost_torque', 2.0):
            efforts['elbow'] = math.nan
        reported = list(self._angles)
        if self._happens('lost_joint', 2.0):
            reported.remove('wrist')
        # The order of the joints differs from message to message, as several drivers report them.
        turn = self._steps % len(reported)
        reported = reported[turn:] + reported[:turn]
        return _joint_state({name: self._angles[name] for name in reported}, self._speeds, efforts)


def _joint_state(angles, speeds=None, efforts=None):
    return JointState(
        name=list(angles),
        position=list(angles.values()),
        velocity=[speeds[name] for name in angles] if speeds else [],
        effort=[efforts[name] for name in angles] if efforts else [],
    )
