"""Launch descriptions for `ros2 launch`; only launch files import this module."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessIO
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.arguments import is_true
from dyknow_bringup.processes.composition import composed
from dyknow_bringup.processes.logs import last_lines
from dyknow_bringup.processes.processes import Process, enclave, join_namespaces
from dyknow_bringup.processes.supervision import RESTART_DELAY_NS
from dyknow_common import SECOND_NS, ExitCode
from dyknow_common.executables import CANNOT_START, LAUNCHER
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

_MAX_KEPT = 10_000
"""The characters of the last output of a node that are kept."""


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
        if is_true('composition', values['composition']):
            started = composed(started, os.environ)
        environment = _environment(context.launch_configurations)
        return [action for each in started for action in _node_actions(each, values, environment)]

    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in all_arguments.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=nodes)])


class _StartWatch:
    """Ends a launch with the message of a node that cannot start.

    Args:
        name: the name of the node.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._output = ''

    def keep(self, event: Any) -> None:
        """Keep the end of the output of the node."""
        self._output = (self._output + event.text.decode(errors='replace'))[-_MAX_KEPT:]

    def check(self, event: Any, context: Any) -> None:
        """Check the exit code of the node, unless the launch ends already.

        Raises:
            BringupError: UNAVAILABLE, which ends the launch with an error.
        """
        if event.returncode == CANNOT_START and not context.is_shutdown:
            text = f'{self._name} cannot start:\n{last_lines(self._output)}'
            raise BringupError(text, ExitCode.UNAVAILABLE)


def _environment(configurations: Mapping[str, str]) -> dict[str, str]:
    """Return the variables of processes that end with the launch, by whatever signal that ends.

    At SIGTERM, launch itself leaves its processes running. With a prefix, such as a debugger, they
    are no children of the launch.
    """
    return {} if 'launch-prefix' in configurations else {LAUNCHER: str(os.getpid())}


def _node_actions(
    process: Process, values: Mapping[str, str], environment: Mapping[str, str]
) -> list[Any]:
    watch = _StartWatch(process.name)
    # False would hide the value that a launch file sets for all its nodes (SetParameter).
    is_simulated = is_true('use_sim_time', values['use_sim_time'])
    parameters = {**process.parameters, **({'use_sim_time': True} if is_simulated else {})}
    node = Node(
        package=process.package,
        executable=process.executable,
        name=process.node or None,
        namespace=join_namespaces(values['namespace'], process.namespace),
        output='screen',
        # The last of several values counts.
        parameters=[
            each
            for each in (process.parameter_file, parameters, process.params_file)
            if each is not None
        ],
        ros_arguments=[
            '--log-level',
            values['log_level'],
            '--enclave',
            enclave(process, values['namespace']),
        ],
        additional_env=dict(environment),
        respawn=is_true('use_respawn', values['use_respawn']),
        respawn_delay=RESTART_DELAY_NS / SECOND_NS,
        respawn_max_retries=MAX_RESTARTS,
        on_exit=watch.check,
    )
    output = OnProcessIO(target_action=node, on_stdout=watch.keep, on_stderr=watch.keep)
    return [RegisterEventHandler(output), node]
