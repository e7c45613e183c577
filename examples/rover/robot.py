"""A fake rover with the topics of a robot that Nav2 drives.

It drives from the dock at x = 0 m to the shelf at x = 8 m and back, at 1 m/s, through the aisle
between 3 m and 5 m at 0.4 m/s, and stands for 2.5 s at both ends.
"""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import BatteryState, LaserScan

STEP_S = 0.02
SHELF_M = 8.0
AISLE_M = (3.0, 5.0)
STAND_S = 2.5
FAULT_PERIOD_S = 15.0
FAULT_BEGIN_S = 5.0
BRAKING_M = 0.25
"""The distance in which it stops from 1 m/s."""


class FakeRobot:
    """The movement and the messages of the rover, in steps of 20 ms.

    Args:
        faults: what it does wrong, names of `FAULTS`.
    """

    FAULTS = {
        'collision': 'it comes closer than 0.3 m to what is ahead, for 1 s in every 15 s',
        'late_stop': 'its brakes need 3 s to stop it',
        'aisle_speed': 'it drives through the aisle at 1 m/s',
        'lidar_error': 'its lidar reports an error, for 1 s in every 15 s',
        'low_voltage': 'its battery falls below 22 V, for 1 s in every 15 s',
        'lost_odometry': 'its odometry is not published, for 2 s in every 15 s',
    }
    TOPICS = {
        '/scan': LaserScan,
        '/odom': Odometry,
        '/amcl_pose': PoseWithCovarianceStamped,
        '/cmd_vel': TwistStamped,
        '/battery': BatteryState,
        '/diagnostics': DiagnosticArray,
    }

    def __init__(self, faults=()):
        self._faults = faults
        self._steps = 0
        self._x = self._speed = self._command = 0.0
        self._goal = SHELF_M
        self._waits_until = 1.0

    def step(self):
        """Move for 20 ms, and return the messages of that time with their topics."""
        self._drive()
        makers = {
            '/scan': (10, self._scan),
            '/odom': (5, self._odometry),
            '/amcl_pose': (10, self._pose),
            '/cmd_vel': (5, self._twist),
            '/battery': (20, self._battery),
            '/diagnostics': (25, self._diagnostics),
        }
        due = [
            (topic, make()) for topic, (period, make) in makers.items() if self._steps % period == 0
        ]
        self._steps += 1
        if self._happens('lost_odometry', 2.0):
            return [each for each in due if each[0] != '/odom']
        return due

    @property
    def _time(self):
        return self._steps * STEP_S

    def _happens(self, fault, duration=1.0):
        return fault in self._faults and 0 <= self._time % FAULT_PERIOD_S - FAULT_BEGIN_S < duration

    def _drive(self):
        way = self._goal - self._x
        if self._command and abs(way) < BRAKING_M:
            self._command = 0.0
            self._goal = SHELF_M - self._goal
            self._waits_until = self._time + STAND_S
        elif self._time >= self._waits_until:
            self._command = self._limit() if way > 0 else -self._limit()
        # The brakes need 0.5 s for 1 m/s; worn ones need 3 s.
        rate = 1 / 3 if 'late_stop' in self._faults and not self._command else 2.0
        change = rate * STEP_S
        self._speed += min(max(self._command - self._speed, -change), change)
        self._x += self._speed * STEP_S

    def _limit(self):
        begin, end = AISLE_M
        is_near = begin - 0.5 <= self._x <= end + 0.5
        return 0.4 if is_near and 'aisle_speed' not in self._faults else 1.0

    def _scan(self):
        ranges = [4.0] * 90
        ranges[45] = 0.25 if self._happens('collision') else 1.5
        ranges[10] = 0.2  # Its own mast, beside it.
        ranges[0] = float('nan')
        return LaserScan(
            angle_min=-1.57, angle_max=1.57, angle_increment=0.0349, range_max=12.0, ranges=ranges
        )

    def _odometry(self):
        message = Odometry(child_frame_id='base_link')
        message.header.frame_id = 'odom'
        message.pose.pose.position.x = self._x
        message.twist.twist.linear.x = self._speed
        return message

    def _pose(self):
        message = PoseWithCovarianceStamped()
        message.header.frame_id = 'map'
        message.pose.pose.position.x = self._x
        return message

    def _twist(self):
        message = TwistStamped()
        message.header.frame_id = 'base_link'
        message.twist.linear.x = self._command
        return message

    def _battery(self):
        voltage = 21.5 if self._happens('low_voltage') else 24.5
        return BatteryState(voltage=voltage, current=-2.0, percentage=0.8)

    def _diagnostics(self):
        lidar = DiagnosticStatus.ERROR if self._happens('lidar_error') else DiagnosticStatus.OK
        levels = {'lidar': lidar, 'base': DiagnosticStatus.OK, 'camera': DiagnosticStatus.OK}
        return DiagnosticArray(
            status=[DiagnosticStatus(name=name, level=level) for name, level in levels.items()]
        )
