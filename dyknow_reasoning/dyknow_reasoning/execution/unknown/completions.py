"""The possible values of an unknown feature: one representative of each case that atoms tell apart.

A number is compared with constants and with other features. Atoms can only tell its order relative
to these, so the number has one representative for each place between them. For x in `x > 1 and
x < y`, with y = 3 known, the representatives are 0, 1, 2, 3 and 4. If y is unknown, too, it is
chosen relative to the x that was chosen before. As numbers are dense, this finds each order.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain, combinations, pairwise
from math import inf, isinf
from typing import Any, Final

from dyknow_common import COMPARISONS, MIRRORED_COMPARISONS, Value
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import Atom, Comparison, PastAtom
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Number,
    Object,
    StateCount,
    TextLiteral,
    Truth,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds, kind_of, valued
from dyknow_reasoning.progression.unknown_features import Range, UnknownFeatures, UnknownValueError

_Literals = Number | TextLiteral | Truth | Object
_SEPARATOR: Final = '\x00'
"""In no text of a formula or a message."""

_MAX_PARTS: Final = 10
"""The most parts that a text may be searched for: 2 ** 10 combinations are tried."""


class Completions:
    """The cases of the values of the features in some atoms.

    Args:
        atoms: the atoms that read the values, for which `is_exact` is True.
        kinds: the kinds of the features.
        unknown: the bounds of the features.
    """

    def __init__(self, atoms: Iterable[Atom], kinds: Kinds, unknown: UnknownFeatures) -> None:
        self._unknown = unknown
        # What each feature is compared with, and its kind.
        self._tests: defaultdict[str, dict[tuple[str, Value], None]] = defaultdict(dict)
        self._kinds: dict[str, Kind] = {}
        # The features that each feature is compared with, directly or through others; and itself.
        self._linked: dict[str, set[str]] = {}
        # Representatives within the latest bounds.
        self._found: dict[str, tuple[Range, Sequence[Any]]] = {}
        for atom in atoms:
            self._add(atom, kinds)

    def options(
        self, name: str, values: Mapping[str, Any], errors: Mapping[str, UnknownValueError]
    ) -> Sequence[Any]:
        """Return the representatives of an unknown feature.

        Args:
            name: the feature.
            values: the values that are known, or were chosen before.
            errors: the errors of the features that are unknown.
        """
        linked = self._linked.get(name, {name})
        ranges = {
            each: (each in errors and errors[each].bounds) or self._unknown.range_of(each)
            for each in sorted(linked)
        }
        if len(linked) == 1:
            former, found = self._found.get(name, (None, ()))
            if former != ranges[name]:
                found = self._distinct(name, self._representatives(name, (), ranges))
                self._found[name] = ranges[name], found
            return found
        others = [values[each] for each in linked if each != name and each in values]
        return self._representatives(name, others, ranges)

    def _add(self, atom: Atom, kinds: Kinds) -> None:
        match atom.formula if isinstance(atom, PastAtom) else atom:
            case Feature() | FieldReference() as truth:
                self._kinds[str(truth)] = Kind.BOOLEAN
            case Comparison(symbol, left, right):
                sides = valued(left), valued(right)
                for feature, operator, other in (
                    (sides[0], symbol, sides[1]),
                    (sides[1], MIRRORED_COMPARISONS.get(symbol, symbol), sides[0]),
                ):
                    if not isinstance(feature, Feature | FieldReference):
                        continue
                    kind = Kind.STRING if isinstance(other, Object) else kind_of(feature, kinds)
                    self._kinds[str(feature)] = kind or Kind.NUMBER
                    if isinstance(other, Feature | FieldReference):
                        self._link(str(feature), str(other))
                    elif isinstance(other, _Literals):
                        value = other.name if isinstance(other, Object) else other.value
                        self._tests[str(feature)][operator, value] = None

    def _link(self, first: str, second: str) -> None:
        joined = self._linked.get(first, {first}) | self._linked.get(second, {second})
        self._linked.update(dict.fromkeys(joined, joined))

    def _representatives(
        self, name: str, others: Sequence[Any], ranges: Mapping[str, Range]
    ) -> Sequence[Any]:
        tests = list(chain.from_iterable(self._tests[each] for each in ranges))
        match self._kinds.get(name):
            case Kind.BOOLEAN:
                return (False, True)
            case Kind.STRING:
                return _texts(tests, others)
            case _:
                ends = chain.from_iterable(ranges.values())
                pins = {*(value for _, value in tests), *others, *ends}
                return _numbers(pins, ranges[name])

    def _distinct(self, name: str, found: Sequence[Any]) -> Sequence[Any]:
        """Return one value of each set that no test tells apart."""
        tests = [(COMPARISONS[symbol], value) for symbol, value in self._tests[name]]
        if self._kinds.get(name) is Kind.BOOLEAN:
            return found
        alike = {tuple(holds(each, value) for holds, value in tests): each for each in found}
        return tuple(alike.values())


def is_exact(atom: Atom, kinds: Kinds) -> bool:
    """Return True if the truth of an atom follows from representatives.

    Other atoms calculate, or compare values of the past with values that are not constant.
    """
    match atom:
        case Feature() | FieldReference():
            return True
        case Comparison(symbol, left, right):
            sides = left, right
            if not all(isinstance(each, Feature | FieldReference | _Literals) for each in sides):
                return False
            features = [each for each in sides if isinstance(each, Feature | FieldReference)]
            if symbol not in MIRRORED_COMPARISONS:
                return len(features) == 1 and features[0] is left
            return len(features) == 1 or all(kind_of(each, kinds) for each in features)
        case PastAtom(Comparison(_, left, right)):
            sides = left, right
            return any(isinstance(each, _Literals) for each in sides) and all(
                isinstance(valued(each), Feature | FieldReference | _Literals | StateCount)
                for each in sides
            )
        case _:
            return True  # The operands of other past operators have atoms of their own.


def _numbers(pins: Iterable[Any], bounds: Range) -> Sequence[float]:
    """Return the pins within bounds, and a number at each place between and beside them."""
    low, high = bounds
    found = sorted(each for each in pins if low <= each <= high and not isinf(each))
    if not found:
        return (0.0,)
    edges = [*([-inf] if isinf(low) else ()), *found, *([inf] if isinf(high) else ())]
    return sorted({*found, *(_between(*pair) for pair in pairwise(edges))})


def _between(low: float, high: float) -> float:
    if isinf(low):
        return high - max(1.0, abs(high))
    if isinf(high):
        return low + max(1.0, abs(low))
    return low / 2 + high / 2


def _texts(tests: Iterable[tuple[str, Any]], others: Sequence[str]) -> Sequence[str]:
    """Return texts for each combination of tested values, prefixes and contained parts.

    A text with the longest prefix p and with some parts behaves like p and these parts with
    separators between them. More separators tell it from texts that were chosen before.
    """
    tests = list(tests)
    equal = {value for symbol, value in tests if symbol in {'=', '!='}}
    prefixes = {'', *(value for symbol, value in tests if 'start' in symbol)}
    parts = sorted({value for symbol, value in tests if 'contain' in symbol})
    if len(parts) > _MAX_PARTS:
        raise ReasoningError(
            f'an unknown text is searched for {len(parts)} parts, more than {_MAX_PARTS}; ask for '
            'fewer in one formula'
        )
    chosen = chain.from_iterable(combinations(parts, size) for size in range(len(parts) + 1))
    end = _SEPARATOR * (1 + len(others))
    made = {_SEPARATOR.join((prefix, *some)) + end for some in chosen for prefix in prefixes}
    return sorted({*equal, *others, *made})
