"""Starts the seven nodes of DyKnow for one's own robot.

ros2 launch dyknow_bringup dyknow.launch.py ontology:=my.owl annotations:=my.ssl streams:=my.streams
"""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dyknow_bringup.processes import Configuration, dyknow_processes
from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    'ontology': ('', 'OWL files, separated by commas'),
    'annotations': ('', 'files in SSL, separated by commas'),
    'streams': ('', 'files in the stream language, separated by commas'),
    'namespace': ('', 'namespace of all nodes'),
    'use_sim_time': ('false', 'take time from /clock'),
    'log_level': ('info', 'of all nodes'),
}


def _files(context: LaunchContext, name: str) -> tuple[Path, ...]:
    text = LaunchConfiguration(name).perform(context)
    return tuple(Path(path.strip()).resolve() for path in text.split(',') if path.strip())


def _nodes(context: LaunchContext) -> list[Node]:
    configuration = Configuration(
        _files(context, 'ontology'), _files(context, 'annotations'), _files(context, 'streams')
    )
    return [
        Node(
            package=process.package,
            executable=process.executable,
            namespace=LaunchConfiguration('namespace'),
            parameters=[
                {**process.parameters, 'use_sim_time': LaunchConfiguration('use_sim_time')}
            ],
            arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
        )
        for process in dyknow_processes(configuration)
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])
