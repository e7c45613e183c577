"""Scopes of the names that a canonical text binds: the coordinator does not parse formulas.

Type checking gives each name of a formula one meaning: a variable, a kept value, an object or a
feature. Only a variable may also have the name of a sort. So a name is bound at most once at each
position, and all its uses are in the scopes of its binders.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from dyknow_common import unused_name
from dyknow_coordinator.errors import CoordinationError

NAME: Final = r"[A-Za-z_]\w*'*"
"""The pattern of the name of an object or a variable."""

_TEXT: Final = re.compile(r'"(?:\\.|[^"\\])*"')
# An interval whose brackets differ, such as `(0 s, 5 s]`.
_UNEVEN: Final = re.compile(r'\[([^()\[\]]*)\)|\(([^()\[\]]*)\]')
_TOKEN: Final = re.compile(
    r'(?P<opening>[\[(])|(?P<closing>[\])])|(?P<comma>,)'
    r"|(?<![\w.'])(?:forall|exists|(?:at least|at most|exactly) [0-9]+) "
    rf'(?P<variable>{NAME})(?: in (?P<sort>{NAME}))?:'
    rf'| for (?P<first>{NAME})(?:, (?P<second>{NAME}))?(?: in (?P<domain>{NAME}))?(?=\))'
    rf'| from {NAME} to (?P<place>{NAME}):'
    rf"|(?<![\w.'])let (?P<kept>{NAME}) ="
)
_WORDS: Final = frozenset(
    {'at', 'by', 'contains', 'does', 'exactly', 'for', 'from', 'hops', 'inf', 'least', 'most', 'of'}
    | {'over', 'soon', 'starts', 'to', 'with'}
)
"""Words of canonical texts that are no reserved words."""


@dataclass(slots=True, eq=False)
class Binder:
    """A variable or a kept value.

    Args:
        name: its name.
        sort: the sort of the variable, empty if the text does not give it; None for a kept value.
        position: the position of the name, where it is bound.
        start: the start of the text in which it is bound.
        end: the end of that text.
    """

    name: str
    sort: str | None
    position: int
    start: int
    end: int


@dataclass(slots=True)
class _Level:
    """A pair of brackets, and the binders whose scope ends with it."""

    start: int
    binders: list[Binder] = field(default_factory=list)


class Scopes:
    """The names that a formula binds.

    Args:
        formula: its canonical text.
    """

    def __init__(self, formula: str) -> None:
        self.formula = formula
        """The canonical text."""
        self.text = _masked(formula)
        """The formula with quotes in place of each text in quotes, at the same positions."""
        self.binders = tuple(sorted(_binders(self.text), key=lambda each: each.position))
        self._named: dict[str, list[Binder]] = {}
        for each in self.binders:
            self._named.setdefault(each.name, []).append(each)

    @property
    def names(self) -> frozenset[str]:
        """The names of all variables and kept values."""
        return frozenset(self._named)

    @property
    def sorts(self) -> list[str]:
        """The sorts of all variables, each once."""
        return sorted({each.sort for each in self.binders if each.sort})

    def binder(self, name: str, position: int) -> Binder | None:
        """Return what binds a name at a position; None for an object or a feature."""
        for each in self._named.get(name, ()):
            if each.position == position or each.start <= position < each.end:
                return each
        return None

    def renamed(self, names: Mapping[str, str]) -> str:
        """Return the formula in which some variables and kept values have other names.

        Raises:
            CoordinationError: for a name that is also a word of the language.
        """
        for name in sorted(_WORDS & names.keys()):
            raise CoordinationError(f"'{name}' is a variable and a region; rename the variable")
        bound = {each.position for each in self.binders}
        pattern = re.compile(rf"(?<![\w.'])(?:{'|'.join(map(re.escape, names))})(?![\w.'\[(])")
        parts, end = [], 0
        for found in pattern.finditer(self.text):
            start = found.start()
            # The name may be the unit of a time or a sort, but for where it is bound.
            before = self.text[max(0, start - 4) : start]
            is_other = before.endswith(' in ') or re.search('[0-9] $', before)
            if start in bound or (not is_other and self.binder(found[0], start)):
                parts += [self.formula[end:start], names[found[0]]]
                end = found.end()
        return ''.join(parts) + self.formula[end:]

    def unused_name(self, name: str, others: frozenset[str]) -> str:
        """Return a name like another one that neither the formula nor some other names contain."""
        return unused_name(name, {*re.findall(NAME, self.formula), *others})


def _masked(formula: str) -> str:
    text = _TEXT.sub(lambda found: '"' * len(found[0]), formula)
    return _UNEVEN.sub(lambda found: f'[{found[1] or found[2]}]', text)


def _binders(text: str) -> Iterator[Binder]:
    """Yield the binders, each when its scope ends."""
    levels, links = [_Level(0)], ''
    for token in _TOKEN.finditer(text):
        level = levels[-1]
        if token['opening']:
            levels.append(_Level(token.end()))
        elif token['closing']:
            yield from _ended(levels.pop(), token.start())
        elif token['comma']:
            yield from _ended(level, token.start())
        elif token['first']:
            links = token['domain'] or ''
            for each in ('first', 'second'):
                if token[each]:
                    yield Binder(token[each], links, token.start(each), level.start, token.start())
        else:
            kind = str(token.lastgroup if token['sort'] is None else 'variable')
            sort = {'variable': token['sort'] or '', 'place': links, 'kept': None}[kind]
            binder = Binder(token[kind], sort, token.start(kind), token.end(), len(text))
            level.binders.append(binder)
    for level in levels:
        yield from level.binders


def _ended(level: _Level, end: int) -> Iterator[Binder]:
    for each in level.binders:
        each.end = end
        yield each
    level.binders.clear()
