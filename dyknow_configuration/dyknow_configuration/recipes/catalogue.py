"""The catalogue of recipes, which is the file recipes.yaml beside this module.

The constants, features and streams of all recipes are written once, as in a robot.yaml. A recipe
consists of a formula, and of those of them that it names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import yaml

from dyknow_common import unknown
from dyknow_configuration.documents.yaml_values import YamlValue, read_yaml
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.vocabulary import is_free_name

CATALOGUE: Final = Path(__file__).parent / 'recipes.yaml'

SECTIONS: Final = ('objects', 'constants', 'features', 'streams', 'formulas')
"""The sections of a robot.yaml that a recipe has parts of, in the order in which it lists them."""

LISTS: Final = frozenset({'streams', 'formulas'})
"""The sections that are lists."""

_FORMULA_KEYS: Final = ('name', 'formula', 'description', 'severity')
_STREAM_NAME: Final = re.compile(r'\bsink (?P<sink>[\w{}]+)|\bcompunit \w+: \w+ (?P<unit>\w+\()')
_WORD: Final = re.compile(r'[A-Za-z_]\w*', re.ASCII)


@dataclass(frozen=True, slots=True)
class RobotPart:
    """An entry of a section of a robot.yaml.

    Args:
        section: such as `features`.
        name: of a sort, constant, feature or formula; of a text of streams, what it makes.
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
        first, *others = self.text.split('\n')
        margin = ' ' * indent
        found = [f'{margin}{dash}{first}', *(f'{margin}{inner}{each}' for each in others)]
        return ''.join(f'{each.rstrip()}\n' for each in found)


@dataclass(frozen=True, slots=True)
class Recipe:
    """A formula that many robots must keep, with what it needs.

    Args:
        name: of the recipe and its formula.
        formula: its text, in one line.
        description: what it says.
        severity: of its violation, `warning` or `error`.
        area: the kind of robots, such as `ground`.
        problem: what goes wrong without it, in a sentence.
        source: where the problem comes from.
        url: of the source; empty for none.
        note: what to know about it; may be empty.
        satisfied: a trace that the formula holds for, in CSV.
        violated: a trace that it is false for.
        violated_at: the time of the state of that trace at which it is false, in nanoseconds.
        topics: the types of the topics that it needs.
        parts: of a robot.yaml.
    """

    name: str
    formula: str
    description: str
    severity: str
    area: str
    problem: str
    source: str
    url: str
    note: str
    satisfied: str
    violated: str
    violated_at: int
    topics: Mapping[str, str] = field(default_factory=dict)
    parts: tuple[RobotPart, ...] = ()

    @property
    def robot(self) -> str:
        """The recipe as a robot.yaml."""
        found = []
        for section in SECTIONS:
            lines = [each.lines(2) for each in self.parts if each.section == section]
            found += [f'{section}:\n', *lines] if lines else []
        return ''.join(found)

    @property
    def searched(self) -> str:
        """All texts in which words are searched, in lower case."""
        texts = (self.name, self.area, self.problem, self.description, self.source, self.note)
        return '\n'.join((*texts, self.robot, *self.topics.values())).lower()

    def renamed(self, names: Mapping[str, str]) -> Recipe:
        """Return the recipe with other names of sorts, objects, constants, features and formulas.

        Raises:
            ConfigurationError: if the recipe has no such name, or a new one is none.
        """
        lists = (each.text for each in self.parts if each.section == 'objects')
        known = {each.name for each in self.parts if each.section != 'streams'}
        known |= {word for text in lists for word in _WORD.findall(text)}
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
    values = {key.text(): each for key, each in read_yaml(CATALOGUE).entries('sections')}
    library = [
        *_entries('constants', values['constants']),
        *_entries('features', values['features']),
        *(_stream_part(each) for each in values['streams'].items()),
    ]
    types = {key.text(): each.text() for key, each in values['types'].entries('types')}
    recipes = (_recipe(each, library, types) for each in values['recipes'].items())
    return {each.name: each for each in recipes}


def _recipe(value: YamlValue, library: Iterable[RobotPart], types: Mapping[str, str]) -> Recipe:
    stated = {key.text(): each for key, each in value.entries('a recipe')}
    last = [each for key, each in stated.items() if key in _FORMULA_KEYS][-1]
    formula = RobotPart('formulas', stated['name'].line(), _source(value, last))
    objects = stated['objects'].plain() if 'objects' in stated else {}
    sorts = (
        RobotPart('objects', sort, f'{sort}: [{", ".join(names)}]')
        for sort, names in objects.items()
    )
    parts = (*sorts, *_named(stated['formula'].line(), library), formula)
    text = '\n'.join(each.text for each in parts)
    needed = {topic: each for topic, each in types.items() if _is_named(topic, text)}
    plain: dict[str, Any] = {
        key: each.line() if key not in {'satisfied', 'violated'} else each.text()
        for key, each in stated.items()
        if key not in {'objects', 'violated_at'}
    }
    given = {'severity': 'warning', 'url': '', 'note': '', **plain}
    at = stated['violated_at'].duration()
    return Recipe(**given, violated_at=at, topics=needed, parts=parts)


def _named(formula: str, library: Iterable[RobotPart]) -> list[RobotPart]:
    """Return the parts that a formula names, and those that these name."""
    words = {*_WORD.findall(formula)}
    texts = [each.text for each in library if each.name in words]
    streams = [each for each in library if each.section == 'streams']
    texts += [each.text for each in streams if any(each.name in text for text in texts)]
    found = [each for each in streams if any(each.name in text for text in texts)]
    return [each for each in library if each.name in words or each in found]


def _entries(section: str, value: YamlValue) -> Iterable[RobotPart]:
    for key, each in value.entries('a mapping'):
        yield RobotPart(section, key.text(), _source(key, each))


def _stream_part(value: YamlValue) -> RobotPart:
    text = _source(value, value)
    found = _STREAM_NAME.search(text)
    return RobotPart('streams', found['sink'] or found['unit'] if found else '', text)


def _source(first: YamlValue, last: YamlValue) -> str:
    """Return the lines of the file from one value to the end of another, without indentation."""
    begin = first.node.start_mark
    lines = first.document.text[begin.index : last.end].rstrip().split('\n')
    return '\n'.join([lines[0], *(each[begin.column :] for each in lines[1:])])


def _is_named(topic: str, text: str) -> bool:
    return bool(re.search(rf'(?<![\w/}}]){re.escape(topic)}(?![\w/])', text))
