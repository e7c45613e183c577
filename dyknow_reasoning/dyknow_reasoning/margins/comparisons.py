"""Margins of comparisons, and of other atoms, at a state.

The margin of an atom is the distance of the two sides of a comparison of numbers; it is infinite
for other atoms.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from math import inf, isfinite, isnan
from operator import itemgetter
from struct import Struct
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from dyknow_common import TEXT_COMPARISONS
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import NEGATED_COMPARISONS, Atom, Comparison
from dyknow_reasoning.language.terms import Feature, FieldReference, Number
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.margins.robustness import HIGHEST, LOWEST, Robustness, vector
from dyknow_reasoning.progression.atoms import (
    MAX_GENERATED,
    NoStateBeforeError,
    Values,
    generated_reader,
    predicate,
    term_reader,
)
from dyknow_reasoning.progression.routes import Array
from dyknow_reasoning.progression.unknown_features import ANY_NUMBER, Range, RangeOf, bounded_sides

UNUSABLE = ReasoningError, OverflowError
"""The errors of a reader where the values are unusable."""

MarginReader: TypeAlias = Callable[[Values], Any]
"""The margin of an atom at a state, or an array of margins for objects; raises `UNUSABLE`."""

_DISTANCES: dict[str, Callable[[Any, Any], Any]] = {
    '>': lambda left, right: left - right,
    '>=': lambda left, right: left - right,
    '<': lambda left, right: right - left,
    '<=': lambda left, right: right - left,
    '=': lambda left, right: -abs(left - right),
    '!=': lambda left, right: abs(left - right),
}

_EXACT_LIMIT = 1 << 53
"""Integers up to this one are exact as floats."""


class SignedAtom(NamedTuple):
    """An atom without variables, or its negation.

    Args:
        atom: the atom.
        number: its number, which is returned with its margin.
        positive: False for the negation.
    """

    atom: Atom
    number: int
    positive: bool


class AtomMargins:
    """The margins of some atoms.

    Args:
        atoms: the atoms.
        kinds: the kinds of features, from `check_types`.

    Attributes:
        read: returns the margin at a state, of several atoms as an array.
        limits: what each atom compares, if it is of the commonest form.
    """

    def __init__(self, atoms: Sequence[SignedAtom], kinds: Kinds) -> None:
        self.atoms, self._kinds = atoms, kinds
        self.limits = [limit_of(each) for each in atoms]
        self._readers = readers = [_reader(each, kinds) for each in atoms]
        self.read = readers[0] if len(atoms) == 1 else _array_reader(readers, self.limits, atoms)

    def read_usable(self, values: Values, unknown: Robustness, range_of: RangeOf) -> Any:
        """Return the margin at a state, or a bound of it where the values are unusable.

        Args:
            values: the values of the features; an UnknownValueError for an unknown value.
            unknown: the least margin for a lower bound, the greatest margin for an upper bound.
            range_of: returns the bounds of an unknown feature.
        """
        found = []
        for read, atom in zip(self._readers, self.atoms, strict=True):
            try:
                found.append(read(values))
            except UNUSABLE:
                low, high = _bounds(atom, values, range_of, self._kinds)
                bound = low if unknown is LOWEST else high
                infinite = HIGHEST if bound > 0 else LOWEST
                found.append((bound, atom.number) if isfinite(bound) else infinite)
        return found[0] if len(found) == 1 else vector(found)


class LinkSignal:
    """The lengths of links at a state.

    Args:
        readers: read the lengths, one reader for each choice of other objects.
    """

    def __init__(self, readers: Sequence[Callable[[Values], Array]]) -> None:
        self._readers = readers

    def read(self, values: Values) -> list[Array]:
        """Return the lengths; raise ReasoningError where values are unusable."""
        known = {each: each(values) for each in self._readers}
        return [known[each] for each in self._readers]

    def read_usable(self, values: Values, unknown: Robustness, range_of: RangeOf) -> Any:  # noqa: ARG002
        """Return the lengths, or the margin of all operators over unusable ones."""
        try:
            return self.read(values)
        except UNUSABLE:
            return unknown


StateReader: TypeAlias = AtomMargins | LinkSignal
"""Reader of a signal that the operators of a formula need of a state."""


def signals_reader(signals: Sequence[StateReader]) -> Callable[[Values], Sequence[Any]]:
    """Return a function that returns all signals at a state; it raises `UNUSABLE`.

    It is generated code, which reads each field once. Unusual values are left to the signals.
    """
    names: dict[str, Any] = {f'read_{index}': each.read for index, each in enumerate(signals)}
    margins = [f'{each}(values)' for each in names]
    fields: dict[str, str] = {}
    for index, each in enumerate(signals):
        if isinstance(each, AtomMargins) and len(each.limits) == 1 and (limit := each.limits[0]):
            field = fields.setdefault(limit.field, f'field_{len(fields)}')
            names[f'number_{index}'] = float(limit.number)
            sides = (field, f'number_{index}') if limit.is_above else (f'number_{index}', field)
            margins[index] = f'({" - ".join(sides)}, {each.atoms[0].number})'

    def careful(values: Values) -> Sequence[Any]:
        return [each.read(values) for each in signals]

    if not 0 < len(fields) <= MAX_GENERATED:
        return careful
    unusual = ' or '.join(
        f'type({each}) is not float or {each} != {each}' for each in fields.values()
    )
    variables = {variable: field for field, variable in fields.items()}
    return generated_reader(variables, unusual, f'[{", ".join(margins)}]', names, careful)


def _bounds(signed: SignedAtom, values: Values, range_of: RangeOf, kinds: Kinds) -> Range:
    """Return the bounds of the margin of an atom for all that unknown values may be."""
    atom, _, positive = signed
    if not isinstance(atom, Comparison) or atom.operator not in _DISTANCES:
        return ANY_NUMBER
    operator = atom.operator if positive else NEGATED_COMPARISONS[atom.operator]
    try:
        sides = bounded_sides(atom, values, range_of, kinds)
        if sides is None:
            return ANY_NUMBER
        distances = [_DISTANCES[operator](*each) for each in product(*sides)]
    except NoStateBeforeError:
        return (-inf, -inf) if positive else (inf, inf)
    except UNUSABLE:
        return ANY_NUMBER
    if any(map(isnan, distances)):
        return ANY_NUMBER
    (low, high), (least, most) = sides
    if operator in {'=', '!='} and low <= most and least <= high:
        distances.append(0.0)
    return min(distances), max(distances)


class _Limit(NamedTuple):
    """A comparison of a field with a number, the commonest one: the field should be above it."""

    field: str
    number: float
    is_above: bool


def limit_of(signed: SignedAtom) -> _Limit | None:
    """Return what an atom compares; None if it is of another form."""
    atom, _, positive = signed
    if (
        isinstance(atom, Comparison)
        and isinstance(atom.left, Feature | FieldReference)
        and isinstance(atom.right, Number)
        and atom.operator in {'<', '<=', '>', '>='}
        and abs(atom.right.value) <= _EXACT_LIMIT
    ):
        is_above = (atom.operator in {'>', '>='}) is positive
        return _Limit(str(atom.left), atom.right.value, is_above)
    return None


def _reader(signed: SignedAtom, kinds: Kinds) -> MarginReader:
    """Return the margin of an atom."""
    atom, number, positive = signed
    if not isinstance(atom, Comparison) or atom.operator in TEXT_COMPARISONS:
        return _truth(atom, kinds, positive=positive)
    operator = atom.operator if positive else NEGATED_COMPARISONS[atom.operator]
    margin = _comparison(Comparison(operator, atom.left, atom.right), kinds, number)
    return _false_without_past(margin, positive=positive)


def _false_without_past(margin: MarginReader, *, positive: bool) -> MarginReader:
    """Return the margin of an atom that is false where it needs a state before the first one."""

    def read(values: Values) -> Any:
        try:
            return margin(values)
        except NoStateBeforeError:
            return LOWEST if positive else HIGHEST

    return read


def _array_reader(
    readers: Sequence[MarginReader], limits: Sequence[_Limit | None], atoms: Sequence[SignedAtom]
) -> MarginReader:
    """Return the margins of several atoms, at once if all values are numbers."""

    def slow(values: Values) -> Any:
        return vector([read(values) for read in readers])

    known = [each for each in limits if each is not None]
    if len(known) < len(limits):
        return slow
    fields = {name: place for place, name in enumerate(dict.fromkeys(e.field for e in known))}
    choose = itemgetter(*fields, known[0].field)  # At least two, for a tuple.
    pack = Struct(f'{len(fields) + 1}d').pack
    places = np.array([fields[each.field] for each in known])
    bounds = np.array([each.number for each in known], float)
    signs = np.array([1.0 if each.is_above else -1.0 for each in known])
    template = vector([(0.0, each.number) for each in atoms])

    def read(values: Values) -> Any:
        try:
            row = choose(values)
        except KeyError:
            return slow(values)
        types = set(map(type, row))
        is_exact = types == {float} or (
            types <= {float, int} and max(map(abs, row)) <= _EXACT_LIMIT
        )
        if not is_exact or isnan(sum(row)):
            return slow(values)
        found = template.copy()
        found.real = (np.frombuffer(pack(*row))[places] - bounds) * signs
        return found

    return read


def _truth(atom: Atom, kinds: Kinds, *, positive: bool) -> MarginReader:
    holds = predicate(atom, kinds)
    return lambda values: HIGHEST if holds(values) is positive else LOWEST


def _comparison(atom: Comparison, kinds: Kinds, number: int) -> MarginReader:
    left, right = term_reader(atom.left, kinds), term_reader(atom.right, kinds)
    distance, truth = _DISTANCES[atom.operator], _truth(atom, kinds, positive=True)

    def read(values: Values) -> Robustness:
        first, second = left(values), right(values)
        if not (_is_number(first) and _is_number(second)):
            found: Robustness = truth(values)
            return found
        margin = distance(first, second)
        if margin != margin:  # noqa: PLR0124 - NaN
            raise ReasoningError(f"'{atom}' has no margin: a side is not a number, or infinite")
        return margin, number

    return read


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
