"""The recipes of recipes.yaml beside this module, and their insertion into a robot.yaml.

Constants, features and streams are written once for all recipes, as in a robot.yaml; a recipe takes
the ones that its formula names. An insertion keeps the comments and the layout of the file.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

from dyknow_common import ExitCode, listed, unknown
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.reading import KEYS, robot_of
from dyknow_configuration.robot import RobotFeature
from dyknow_configuration.vocabulary import is_free_name, read_vocabulary
from dyknow_configuration.yaml_values import YamlValue, parse_yaml, read_yaml

CATALOGUE: Final = Path(__file__).parent / 'recipes.yaml'

SECTIONS: Final = ('objects', 'constants', 'features', 'streams', 'formulas')
"""The sections of a robot.yaml that a recipe has parts of, in its order."""

LISTS: Final = frozenset({'streams', 'formulas'})
"""The sections that are lists."""

_FORMULA_KEYS: Final = ('name', 'formula', 'description', 'severity')
_MADE: Final = re.compile(r'\bsink ([\w{}]+)|\bcompunit \w+: \w+ (\w+\()')
"""The name that makes the use of a text of streams known."""

_WORD: Final = re.compile(r'[A-Za-z_]\w*', re.ASCII)
_Edit = tuple[tuple[int, int], int, str]
"""A replacement: its begin, its rank among edits with the same begin, its end, and the new text."""


@dataclass(frozen=True, slots=True)
class RobotPart:
    """An entry of a section of a robot.yaml.

    Args:
        section: such as `features`.
        name: the name of the entry; of a text of streams, what it makes.
        text: its lines, without the indentation and the dash of the section.
    """

    section: str
    name: str
    text: str

    @property
    def plain(self) -> Any:
        """What it is in YAML: an element of a list, or a mapping with its name."""
        value = yaml.safe_load(self.lines(0))
        return value[0] if self.section in LISTS else value

    def lines(self, indent: int) -> str:
        """Return its lines in a section, whose entries begin at a column."""
        dash, inner = ('- ', '  ') if self.section in LISTS else ('', '')
        text = self.text.replace('\n', f'\n{" " * indent}{inner}')
        return f'{" " * indent}{dash}{text}\n'


@dataclass(frozen=True, slots=True)
class Recipe:
    """A formula that many robots must keep, with what it needs.

    Args:
        name: the name of the recipe and its formula.
        formula: in one line.
        description: what it says.
        area: the kind of robots, such as `ground`.
        problem: what goes wrong without it.
        source: where the problem comes from.
        url: the URL of the source; may be empty.
        note: what to know about it; may be empty.
        satisfied: a trace that it holds for, in CSV.
        violated: a trace that it is false for.
        violated_at: when it is false, in nanoseconds.
        topics: the topics that it needs, with their types.
        parts: the parts of a robot.yaml.
    """

    name: str
    formula: str
    description: str
    area: str
    problem: str
    source: str
    url: str
    note: str
    satisfied: str
    violated: str
    violated_at: int
    topics: Mapping[str, str]
    parts: tuple[RobotPart, ...]

    @property
    def robot(self) -> str:
        """The recipe as a robot.yaml."""
        lines = {each: self.lines(each) for each in SECTIONS}
        return ''.join(f'{section}:\n{text}' for section, text in lines.items() if text)

    def lines(self, section: str) -> str:
        """Return the lines of the parts of a section."""
        return ''.join(each.lines(2) for each in self.parts if each.section == section)

    def renamed(self, names: Mapping[str, str]) -> Recipe:
        """Return the recipe with other names of sorts, objects, constants, features or formulas.

        Raises:
            ConfigurationError: if the recipe has no such name, or a new one is none.
        """
        objects = ' '.join(each.text for each in self.parts if each.section == 'objects')
        known = {*_WORD.findall(objects), *(each.name for each in self.parts)}
        for old, new in names.items():
            if old not in known:
                raise ConfigurationError(unknown('name', old, sorted(known)))
            if not is_free_name(new):
                raise ConfigurationError(f"'{new}' cannot be a name; use letters, digits and _")

        def changed(text: str) -> str:
            return _WORD.sub(lambda word: names.get(word[0], word[0]), text)

        parts = (
            replace(each, name=changed(each.name), text=changed(each.text)) for each in self.parts
        )
        return replace(self, name=changed(self.name), parts=tuple(parts))


@cache
def read_recipes() -> Mapping[str, Recipe]:
    """Return all recipes, by name."""
    values = {key.text(): each for key, each in read_yaml(CATALOGUE).entries('')}
    library = [
        RobotPart(section, key.text(), _source(key, each))
        for section in ('constants', 'features')
        for key, each in values[section].entries('')
    ]
    texts = [_source(each, each) for each in values['streams'].items()]
    library += [RobotPart('streams', ''.join(_MADE.findall(each)[-1]), each) for each in texts]
    types = {key.text(): each.text() for key, each in values['types'].entries('')}
    recipes = (_recipe(each, library, types) for each in values['recipes'].items())
    return {each.name: each for each in recipes}


def _recipe(value: YamlValue, library: list[RobotPart], types: Mapping[str, str]) -> Recipe:
    stated = {key.text(): each for key, each in value.entries('')}
    (*_, last) = (each for key, each in stated.items() if key in _FORMULA_KEYS)
    objects = stated['objects'].plain().items() if 'objects' in stated else ()
    parts = (
        *(RobotPart('objects', key, f'{key}: [{", ".join(each)}]') for key, each in objects),
        *_named(stated['formula'].line(), library),
        RobotPart('formulas', stated['name'].line(), _source(value, last)),
    )
    text = '\n'.join(each.text for each in parts)
    texts = {
        key: stated[key].line() if key in stated else ''
        for key in ('name', 'formula', 'description', 'area', 'problem', 'source', 'url', 'note')
    }
    return Recipe(
        **texts,
        satisfied=stated['satisfied'].text(),
        violated=stated['violated'].text(),
        violated_at=stated['violated_at'].duration(),
        topics={
            topic: each
            for topic, each in types.items()
            if re.search(rf'(?<![\w/}}]){re.escape(topic)}(?![\w/])', text)
        },
        parts=parts,
    )


def _named(formula: str, library: Iterable[RobotPart]) -> list[RobotPart]:
    """Return the parts that a formula names, and the parts that these parts name."""
    found = [each for each in library if each.name in _WORD.findall(formula)]
    for _ in range(2):  # A feature names a stream, and the stream a computational unit.
        text = '\n'.join(each.text for each in found)
        found = [
            each
            for each in library
            if each in found or (each.section == 'streams' and each.name in text)
        ]
    return found


def _source(first: YamlValue, last: YamlValue) -> str:
    """Return the lines of the file from one value to the end of another, without indentation."""
    begin = first.node.start_mark
    text = first.document.text[begin.index : last.end].rstrip()
    return text.replace(f'\n{" " * begin.column}', '\n')


@dataclass(frozen=True, slots=True)
class AddedRecipe:
    """A robot.yaml with a recipe.

    Args:
        text: the text of the file.
        added: the parts of the recipe that are new.
        kept: the parts that the file had already, perhaps with other values.
    """

    text: str
    added: tuple[RobotPart, ...]
    kept: tuple[RobotPart, ...]


def add_recipe(path: Path, text: str, recipe: Recipe) -> AddedRecipe:
    """Return a robot.yaml with a recipe; what both have is kept as it is in the file.

    Args:
        path: the path of the file, for messages.
        text: the text of the file; may be empty.
        recipe: the recipe to add.

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
