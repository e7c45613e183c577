"""Start the seven nodes of DyKnow for a robot.

ros2 launch dyknow_bringup dyknow.launch.py config:=robot.yaml
"""

from dyknow_bringup.processes.arguments import CONFIGURATION, configuration
from dyknow_bringup.processes.launching import launch_description
from dyknow_bringup.processes.processes import dyknow_processes, watching_processes


def processes(values):
    """Return the nodes of DyKnow, the guards and the monitor of formulas."""
    found = configuration(values)
    return (*dyknow_processes(found), *watching_processes(found))


def generate_launch_description():
    """Return the launch description for `ros2 launch`."""
    return launch_description(CONFIGURATION, processes)
