"""Insertion of a recipe into the text of a robot.yaml, which keeps its comments and its layout."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import yaml

from dyknow_common import DyKnowError, ExitCode, listed, unit_conversion
from dyknow_configuration.documents.yaml_values import YamlValue, parse_yaml
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.reading import KEYS, robot_of
from dyknow_configuration.recipes.catalogue import LISTS, SECTIONS, Recipe, RobotPart
from dyknow_configuration.robot import RobotFeature
from dyknow_configuration.vocabulary import read_vocabulary

_INDENT: Final = 2


@dataclass(frozen=True, slots=True)
class AddedRecipe:
    """A robot.yaml with a recipe.

    Args:
        text: of the file.
        added: the parts of the recipe that are new.
        kept: those that the file had already, with values of its own.
    """

    text: str
    added: tuple[RobotPart, ...]
    kept: tuple[RobotPart, ...]


@dataclass(frozen=True, slots=True)
class _Edit:
    begin: int
    end: int
    text: str
    is_section: bool = False


def add_recipe(path: Path, text: str, recipe: Recipe) -> AddedRecipe:
    """Return a robot.yaml with a recipe; what both have is kept as it is in the file.

    Args:
        path: of the file, for messages.
        text: of the file; may be empty.
        recipe: to add.

    Raises:
        ConfigurationError: if the file is at fault, has the formula (ALREADY_EXISTS) or a feature
            of the same name that is another one, has too few objects, or would be at fault with
            the recipe.
    """
    text = text if not text or text.endswith('\n') else f'{text}\n'
    document = parse_yaml(path, text)
    robot = robot_of(document)
    if recipe.name in {each.name for each in robot.formulas}:
        message = f"{path} has a formula '{recipe.name}'; add --rename {recipe.name}=OTHER_NAME"
        raise ConfigurationError(message, ExitCode.ALREADY_EXISTS)
    kept = tuple(each for each in recipe.parts if _is_in(each, document))
    _check_kept(kept, document, recipe)
    added = tuple(each for each in recipe.parts if each not in kept)
    edits = [
        edit
        for section in SECTIONS
        if (parts := [each for each in added if each.section == section])
        for edit in _edits(document, section, parts)
    ]
    changed = text
    # From the end on, no edit moves the place of another one; new sections follow the last one.
    order = sorted(edits, key=lambda edit: (edit.begin, edit.is_section))
    for each in reversed(order):
        changed = changed[: each.begin] + each.text + changed[each.end :]
    _check(path, changed, document, added)
    return AddedRecipe(changed, added, kept)


def _is_in(part: RobotPart, document: YamlValue) -> bool:
    if part.section == 'formulas':
        return False
    value = document.mapping(KEYS).get(part.section)
    if value is None:
        return False
    if part.section != 'streams':
        return part.name in {key.text() for key, _ in value.entries('a mapping')}
    wanted = part.plain
    text = ' '.join((wanted if isinstance(wanted, str) else wanted['text']).split())
    found = (each.entries('')[-1][1] if each.is_mapping else each for each in value.one_or_more())
    return any(text in each.line() for each in found)


def _check_kept(kept: tuple[RobotPart, ...], document: YamlValue, recipe: Recipe) -> None:
    """Check that objects and features of the file are what the recipe takes them for."""
    path = document.document.path
    wanted = read_vocabulary(parse_yaml(path, recipe.robot).mapping(KEYS))
    found = read_vocabulary(document.mapping(KEYS))
    for sort in (each.name for each in kept if each.section == 'objects'):
        objects, count = found.objects(sort), len(wanted.objects(sort))
        if len(objects) < count:
            raise ConfigurationError(
                f"'{recipe.name}' is about {count} objects of '{sort}' at least; {path} has "
                f'{listed(objects) or "none"}: add some first'
            )
    for name in (each.name for each in kept if each.section == 'features'):
        own, other = found.features[name], wanted.features[name]
        if not _is_same(own, other):
            raise ConfigurationError(
                f"{path} has another feature '{name}', {_described(own)}; that of the recipe is "
                f'{_described(other)}; rename what differs, such as '
                f'--rename {_renaming(own, other)}',
                ExitCode.ALREADY_EXISTS,
            )


def _is_same(found: RobotFeature, wanted: RobotFeature) -> bool:
    if [*found.arguments.values()] != [*wanted.arguments.values()]:
        return False
    try:
        if found.unit != wanted.unit:
            unit_conversion(found.unit, wanted.unit)
    except DyKnowError:
        return False
    return wanted.value_type.accepts(found.value_type)


def _described(feature: RobotFeature) -> str:
    of = f' of {", ".join(feature.arguments.values())}' if feature.arguments else ''
    return f'a {feature.value_type}{of}{f" in {feature.unit}" if feature.unit else ""}'


def _renaming(found: RobotFeature, wanted: RobotFeature) -> str:
    pairs = zip(wanted.arguments.values(), found.arguments.values(), strict=False)
    sort = next((f'{old}={new}' for old, new in pairs if old != new), '')
    return sort or f'{wanted.name}=Other{wanted.name}'


def _edits(document: YamlValue, section: str, parts: list[RobotPart]) -> Iterator[_Edit]:
    """Yield the changes that add parts to a section, in order."""
    text, root = document.document.text, document.node
    value = document.mapping(KEYS).get(section)
    if value is None:
        lines = ''.join(each.lines(_INDENT) for each in parts)
        yield _Edit(len(text), len(text), f'{section}:\n{lines}', is_section=True)
        return
    node = value.node
    begin, close = node.start_mark, node.end_mark.index - 1
    indent = begin.column
    if value.is_empty:
        yield _Edit(begin.index, close + 1, '')
        indent = root.start_mark.column + _INDENT
    elif isinstance(node, yaml.CollectionNode) and node.flow_style:
        is_open = not node.value or text[:close].rstrip().endswith(',')
        flow = ', '.join(map(_flow_text, parts))
        yield _Edit(close, close, flow if is_open else f', {flow}')
        return
    elif section in LISTS and value.is_mapping:
        indent -= _INDENT
        yield _Edit(begin.index - _INDENT, begin.index, '- ')
    elif not isinstance(node, yaml.CollectionNode):
        indent = root.start_mark.column
        after_key = len(text[: begin.index].rstrip(' '))
        yield _Edit(after_key, begin.index, f'\n{" " * indent}- ')
    lines = ''.join(each.lines(indent) for each in parts)
    yield _Edit(value.end, value.end, lines)


def _flow_text(part: RobotPart) -> str:
    plain = part.plain
    plain = [plain] if part.section in LISTS else plain
    dumped = yaml.safe_dump(
        plain, default_flow_style=True, sort_keys=False, allow_unicode=True, width=1 << 20
    )
    return str(dumped).strip()[1:-1]


def _check(path: Path, text: str, before: YamlValue, added: tuple[RobotPart, ...]) -> None:
    """Check that a text can be read, and that it is the file before with the parts."""
    try:
        after = parse_yaml(path, text)
        robot_of(after)
    except ConfigurationError as error:
        message = f'with the recipe, the file would be at fault: {error.message}'
        raise ConfigurationError(message) from None
    wanted: dict[str, Any] = before.plain() or {}
    for each in added:
        plain = each.plain
        if each.section in LISTS:
            given = wanted.get(each.section) or []
            wanted[each.section] = [*(given if isinstance(given, list) else [given]), plain]
        else:
            wanted[each.section] = {**(wanted.get(each.section) or {}), **plain}
    if after.plain() != wanted:
        names = ', '.join(dict.fromkeys(each.section for each in added))
        raise ConfigurationError(
            f'{path}: cannot add to {names}; write each on lines of its own, without * and <<'
        )
