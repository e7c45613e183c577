"""The nodes of DyKnow, and the parameters that a robot.yaml gives them."""

from __future__ import annotations

from typing import Any, Final

from dyknow_common import unknown
from dyknow_configuration.documents.yaml_values import YamlValue
from dyknow_configuration.robot import ParameterValue

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


def _parameter(value: YamlValue) -> ParameterValue:
    found: Any = value.plain()
    if isinstance(found, bool | int | float | str):
        return found
    if isinstance(found, list) and all(isinstance(each, str) for each in found):
        return found
    raise value.expected('a number, a boolean, a text or a list of texts')
