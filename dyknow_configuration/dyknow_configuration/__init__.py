"""The file that describes a robot and what is monitored: robot.yaml."""

from dyknow_configuration.errors import ConfigurationError, write_errors
from dyknow_configuration.expectations import TopicExpectation
from dyknow_configuration.faults import RobotFaults, find_faults
from dyknow_configuration.federation import (
    MAX_COMPARED,
    MAX_COMPARED_NUMBER,
    RequestedFederation,
    RequestedShare,
)
from dyknow_configuration.forecasts import table_text
from dyknow_configuration.formulas import formula_lines, read_formulas, warn_of_notes
from dyknow_configuration.nodes import (
    PACKAGES,
    is_parameter_file,
    misspelt_nodes,
    parameter_faults,
    warn_of_misspelt_names,
)
from dyknow_configuration.proposals.observations import (
    FRAME,
    MAX_MESSAGES,
    ObservedTopic,
    ReadFields,
    SeenValues,
    fields_of_interest,
    frame_difference,
    frames_of,
    is_coordinate,
)
from dyknow_configuration.proposals.robot_text import robot_text
from dyknow_configuration.proposals.timing import (
    ProposedTiming,
    TopicTimes,
    TopicTiming,
    broken_constraints,
    proposed_timing,
    timing_of,
)
from dyknow_configuration.reading import read_robot
from dyknow_configuration.recipes import (
    AddedRecipe,
    Recipe,
    RobotPart,
    add_recipe,
    read_recipes,
)
from dyknow_configuration.regions import POSITION_FEATURES
from dyknow_configuration.robot import (
    NO_MAP,
    PATH_INPUTS,
    FeatureForecast,
    ForecastSource,
    ParameterValue,
    RequestedFormula,
    RequestedGuard,
    RobotConfiguration,
    RobotMap,
    Severity,
    TextSource,
)
from dyknow_configuration.triggers import (
    ACTION_KEYS,
    PLACEHOLDERS,
    FormulaTriggers,
    Trigger,
    TriggerEvent,
    TriggerKind,
    filled,
    single_placeholder,
)
from dyknow_configuration.writing import export, write_new, write_texts
from dyknow_configuration.yaml_values import YamlValue, add_quotes, read_yaml

__all__ = [
    'ACTION_KEYS',
    'FRAME',
    'MAX_COMPARED',
    'MAX_COMPARED_NUMBER',
    'MAX_MESSAGES',
    'NO_MAP',
    'PACKAGES',
    'PATH_INPUTS',
    'PLACEHOLDERS',
    'POSITION_FEATURES',
    'AddedRecipe',
    'ConfigurationError',
    'FeatureForecast',
    'ForecastSource',
    'FormulaTriggers',
    'ObservedTopic',
    'ParameterValue',
    'ProposedTiming',
    'ReadFields',
    'Recipe',
    'RequestedFederation',
    'RequestedFormula',
    'RequestedGuard',
    'RequestedShare',
    'RobotConfiguration',
    'RobotFaults',
    'RobotMap',
    'RobotPart',
    'SeenValues',
    'Severity',
    'TextSource',
    'TopicExpectation',
    'TopicTimes',
    'TopicTiming',
    'Trigger',
    'TriggerEvent',
    'TriggerKind',
    'YamlValue',
    'add_quotes',
    'add_recipe',
    'broken_constraints',
    'export',
    'fields_of_interest',
    'filled',
    'find_faults',
    'formula_lines',
    'frame_difference',
    'frames_of',
    'is_coordinate',
    'is_parameter_file',
    'misspelt_nodes',
    'parameter_faults',
    'proposed_timing',
    'read_formulas',
    'read_recipes',
    'read_robot',
    'read_yaml',
    'robot_text',
    'single_placeholder',
    'table_text',
    'timing_of',
    'warn_of_misspelt_names',
    'warn_of_notes',
    'write_errors',
    'write_new',
    'write_texts',
]
