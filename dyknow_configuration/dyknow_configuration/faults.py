"""All faults of a robot.yaml, where reading it ends at the first.

After a fault, the smallest part of the document that can be missing is removed, and the rest is
read again:

    features:
      Speed: {of: {r: Rovr}, unit: m/s}      # unknown sort 'Rovr': the feature is removed
      Charge: {unit: Q}                      # unknown unit 'Q': found in the next round
    formulas:
      - {name: a, formula: 'alway p'}        # found in the last round

The user knows what a removed part declares. So a later fault that names it is not a finding, such
as the fault of a feature below `Speed`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import yaml

from dyknow_common import NOWHERE, DyKnowError
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.reading import robot_of
from dyknow_configuration.robot import RobotConfiguration
from dyknow_configuration.yaml_values import YamlValue, read_yaml
from dyknow_reasoning import ForecastFeature

MAX_FAULTS: Final = 20
"""The number of faults after which no more are looked for: each costs one reading of the file."""

_TEXTS: Final = ('ontology', 'annotations', 'streams', 'bridges')
"""The sections whose parts declare names that are not known if they are removed."""

_INDIVISIBLE: Final = (*_TEXTS, 'federation')
"""The sections that are removed as a whole."""

_FORMULAS: Final = ('formulas', 'guards')

_DECLARATIONS: Final = ('sorts', 'objects', 'features', 'constants', 'triggers')


_OF_POSITIONS: Final = {'Positioned', 'distance', 'swept_distance', 'sight_distance', 'yaw'}
"""The sort and the features that positions may give."""


@dataclass(slots=True)
class RobotFaults:
    """The faults of a robot.yaml, and what the rest of it describes.

    Args:
        robot: the robot without the parts at fault; None if nothing is left.
        document: the document, with its values at their places.
        faults: the faults in the order in which they were found.
        removed: the names that removed parts declare.
        lacks_texts: True if removed texts declare other names.
        refused: all texts of formulas and guards that were removed.
    """

    robot: RobotConfiguration | None
    document: YamlValue
    faults: list[DyKnowError] = field(default_factory=list)
    removed: set[str] = field(default_factory=set)
    lacks_texts: bool = False
    refused: set[str] = field(default_factory=set)

    def is_consequence(self, message: str) -> bool:
        """Return True if a message names what a removed part declares."""
        summary = message.partition('\n')[0]
        bounds = filter(None, map(ForecastFeature.of, re.findall(r'\w+', summary)))
        if any(each.feature in self.removed for each in bounds):
            return True
        return any(f"'{name}'" in summary or f' {name}[' in summary for name in self.removed)


def find_faults(path: Path) -> RobotFaults:
    """Return the faults of a robot.yaml.

    Raises:
        ConfigurationError: if it cannot be read, or is not YAML.
    """
    document = read_yaml(path)
    found = RobotFaults(None, document)
    while len(found.faults) < MAX_FAULTS:
        try:
            found.robot = robot_of(document)
            break
        except ConfigurationError as error:
            if not found.is_consequence(error.message):
                found.faults.append(error)
            if not _remove(found, error):
                break
        except DyKnowError as error:
            found.faults.append(error)
            break
    return found


def _remove(found: RobotFaults, error: ConfigurationError) -> bool:
    """Remove the part at fault; return False if there is none that can be missing.

    A reference to another file is removed for all faults of that file.
    """
    root, place = found.document.node, _place_of(found.document, error)
    if place is None or not isinstance(root, yaml.MappingNode):
        return False
    for index, (key, value) in enumerate(root.value):
        if _is_in(key, place) or _is_in(value, place):
            before = _names(value)
            names = None if _is_in(key, place) else _remove_within(key.value, value, place)
            if names is None:
                del root.value[index]
            if key.value in _FORMULAS:
                found.refused |= before if names is None else before - _names(value)
            found.removed |= names or set()
            found.lacks_texts |= key.value in _TEXTS
            return True
    return False


def _place_of(document: YamlValue, error: ConfigurationError) -> tuple[int, int] | None:
    """Return line and column of an error, or of the name of the file that it is in, from 0."""
    if error.path is None or error.position == NOWHERE:
        return None
    if error.path == document.document.path:
        return error.position.line - 1, error.position.column - 1
    folder = document.document.path.parent
    for node in _scalars(document.node):
        if folder / node.value.strip() == error.path:
            return node.start_mark.line, node.start_mark.column
    return None


def _remove_within(section: str, value: yaml.Node, place: tuple[int, int]) -> set[str] | None:
    """Remove an entry or an element of a section; None if it has none at this place."""
    if isinstance(value, yaml.SequenceNode):
        kept = [each for each in value.value if not _is_in(each, place)]
        is_found = len(kept) < len(value.value)
        value.value = kept
        declared = _OF_POSITIONS if section == 'positions' else set[str]()
        return {*declared} if is_found else None
    if not isinstance(value, yaml.MappingNode) or section in _INDIVISIBLE:
        return None
    for index, (key, entry) in enumerate(value.value):
        if _is_in(key, place) or _is_in(entry, place):
            if section == 'features' and not _is_in(key, place) and _remove_source(entry, place):
                return {key.value}
            if section == 'objects' and isinstance(entry, yaml.SequenceNode):
                at_fault = [each for each in entry.value if _is_in(each, place)]
                entry.value = [each for each in entry.value if each not in at_fault]
                if at_fault:  # A sort without objects is a consequence, too.
                    return _names(*at_fault, *[key] * (not entry.value))
            del value.value[index]
            names = _names(key, entry) if section == 'objects' else {key.value}
            return names if section in _DECLARATIONS else set()
    return None


def _remove_source(feature: yaml.Node, place: tuple[int, int]) -> bool:
    """Remove the topic at fault from a feature; return False if the fault is not in one."""
    if not isinstance(feature, yaml.MappingNode):
        return False
    for index, (key, value) in enumerate(feature.value):
        if key.value != 'from' or not (_is_in(key, place) or _is_in(value, place)):
            continue
        if isinstance(value, yaml.SequenceNode):
            kept = [each for each in value.value if not _is_in(each, place)]
            if 0 < len(kept) < len(value.value):
                value.value = kept
                return True
        del feature.value[index]
        return True
    return False


def _names(*nodes: yaml.Node) -> set[str]:
    return {each.value for node in nodes for each in _scalars(node)}


def _is_in(node: yaml.Node, place: tuple[int, int]) -> bool:
    start, end = node.start_mark, node.end_mark
    if isinstance(node, yaml.CollectionNode) and node.flow_style is False:
        # A block ends where the next one begins.
        return (start.line, start.column) <= place < (end.line, end.column)
    return (start.line, start.column) <= place <= (end.line, end.column)


def _scalars(node: yaml.Node) -> Iterator[yaml.ScalarNode]:
    """Yield the scalars in a node; scalars in anchors come once."""
    pending: list[yaml.Node] = [node]
    seen: set[int] = set()
    while pending:
        each = pending.pop()
        if id(each) in seen:
            continue
        seen.add(id(each))
        if isinstance(each, yaml.ScalarNode):
            yield each
        elif isinstance(each, yaml.SequenceNode):
            pending += each.value
        elif isinstance(each, yaml.MappingNode):
            pending += (part for entry in each.value for part in entry)
