"""The nodes of DyKnow, and the parameters that a robot.yaml gives them.

A check reads them without ROS. A test compares them with the reference of the nodes.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, cast

from dyknow_common import unknown
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.robot import ParameterValue
from dyknow_configuration.yaml_values import YamlValue, read_yaml

PACKAGES: Final = {
    'stream_processing_engine': 'dyknow_stream_processing',
    'stream_manager': 'dyknow_stream_processing',
    'ontology_manager': 'dyknow_semantics',
    'stream_semantics_manager': 'dyknow_semantics',
    'semantic_matching_engine': 'dyknow_semantics',
    'stream_reasoning_engine': 'dyknow_reasoning',
    'stream_reasoning_coordinator': 'dyknow_coordinator',
}
"""The packages of the seven nodes of DyKnow."""

_CONFIGURED: Final = (*PACKAGES, 'black_box_recorder')
"""The nodes whose parameters a file may give."""

ParameterKind = type[bool] | type[str] | type[list[str]] | tuple[int, int] | tuple[float, float]
"""The type of a parameter; of a number, the least and the greatest value."""

_COUNT: Final = (1, 100_000_000)

COMMON: Final[Mapping[str, ParameterKind]] = {
    'hang_limit': (0.0, 3_600.0),
    'use_sim_time': bool,
}
"""The parameters of every node."""

PARAMETERS: Final[Mapping[str, Mapping[str, ParameterKind]]] = {
    'stream_processing_engine': {
        'clock_tolerance': (0.0, 3_600.0),
        'default_max_delay': (0.0, 3_600.0),
        'default_max_lead': (0.0, 3_600.0),
        'default_transport_delay': (0.0, 3_600.0),
        'max_specification': (100, 1_000_000),
        'max_streams': (1, 1_000_000),
        'stream_prefix': str,
        'watermark_period': (0.001, 1.0),
    },
    'stream_manager': {
        'discovery_period': (0.01, 60.0),
        'engine_namespaces': list,
        'max_specification': (100, 1_000_000),
        'max_streams': (1, 1_000_000),
        'memory': str,
        'naming_convention': str,
        'streams': list,
    },
    'ontology_manager': {
        'allow_download': bool,
        'bridges': list,
        'load_limit': (0.1, 86_400.0),
        'max_bytes': (1, 2_147_483_648),
        'max_solutions': _COUNT,
        'max_statements': (1_000, 100_000_000),
        'ontologies': list,
        'ontology_path': list,
        'query_limit': (0.1, 86_400.0),
        'reasoner': str,
        'reasoning_limit': (1.0, 86_400.0),
        'store': str,
        'worker_memory': (128, 1_048_576),
    },
    'stream_semantics_manager': {
        'annotations': list,
        'max_annotations': (1, 10_000_000),
        'max_characters': (100, 1_000_000),
        'ontology_manager': str,
        'store': str,
        'stream_manager': str,
    },
    'semantic_matching_engine': {
        'bridges': list,
        'max_characters': (100, 1_000_000),
        'max_matches': (1, 10_000_000),
        'ontology_manager': str,
        'stream_semantics_manager': str,
    },
    'stream_reasoning_engine': {
        'formula_limit': _COUNT,
        'group_limit': _COUNT,
        'idle_group_limit': _COUNT,
        'instance_limit': _COUNT,
        'instance_part_limit': _COUNT,
        'node_limit': _COUNT,
        'object_limit': _COUNT,
        'orphan_limit': (0.0, 86_400.0),
        'part_limit': _COUNT,
        'possibility_limit': _COUNT,
        'progress_period': (0.05, 60.0),
        'total_part_limit': _COUNT,
        'violation_patience': (0.0, 3_600.0),
    },
    'stream_reasoning_coordinator': {
        'default_timeout': (0.1, 1e9),
        'ended_limit': _COUNT,
        'evaluation_limit': _COUNT,
        'feature_limit': _COUNT,
        'federation': str,
        'keep_ended': (0.0, 1_000_000.0),
        'object_limit': _COUNT,
        'ontology_manager': str,
        'plan_limit': _COUNT,
        'plan_part_limit': _COUNT,
        'semantic_matching_engine': str,
        'silence_limit': (0.1, 1e9),
        'stream_manager': str,
        'stream_reasoning_engine': str,
        'stream_semantics_manager': str,
        'timeout_limit': (0.0, 1e9),
        'verdict_topic_limit': _COUNT,
    },
    'black_box_recorder': {
        'coordinator': str,
        'folder': str,
        'folder_bytes': (1, 10**12),
        'max_boxes': (1, 10**12),
        'max_per_minute': (1, 10**12),
        'memory_bytes': (1, 10**12),
        'memory_messages': (1, 10**12),
        'ontology_manager': str,
        'robot': str,
        'snapshot_service': str,
        'stream_manager': str,
    },
}
"""The other parameters of the nodes that a file may configure."""

_NODES: Final = (*_CONFIGURED, 'federation', 'formula_markers', 'formula_monitor')
"""The nodes of DyKnow with names that no robot.yaml gives."""

_NODE_SIMILARITY: Final = 0.85
"""Of misspelt nodes. Other nodes share the files: `ontology_server` is no misspelling."""

_KEY_SIMILARITY: Final = 0.75
_ROS_KEY: Final = 'ros__parameters'
_MAX_DEPTH: Final = 5
"""The most namespaces of a node that are keys of their own."""

_ENGINE_NUMBER: Final = re.compile(r'(?<=engine)_[0-9]+\Z')
_EXPONENT: Final = re.compile(r'[0-9]{1,9}(\.[0-9]{1,9})?[eE][+-]?[0-9]{1,3}')
_QUALITY_OF_SERVICE: Final = 'qos_overrides'
"""The parameters of rclpy for topics, which DyKnow does not list."""

_FILES: Final = {
    ('stream_manager', 'streams'): 'streams',
    ('ontology_manager', 'ontologies'): 'ontology',
    ('ontology_manager', 'bridges'): 'bridges',
    ('stream_semantics_manager', 'annotations'): 'annotations',
}
"""The keys of the file that set parameters of nodes."""

_DESCRIPTIONS: Final[Mapping[object, str]] = {
    bool: 'true or false',
    str: 'a text',
    list: 'a list of texts',
    None: 'a number, a boolean, a text or a list of texts',
}


def read_parameters(value: YamlValue) -> dict[str, dict[str, ParameterValue]]:
    """Return the parameters of nodes, by the names of nodes and parameters.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found: dict[str, dict[str, ParameterValue]] = {}
    for name, parameters in value.entries('a mapping from nodes to their parameters'):
        node = name.text()
        if node not in _CONFIGURED:
            raise name.error(unknown('node', node, _CONFIGURED))
        found[node] = {}
        known = _known_parameters(node)
        for parameter, given in parameters.entries('a mapping from parameters to values'):
            if key := _FILES.get((node, parameter.text())):
                raise parameter.error(f"the key '{key}' of the file sets this parameter")
            found[node][parameter.text()] = _parameter(given, known.get(parameter.text()))
    return found


def is_parameter_file(document: YamlValue) -> bool:
    """Return True for a file of parameters as ROS has them."""
    return any(_ros_parameters(document)) or any(_misspelt_names(document))


def parameter_faults(document: YamlValue) -> Iterator[ConfigurationError]:
    """Yield the parameters that nodes ignore, as they do not have them, or that nodes refuse.

    Args:
        document: a robot.yaml, whose values are checked where it is read, or a ROS parameter file.
            Nodes that are not DyKnow's are skipped, and so are wildcards, which may stand for such
            nodes.
    """
    stated = [nodes for name, _, nodes in _named(document) if name == 'nodes']
    own = ((node, parameters) for nodes in stated for node, _, parameters in _named(nodes))
    of_ros = list(_ros_parameters(document))
    yield from (error for is_node, error in _misspelt_names(document) if not is_node)
    for node, parameters in (*own, *of_ros):
        known = _known_parameters(node)
        for name, key, _ in _named(parameters) if known else ():
            if name not in known and not name.startswith(_QUALITY_OF_SERVICE):
                yield key.error(unknown(f'parameter of {node}', name, known))
    for node, parameters in of_ros:
        known = _known_parameters(node)
        for name, _, value in _named(parameters):
            try:
                if name in known:
                    _parameter(value, known[name], of_ros=True)
            except ConfigurationError as error:
                yield error


def misspelt_nodes(document: YamlValue) -> Iterator[ConfigurationError]:
    """Yield the names in a ROS parameter file that resemble nodes of DyKnow: ROS ignores them."""
    return (error for is_node, error in _misspelt_names(document) if is_node)


def warn_of_misspelt_names(path: Path) -> None:
    """Print the misspelt names in a ROS parameter file as warnings."""
    with suppress(ConfigurationError):  # ROS refuses the file, or reads more than we do.
        for _, error in _misspelt_names(read_yaml(path)):
            print(f'warning: {error}', file=sys.stderr)  # noqa: T201 - of a command


def _misspelt_names(value: YamlValue, depth: int = 0) -> Iterator[tuple[bool, ConfigurationError]]:
    """Yield the misspelt names in a ROS parameter file, each with True for a node."""
    for name, key, inner in _named(value) if depth < _MAX_DEPTH else ():
        node = name.rpartition('/')[2]
        is_known = _ENGINE_NUMBER.sub('', node) in _NODES
        below = [(each, word) for each, word, given in _named(inner) if given.is_mapping]
        if any(each == _ROS_KEY for each, _ in below):
            if not is_known and get_close_matches(node, _NODES, 1, _NODE_SIMILARITY):
                yield True, key.error(unknown('node', node, _NODES))
            continue
        for each, word in below if is_known or node == '**' else ():
            if get_close_matches(each, (_ROS_KEY,), 1, _KEY_SIMILARITY):
                yield False, word.error(unknown('key', each, (_ROS_KEY,)))
        if not is_known and name != 'nodes':
            yield from _misspelt_names(inner, depth + 1)


def _ros_parameters(
    value: YamlValue, node: str = '', depth: int = 0
) -> Iterator[tuple[str, YamlValue]]:
    """Yield the parameters in a ROS file, by the names of their nodes without a namespace."""
    for name, _, inner in _named(value) if depth < _MAX_DEPTH else ():
        if name == _ROS_KEY:
            yield node, inner
        else:
            yield from _ros_parameters(inner, name.rpartition('/')[2], depth + 1)


def _named(value: YamlValue) -> Iterator[tuple[str, YamlValue, YamlValue]]:
    """Yield the entries of a mapping with their names; others are refused where it is read."""
    for key, entry in value.node.value if value.is_mapping else ():
        if isinstance(key.value, str):
            yield key.value, YamlValue(value.document, key), YamlValue(value.document, entry)


def _known_parameters(node: str) -> Mapping[str, ParameterKind]:
    """Return the parameters of a node; none if it is no node of DyKnow."""
    found = PARAMETERS.get(_ENGINE_NUMBER.sub('', node))
    return {} if found is None else {**COMMON, **found}


def _parameter(
    value: YamlValue, kind: ParameterKind | None, *, of_ros: bool = False
) -> ParameterValue:
    """Return a parameter of a kind, or of any.

    ROS files tell whole numbers from others; in a robot.yaml, 5 stands for 5.0.
    """
    if isinstance(kind, tuple):
        return _number(value, *kind, of_ros=of_ros)
    found: Any = value.plain()
    is_list = isinstance(found, list) and all(isinstance(each, str) for each in found)
    if is_list if kind in (list, None) else type(found) is kind:
        return cast('ParameterValue', found)
    if kind is None and isinstance(found, bool | int | float | str):
        return found
    raise value.expected(_DESCRIPTIONS[kind])


def _number(value: YamlValue, low: float, high: float, *, of_ros: bool) -> float:
    found: Any = value.plain()
    if isinstance(found, str) and _EXPONENT.fullmatch(found):
        found = float(found)  # PyYAML wants a point and a sign in 1.0e+9.
    is_whole = isinstance(low, int)
    expected = int if is_whole else float if of_ros else int | float
    is_number = isinstance(found, expected) and not isinstance(found, bool)
    if is_number and low <= found <= high:
        return type(low)(found)
    kind = 'a whole number' if is_whole else 'a number with a point' if of_ros else 'a number'
    text = f'{kind} from {low:.12g} to {high:.12g}'
    if value.is_number:
        raise value.error(f'write {text} instead of {value.node.value}')
    raise value.expected(text)
