"""Everything to start DyKnow: a UAV fleet simulation, configuration and the demonstration."""

from dyknow_bringup.errors import BringupError
from dyknow_bringup.recordings.recording import STORAGES, record
from dyknow_bringup.recordings.replay import Replay, Schedule
from dyknow_bringup.simulation.fleet import vehicle_names
from dyknow_bringup.simulation.missions import Task, load_mission
from dyknow_bringup.simulation.scenario import Scenario, load_scenario
from dyknow_bringup.simulation.simulation import Simulation
from dyknow_bringup.simulation.telemetry import (
    TRANSPORT,
    Battery,
    Channel,
    Odometry,
    Telemetry,
)
from dyknow_bringup.simulation.telemetry_messages import MESSAGE_TYPES, ros_message

__all__ = [
    'MESSAGE_TYPES',
    'STORAGES',
    'TRANSPORT',
    'Battery',
    'BringupError',
    'Channel',
    'Odometry',
    'Replay',
    'Scenario',
    'Schedule',
    'Simulation',
    'Task',
    'Telemetry',
    'load_mission',
    'load_scenario',
    'record',
    'ros_message',
    'vehicle_names',
]
