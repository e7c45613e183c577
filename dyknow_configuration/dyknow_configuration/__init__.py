"""The file that describes a robot and what is monitored: robot.yaml."""

from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.formulas import read_formulas
from dyknow_configuration.nodes import PACKAGES
from dyknow_configuration.proposals.observations import (
    MAX_MESSAGES,
    ObservedTopic,
    ReadFields,
    SeenValues,
    fields_of_interest,
)
from dyknow_configuration.proposals.robot_text import robot_text
from dyknow_configuration.proposals.timing import (
    ProposedTiming,
    TopicTimes,
    TopicTiming,
    proposed_timing,
    timing_of,
)
from dyknow_configuration.reading import read_robot
from dyknow_configuration.robot import (
    ParameterValue,
    RequestedFormula,
    RobotConfiguration,
    Severity,
    TextSource,
)
from dyknow_configuration.writing import export, write_texts

__all__ = [
    'MAX_MESSAGES',
    'PACKAGES',
    'ConfigurationError',
    'ObservedTopic',
    'ParameterValue',
    'ProposedTiming',
    'ReadFields',
    'RequestedFormula',
    'RobotConfiguration',
    'SeenValues',
    'Severity',
    'TextSource',
    'TopicTimes',
    'TopicTiming',
    'export',
    'fields_of_interest',
    'proposed_timing',
    'read_formulas',
    'read_robot',
    'robot_text',
    'timing_of',
    'write_texts',
]
