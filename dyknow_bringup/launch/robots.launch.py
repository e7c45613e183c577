"""Start the seven nodes of DyKnow for each of several robots, in one ROS domain.

ros2 launch dyknow_bringup robots.launch.py robots:=robot1,robot2 streams:='config/<robot>.streams'

Each robot has a system of its own in its namespace. Relative topics in its files are topics of the
robot: "base/odom" is /robot1/base/odom for robot1, and "odom" is /robot1/odom in streams,
annotations and features. In formulas, a name without a slash is the name of a stream.
"""

from dyknow_bringup.processes.arguments import CONFIGURATION, robots
from dyknow_bringup.processes.launching import launch_description

ARGUMENTS = {
    'robots': (
        'robot1,robot2',
        'namespaces of the robots, separated by commas; <robot> in other arguments is each of them',
    ),
    **CONFIGURATION,
}


def generate_launch_description():
    """Return the launch description for `ros2 launch`."""
    return launch_description(ARGUMENTS, robots)
