"""Monitor a simulated UAV fleet: all nodes of DyKnow, the simulation, and the formula monitor.

ros2 launch dyknow_bringup uav_monitoring.launch.py scenario:=near_miss uavs:=5
"""

from dyknow_bringup.processes.arguments import is_true, number
from dyknow_bringup.processes.launching import launch_description
from dyknow_bringup.processes.processes import (
    dyknow_processes,
    formula_markers,
    formula_monitor,
    uav_simulation,
)
from dyknow_bringup.processes.robot import fleet_configuration
from dyknow_bringup.resources import formulas_path, scenario_path
from dyknow_bringup.simulation.vehicle import vehicle_names

ARGUMENTS = {
    'scenario': ('nominal', 'name of a shipped scenario, or path of a YAML file'),
    'uavs': ('3', 'number of vehicles'),
    'markers': ('true', 'show formulas in rviz2 or Foxglove'),
}


def processes(values):
    """Return the nodes of DyKnow, the simulation, and the nodes that monitor it."""
    vehicles = number('uavs', values['uavs'])
    return (
        *dyknow_processes(fleet_configuration(vehicle_names(vehicles))),
        uav_simulation(scenario_path(values['scenario']), vehicles),
        formula_monitor(formulas_path()),
        *([formula_markers()] if is_true('markers', values['markers']) else []),
    )


def generate_launch_description():
    """Return the launch description for `ros2 launch`."""
    return launch_description(ARGUMENTS, processes)
