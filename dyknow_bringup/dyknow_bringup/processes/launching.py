"""Launch descriptions for `ros2 launch`; only launch files import this module."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.processes import Process, enclave, join_namespaces
from dyknow_bringup.processes.supervision import RESTART_DELAY_NS
from dyknow_common import SECOND_NS
from launch import LaunchDescription

MAX_RESTARTS = 10
"""The number of restarts of a node; a wrong configuration would end it again and again."""

COMMON_ARGUMENTS = {
    'namespace': ('', 'namespace of all nodes'),
    'use_sim_time': ('false', 'take time from /clock'),
    'log_level': ('info', 'of all nodes'),
    'composition': ('true', 'run the nodes of DyKnow in one process'),
    'use_respawn': ('false', 'start a process again that has died'),
}


def launch_description(
    arguments: Mapping[str, tuple[str, str]],
    processes: Callable[[Mapping[str, str]], Iterable[Process]],
) -> Any:
    """Return a launch description that starts processes, given the values of its arguments.

    Args:
        arguments: their names, with default and description; the common ones are added.
        processes: returns the processes to start.
    """
    all_arguments = {**arguments, **COMMON_ARGUMENTS}

    def nodes(context: Any) -> list[Any]:
        values = {name: LaunchConfiguration(name).perform(context) for name in all_arguments}
        started = processes(values)
        if is_true(values['composition']):
            started = composed(started, os.environ)
        return [_node(process, values) for process in started]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in all_arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


def is_true(value: str) -> bool:
    """Return the value of a boolean launch argument."""
    return value.lower() in {'true', '1'}


def _node(process: Process, values: Mapping[str, str]) -> Any:
    return Node(
        package=process.package,
        executable=process.executable,
        namespace=join_namespaces(values['namespace'], process.namespace),
        output='screen',
        parameters=[
            *map(str, process.parameter_files),
            {**process.parameters, 'use_sim_time': is_true(values['use_sim_time'])},
        ],
        ros_arguments=[
            '--log-level',
            values['log_level'],
            '--enclave',
            enclave(process, values['namespace']),
        ],
        respawn=is_true(values['use_respawn']),
        respawn_delay=RESTART_DELAY_NS / SECOND_NS,
        respawn_max_retries=MAX_RESTARTS,
    )
