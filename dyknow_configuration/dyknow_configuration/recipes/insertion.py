"""Insertion of a recipe into the text of a robot.yaml, which keeps its comments and its layout."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dyknow_common import ExitCode, listed
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.reading import KEYS, robot_of
from dyknow_configuration.recipes.catalogue import LISTS, SECTIONS, Recipe, RobotPart
from dyknow_configuration.robot import RobotFeature
from dyknow_configuration.vocabulary import read_vocabulary
from dyknow_configuration.yaml_values import YamlValue, parse_yaml


@dataclass(frozen=True, slots=True)
class AddedRecipe:
    """A robot.yaml with a recipe.

    Args:
        text: of the file.
        added: the parts of the recipe that are new.
        kept: those that the file had already, perhaps with other values.
    """

    text: str
    added: tuple[RobotPart, ...]
    kept: tuple[RobotPart, ...]


def add_recipe(path: Path, text: str, recipe: Recipe) -> AddedRecipe:
    """Return a robot.yaml with a recipe; what both have is kept as it is in the file.

    Args:
        path: of the file, for messages.
        text: of the file; may be empty.
        recipe: to add.

    Raises:
        ConfigurationError: if the file is at fault, has the formula (ALREADY_EXISTS), has a feature
            of the same name that is another one or too few objects, or cannot be changed.
    """
    document = parse_yaml(path, text if not text or text.endswith('\n') else f'{text}\n')
    if recipe.name in {each.name for each in robot_of(document).formulas}:
        message = f"{path} has a formula '{recipe.name}'; add --rename {recipe.name}=OTHER_NAME"
        raise ConfigurationError(message, ExitCode.ALREADY_EXISTS)
    content = document.plain() or {}
    kept = tuple(each for each in recipe.parts if _is_in(each, content))
    added = tuple(each for each in recipe.parts if each not in kept)
    _check_kept(kept, document, recipe)
    edits = [
        edit
        for section in SECTIONS
        if (parts := [each for each in added if each.section == section])
        for edit in _edits(document, section, parts)
    ]
    changed = document.document.text
    # From the end on, no edit moves the place of another one; new sections come last.
    for (begin, _), end, inserted in sorted(edits, key=lambda edit: edit[0], reverse=True):
        changed = changed[:begin] + inserted + changed[end:]
    _check(path, changed, content, added)
    return AddedRecipe(changed, added, kept)


def _is_in(part: RobotPart, content: dict[str, Any]) -> bool:
    if part.section in LISTS:
        return part.plain in _listed(content.get(part.section))
    return part.name in (content.get(part.section) or ())


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value] if value else []


def _check_kept(kept: tuple[RobotPart, ...], document: YamlValue, recipe: Recipe) -> None:
    """Check that objects and features of the file are what the recipe takes them for."""
    path = document.document.path
    wanted = read_vocabulary(parse_yaml(path, recipe.robot).mapping(KEYS))
    found = read_vocabulary(document.mapping(KEYS))
    for name in (each.name for each in kept if each.section == 'objects'):
        objects, count = found.objects(name), len(wanted.objects(name))
        if len(objects) < count:
            raise ConfigurationError(
                f"'{recipe.name}' is about {count} objects of '{name}' at least; {path} has "
                f'{listed(objects) or "none"}: add some first'
            )
    for name in (each.name for each in kept if each.section == 'features'):
        own, other = _signature(found.features[name]), _signature(wanted.features[name])
        if own != other:
            raise ConfigurationError(
                f"{path} has another feature '{name}', {own}; that of the recipe is {other}; add "
                '--rename OLD=NEW for what differs, such as the sort or the feature',
                ExitCode.ALREADY_EXISTS,
            )


def _signature(feature: RobotFeature) -> str:
    of = f' of {", ".join(feature.arguments.values())}' if feature.arguments else ''
    return f'a {feature.value_type}{of}{f" in {feature.unit}" if feature.unit else ""}'


_Edit = tuple[tuple[int, int], int, str]
"""What is replaced: where it begins, a rank among those that begin there, its end, and by what."""


def _edits(document: YamlValue, section: str, parts: list[RobotPart]) -> Iterator[_Edit]:
    """Yield the changes that add parts to a section."""
    text, value = document.document.text, document.mapping(KEYS).get(section)
    if value is None:
        lines = ''.join(each.lines(2) for each in parts)
        yield (len(text), 1 + SECTIONS.index(section)), len(text), f'{section}:\n{lines}'
        return
    node, indent = value.node, value.node.start_mark.column
    begin, close = node.start_mark.index, node.end_mark.index - 1
    if isinstance(node, yaml.CollectionNode) and node.flow_style:
        is_open = not node.value or text[:close].rstrip().endswith(',')
        flow = ', '.join(map(_flow_text, parts))
        yield (close, 0), close, flow if is_open else f', {flow}'
        return
    if value.is_empty:
        indent = document.node.start_mark.column + 2
        yield (begin, 0), close + 1, ''
    elif section in LISTS and value.is_mapping:  # It becomes the first of a list.
        indent -= 2
        yield (begin - 2, 0), begin, '- '
    elif not isinstance(node, yaml.CollectionNode):  # So does a text.
        indent = document.node.start_mark.column
        yield (len(text[:begin].rstrip(' ')), 0), begin, f'\n{" " * indent}- '
    yield (value.end, 0), value.end, ''.join(each.lines(indent) for each in parts)


def _flow_text(part: RobotPart) -> str:
    plain = [part.plain] if part.section in LISTS else part.plain
    dumped = yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=1 << 20)
    return str(dumped).strip()[1:-1]


def _check(path: Path, text: str, content: dict[str, Any], added: Iterable[RobotPart]) -> None:
    """Check that a file can be read, and has a former content and the parts."""
    for each in added:
        before = content.get(each.section)
        content[each.section] = (
            [*_listed(before), each.plain]
            if each.section in LISTS
            else {**(before or {}), **each.plain}
        )
    try:
        changed = parse_yaml(path, text)
        robot_of(changed)
    except ConfigurationError as error:
        message = f'with the recipe, the file would be at fault: {error.message}'
        raise ConfigurationError(message) from None
    if changed.plain() != content:
        raise ConfigurationError(
            f'{path}: cannot add to {", ".join(dict.fromkeys(each.section for each in added))}; '
            'write these sections as lists or mappings of their own, without * and <<'
        )
