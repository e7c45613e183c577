"""Symbols of formulas, which are grounded before its evaluation, and names that are no symbols."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator
from dataclasses import dataclass
from enum import IntEnum
from itertools import chain, count
from typing import Final

FORMULA_WORDS: Final = frozenset(
    {'true', 'false', 'not', 'and', 'or', 'forall', 'exists', 'in', 'always', 'eventually'}
    | {'until', 'U', 'unless', 'release', 'historically', 'once', 'since', 'previous', 'let'}
)
"""The reserved words of formulas; a test compares them with the grammar."""

NOT_CALIBRATED: Final = '_not_calibrated'
"""The end of the name of a stream that holds a bound of a forecast without a calibration."""

SSL_WORDS: Final = frozenset({'for', 'where', 'with', 'contains'})
"""The reserved words of annotations; a test compares them with the grammar."""

FUNCTIONS: Final = frozenset(
    {'abs', 'max', 'maximum', 'mean', 'min', 'minimum', 'sqrt', 'sum', 'hypot', 'angle_difference'}
)
"""Names of functions, which no feature and no stream may have."""

_QUOTED: Final = r'"(?:[^"\\]|\\.)*"'
_BUILT_IN: Final = r"""(?:tf|action|rate)\("[^"]+"(?:, (?:"[^"]+"|[^",()]+))*\)"""
_REFERENCE: Final = re.compile(
    rf"""(?P<function>\w+\((?!"[^"]+"[,)]))?(?P<stream>{_BUILT_IN}|"[^"]+"|[\w']+)\.(?P<path>.+)""",
    re.ASCII | re.DOTALL,
)


def numbered_names(name: str) -> Iterator[str]:
    """Yield a name, then `name_2`, `name_3` and so on, for one that may be taken."""
    return chain([name], (f'{name}_{number}' for number in count(2)))


class NumberedNames(dict[str, Iterator[str]]):
    """The `numbered_names` of each name that were not tried yet: thousands may have one name."""

    def __missing__(self, name: str) -> Iterator[str]:
        """Begin with a name."""
        found = self[name] = numbered_names(name)
        return found


def unused_name(name: str, taken: Container[str]) -> str:
    """Return the first of the `numbered_names` that is not taken."""
    return next(each for each in numbered_names(name) if each not in taken)


class SymbolKind(IntEnum):
    """The kind of a symbol; numbers as in dyknow_interfaces/msg/Symbol."""

    FEATURE = 0
    SORT = 1
    OBJECT = 2


@dataclass(frozen=True, slots=True)
class Symbol:
    """A feature, a sort or an object that a formula mentions.

    The `str` of a ground feature is the name of its field in a state, `XYDist[uav1, uav2]`.

    A quantifier without a sort, `forall u: ...`, has the sort `?u`: the sort that the features of
    `u` declare.

    Args:
        kind: feature, sort or object.
        name: its name; of a syntactic reference, the canonical text, `uav1_power.power`.
        arguments: for a feature, its objects, and for variables, the sorts they range over.
    """

    kind: SymbolKind
    name: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f'{self.name}[{", ".join(self.arguments)}]' if self.arguments else self.name

    @property
    def is_reference(self) -> bool:
        """True if the symbol names a stream and a field itself."""
        return self.kind is SymbolKind.FEATURE and '.' in self.name

    @property
    def reference(self) -> tuple[str, str]:
        """The stream and the field that a reference names, as texts of the stream language."""
        found = _REFERENCE.fullmatch(self.name)
        if found is None:
            raise ValueError(self.name)
        # Joined conditions name the stream again: count(s.a > 1 and s.b < 3)
        again = rf'({_QUOTED})|(\b(?:and|or) ){re.escape(found["stream"])}\.'
        path = re.sub(again, r'\1\2', found['path'])
        return found['stream'], f'{found["function"] or ""}{path}'

    @property
    def may_be_stream(self) -> bool:
        """True if the symbol can be the name of a stream."""
        return self.kind is SymbolKind.FEATURE and not self.arguments
