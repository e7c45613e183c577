"""The catalogue of recipes: the file recipes.yaml beside this module.

Constants, features and streams are written once for all recipes, as in a robot.yaml; a recipe takes
those that its formula names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

from dyknow_common import unknown
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.vocabulary import is_free_name
from dyknow_configuration.yaml_values import YamlValue, read_yaml

CATALOGUE: Final = Path(__file__).parent / 'recipes.yaml'

SECTIONS: Final = ('objects', 'constants', 'features', 'streams', 'formulas')
"""The sections of a robot.yaml that a recipe has parts of, in its order."""

LISTS: Final = frozenset({'streams', 'formulas'})
"""The sections that are lists."""

_FORMULA_KEYS: Final = ('name', 'formula', 'description', 'severity')
_MADE: Final = re.compile(r'\bsink ([\w{}]+)|\bcompunit \w+: \w+ (\w+\()')
"""The name that makes the use of a text of streams known."""

_WORD: Final = re.compile(r'[A-Za-z_]\w*', re.ASCII)


@dataclass(frozen=True, slots=True)
class RobotPart:
    """An entry of a section of a robot.yaml.

    Args:
        section: such as `features`.
        name: of the entry; of a text of streams, what it makes.
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
        name: of the recipe and its formula.
        formula: in one line.
        description: what it says.
        area: the kind of robots, such as `ground`.
        problem: what goes wrong without it.
        source: where the problem comes from.
        url: of the source; may be empty.
        note: what to know about it; may be empty.
        satisfied: a trace that it holds for, in CSV.
        violated: a trace that it is false for.
        violated_at: when it is false, in nanoseconds.
        topics: that it needs, with their types.
        parts: of a robot.yaml.
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
    """Return the parts that a formula names, and those that these name."""
    found = [each for each in library if each.name in _WORD.findall(formula)]
    for _ in range(2):  # A feature names a stream, and this one a computational unit.
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
