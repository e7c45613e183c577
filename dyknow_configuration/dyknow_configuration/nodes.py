"""The nodes of DyKnow, and the parameters that a robot.yaml gives them.

A check reads them without ROS. A test compares them with the reference of the nodes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Final

from dyknow_common import unknown
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.robot import ParameterValue
from dyknow_configuration.yaml_values import YamlValue

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

COMMON: Final = ('hang_limit', 'use_sim_time')
"""The parameters of every node."""

PARAMETERS: Final[Mapping[str, tuple[str, ...]]] = {
    'stream_processing_engine': (
        'clock_tolerance',
        'default_max_delay',
        'default_max_lead',
        'default_transport_delay',
        'max_specification',
        'max_streams',
        'stream_prefix',
        'watermark_period',
    ),
    'stream_manager': (
        'discovery_period',
        'engine_namespaces',
        'max_specification',
        'max_streams',
        'memory',
        'naming_convention',
        'streams',
    ),
    'ontology_manager': (
        'allow_download',
        'bridges',
        'load_limit',
        'max_bytes',
        'max_solutions',
        'max_statements',
        'ontologies',
        'ontology_path',
        'query_limit',
        'reasoner',
        'reasoning_limit',
        'store',
        'worker_memory',
    ),
    'stream_semantics_manager': (
        'annotations',
        'max_annotations',
        'max_characters',
        'ontology_manager',
        'store',
        'stream_manager',
    ),
    'semantic_matching_engine': (
        'bridges',
        'max_characters',
        'max_matches',
        'ontology_manager',
        'stream_semantics_manager',
    ),
    'stream_reasoning_engine': (
        'formula_limit',
        'group_limit',
        'idle_group_limit',
        'instance_limit',
        'instance_part_limit',
        'node_limit',
        'object_limit',
        'orphan_limit',
        'part_limit',
        'possibility_limit',
        'progress_period',
        'total_part_limit',
        'violation_patience',
    ),
    'stream_reasoning_coordinator': (
        'default_timeout',
        'ended_limit',
        'evaluation_limit',
        'feature_limit',
        'federation',
        'keep_ended',
        'object_limit',
        'ontology_manager',
        'plan_limit',
        'plan_part_limit',
        'semantic_matching_engine',
        'silence_limit',
        'stream_manager',
        'stream_reasoning_engine',
        'stream_semantics_manager',
        'timeout_limit',
        'verdict_topic_limit',
    ),
    'black_box_recorder': (
        'coordinator',
        'folder',
        'folder_bytes',
        'max_boxes',
        'max_per_minute',
        'memory_bytes',
        'memory_messages',
        'ontology_manager',
        'robot',
        'snapshot_service',
        'stream_manager',
    ),
}
"""The other parameters of the nodes that a file may configure."""

_ROS_KEY: Final = 'ros__parameters'
_MAX_DEPTH: Final = 5
"""The most namespaces of a node that are keys of their own."""

_ENGINE_NUMBER: Final = re.compile(r'(?<=engine)_[0-9]+\Z')
_QUALITY_OF_SERVICE: Final = 'qos_overrides'
"""The parameters of rclpy for topics, which DyKnow does not list."""

_FILES: Final = {
    ('stream_manager', 'streams'): 'streams',
    ('ontology_manager', 'ontologies'): 'ontology',
    ('ontology_manager', 'bridges'): 'bridges',
    ('stream_semantics_manager', 'annotations'): 'annotations',
}
"""The keys of the file that set parameters of nodes."""


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
        for parameter, given in parameters.entries('a mapping from parameters to values'):
            if key := _FILES.get((node, parameter.text())):
                raise parameter.error(f"the key '{key}' of the file sets this parameter")
            found[node][parameter.text()] = _parameter(given)
    return found


def is_parameter_file(document: YamlValue) -> bool:
    """Return True for a file of parameters as ROS has them."""
    return any(_ros_parameters(document))


def parameter_faults(document: YamlValue) -> Iterator[ConfigurationError]:
    """Yield the parameters that their nodes do not have, and so ignore.

    Args:
        document: a robot.yaml, or a file of parameters as ROS has them. Nodes that are not
            DyKnow's are skipped, and so are wildcards, which may stand for these.
    """
    stated = [nodes for name, _, nodes in _named(document) if name == 'nodes']
    own = ((node, parameters) for nodes in stated for node, _, parameters in _named(nodes))
    for node, parameters in (*own, *_ros_parameters(document)):
        known = _known_parameters(node)
        for name, key, _ in _named(parameters) if known else ():
            if name not in known and not name.startswith(_QUALITY_OF_SERVICE):
                yield key.error(unknown(f'parameter of {node}', name, known))


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


def _known_parameters(node: str) -> tuple[str, ...]:
    """Return the parameters of a node; none if it is no node of DyKnow."""
    found = PARAMETERS.get(_ENGINE_NUMBER.sub('', node))
    return () if found is None else (*COMMON, *found)


def _parameter(value: YamlValue) -> ParameterValue:
    found: Any = value.plain()
    if isinstance(found, bool | int | float | str):
        return found
    if isinstance(found, list) and all(isinstance(each, str) for each in found):
        return found
    raise value.expected('a number, a boolean, a text or a list of texts')
