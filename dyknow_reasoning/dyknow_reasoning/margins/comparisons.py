"""Margins of comparisons, and of other atoms, at a state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

from dyknow_common import COMPARISONS, TEXT_COMPARISONS
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import Atom, Comparison
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Number,
    Object,
)
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.margins.operators import HIGHEST, LOWEST, Robustness
from dyknow_reasoning.progression.atoms import (
    NEGATED_COMPARISONS,
    Values,
    predicate,
    term_reader,
)

MarginReader: TypeAlias = Callable[[Values], Robustness | None]
"""The margin of an atom at a state; None if the values are unusable."""

_DISTANCES: dict[str, Callable[[Any, Any], Any]] = {
    '>': lambda left, right: left - right,
    '>=': lambda left, right: left - right,
    '<': lambda left, right: right - left,
    '<=': lambda left, right: right - left,
    '=': lambda left, right: -abs(left - right),
    '!=': lambda left, right: abs(left - right),
}


def margin_reader(atom: Atom, kinds: Kinds, number: int, *, positive: bool) -> MarginReader:
    """Return the margin of an atom without variables.

    It is the distance of the two sides of a comparison of numbers, and infinite for other atoms.

    Args:
        atom: the atom.
        kinds: the kinds of features, from `check_types`.
        number: the number of the atom, which is returned with its margin.
        positive: False for the margin of its negation.
    """
    if not isinstance(atom, Comparison) or atom.operator in TEXT_COMPARISONS:
        return _truth(atom, kinds, positive=positive)
    operator = atom.operator if positive else NEGATED_COMPARISONS[atom.operator]
    left, right = atom.left, atom.right
    slow = _comparison(Comparison(operator, left, right), kinds, number)
    if isinstance(right, Number) and isinstance(left, Feature | FieldReference):
        if operator in {'>', '>='}:
            return _above(str(left), right.value, number, slow)
        if operator in {'<', '<='}:
            return _below(str(left), right.value, number, slow)
    return slow


def _above(name: str, limit: float, number: int, slow: MarginReader) -> MarginReader:
    """Return the margin of the commonest comparison, for plain floats; others are `slow`."""

    def read(values: Values) -> Robustness | None:
        value = values.get(name)
        if type(value) is float:
            margin = value - limit
            if margin == margin:  # noqa: PLR0124 - not NaN
                return margin, number
        return slow(values)

    return read


def _below(name: str, limit: float, number: int, slow: MarginReader) -> MarginReader:
    def read(values: Values) -> Robustness | None:
        value = values.get(name)
        if type(value) is float:
            margin = limit - value
            if margin == margin:  # noqa: PLR0124 - not NaN
                return margin, number
        return slow(values)

    return read


def _truth(atom: Atom, kinds: Kinds, *, positive: bool) -> MarginReader:
    holds = predicate(atom, kinds)

    def read(values: Values) -> Robustness | None:
        try:
            return HIGHEST if holds(values) is positive else LOWEST
        except ReasoningError:
            return None

    return read


def _comparison(atom: Comparison, kinds: Kinds, number: int) -> MarginReader:
    if isinstance(atom.left, Object) and isinstance(atom.right, Object):
        same = HIGHEST if COMPARISONS[atom.operator](atom.left.name, atom.right.name) else LOWEST
        return lambda _: same
    left, right = term_reader(atom.left, kinds), term_reader(atom.right, kinds)
    distance, truth = _DISTANCES[atom.operator], _truth(atom, kinds, positive=True)

    def read(values: Values) -> Robustness | None:
        try:
            first, second = left(values), right(values)
            if not (_is_number(first) and _is_number(second)):
                return truth(values)
            margin = distance(first, second)
        except (ReasoningError, OverflowError):
            return None
        return (margin, number) if margin == margin else None  # noqa: PLR0124 - not NaN

    return read


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
