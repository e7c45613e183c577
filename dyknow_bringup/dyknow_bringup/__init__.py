"""Everything to start DyKnow: a UAV fleet simulation, configuration and the demonstration."""

from dyknow_bringup.bag import Bag, QualityOfService, RecordedMessage, RecordedTopic
from dyknow_bringup.errors import BringupError
from dyknow_bringup.fleet import (
    fleet_annotations,
    fleet_ontology,
    fleet_specification,
    vehicle_names,
)
from dyknow_bringup.formulas import NamedFormula, load_formulas
from dyknow_bringup.messages import MESSAGE_TYPES, ros_message
from dyknow_bringup.missions import Mission, Task, load_mission
from dyknow_bringup.recording import STORAGES, record
from dyknow_bringup.replay import Replay, Schedule
from dyknow_bringup.scenario import OUTCOMES, Expectation, Scenario, load_scenario
from dyknow_bringup.simulation import Simulation
from dyknow_bringup.telemetry import TRANSPORT, Battery, Channel, Odometry, Telemetry, topic

__all__ = [
    'MESSAGE_TYPES',
    'OUTCOMES',
    'STORAGES',
    'TRANSPORT',
    'Bag',
    'Battery',
    'BringupError',
    'Channel',
    'Expectation',
    'Mission',
    'NamedFormula',
    'Odometry',
    'QualityOfService',
    'RecordedMessage',
    'RecordedTopic',
    'Replay',
    'Scenario',
    'Schedule',
    'Simulation',
    'Task',
    'Telemetry',
    'fleet_annotations',
    'fleet_ontology',
    'fleet_specification',
    'load_formulas',
    'load_mission',
    'load_scenario',
    'record',
    'ros_message',
    'topic',
    'vehicle_names',
]
