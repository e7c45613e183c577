"""Monitors a simulated UAV fleet: all nodes of DyKnow, the simulation, and the formula monitor.

ros2 launch dyknow_bringup uav_monitoring.launch.py scenario:=near_miss uavs:=5
"""

import tempfile
from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from dyknow_bringup.fleet import vehicle_names
from dyknow_bringup.processes import (
    dyknow_processes,
    formula_monitor,
    uav_simulation,
    write_fleet_configuration,
)
from dyknow_bringup.resources import formulas_path, scenario_path, uav_ontology_path
from launch import LaunchContext, LaunchDescription

ARGUMENTS = {
    'scenario': ('nominal', 'name of a shipped scenario, or path of a YAML file'),
    'uavs': ('3', 'number of vehicles'),
    'namespace': ('', 'namespace of all nodes'),
    'use_sim_time': ('false', 'take time from /clock'),
    'log_level': ('info', 'of all nodes'),
}


def _nodes(context: LaunchContext) -> list[Node]:
    vehicles = int(LaunchConfiguration('uavs').perform(context))
    scenario = scenario_path(LaunchConfiguration('scenario').perform(context))
    folder = Path(tempfile.mkdtemp(prefix='uav_monitoring_'))
    configuration = write_fleet_configuration(vehicle_names(vehicles), uav_ontology_path(), folder)
    processes = (
        *dyknow_processes(configuration),
        uav_simulation(scenario, vehicles),
        formula_monitor(formulas_path()),
    )
    return [
        Node(
            package=process.package,
            executable=process.executable,
            namespace=LaunchConfiguration('namespace'),
            output='screen',
            parameters=[
                {**process.parameters, 'use_sim_time': LaunchConfiguration('use_sim_time')}
            ],
            arguments=['--ros-args', '--log-level', LaunchConfiguration('log_level')],
        )
        for process in processes
    ]


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_nodes)])
