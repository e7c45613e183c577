"""The list of processes for `ros2 launch`; the launch package is needed by launch files alone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchDescription

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from dyknow_bringup.processes.processes import Process

COMMON_ARGUMENTS = {
    'namespace': ('', 'namespace of all nodes'),
    'use_sim_time': ('false', 'take time from /clock'),
    'log_level': ('info', 'of all nodes'),
}


def launch_description(
    arguments: Mapping[str, tuple[str, str]],
    processes: Callable[[Mapping[str, str]], Iterable[Process]],
) -> Any:
    """A launch description that starts processes, given the values of its arguments.

    Args:
        arguments: their names, with default and description; the common ones are added.
        processes: what to start.
    """
    every = {**arguments, **COMMON_ARGUMENTS}

    def nodes(context: Any) -> list[Any]:
        values = {name: LaunchConfiguration(name).perform(context) for name in every}
        return [_node(process, values) for process in processes(values)]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in every.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def _node(process: Process, values: Mapping[str, str]) -> Any:
    use_sim_time = values['use_sim_time'].lower() in {'true', '1'}
    return Node(
        package=process.package,
        executable=process.executable,
        namespace=values['namespace'],
        output='screen',
        parameters=[{**process.parameters, 'use_sim_time': use_sim_time}],
        ros_arguments=['--log-level', values['log_level']],
    )
