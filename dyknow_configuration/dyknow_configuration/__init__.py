"""The file that describes a robot and what is monitored: robot.yaml."""

from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.formula_notes import warn_of_notes
from dyknow_configuration.formulas import read_formulas
from dyknow_configuration.nodes import PACKAGES
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
    'PACKAGES',
    'ConfigurationError',
    'ParameterValue',
    'RequestedFormula',
    'RobotConfiguration',
    'Severity',
    'TextSource',
    'export',
    'read_formulas',
    'read_robot',
    'warn_of_notes',
    'write_texts',
]
