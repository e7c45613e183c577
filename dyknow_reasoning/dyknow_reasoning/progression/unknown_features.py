"""Which features may be unknown at a state, and the bounds of what is calculated with them.

Bounds are found by interval arithmetic. Rounding is monotone, so results at the ends of intervals
bound all other results in floats, too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import inf, isnan, nextafter
from typing import Any, Final, TypeAlias

from dyknow_common import COMPARISONS, MIRRORED_COMPARISONS
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import Atom, Comparison
from dyknow_reasoning.language.terms import Arithmetic, Feature, FieldReference, Function, Term
from dyknow_reasoning.language.type_checking import Kind, Kinds, kind_of
from dyknow_reasoning.progression.atoms import CALCULATE, Values, predicate, term_reader
from dyknow_reasoning.progression.functions import call_function, hypotenuse

Range: TypeAlias = tuple[float, float]
"""The least and the greatest value of a number."""

ANY_NUMBER: Range = -inf, inf

RangeOf: TypeAlias = Callable[[str], Range]
"""Returns the bounds of an unknown feature."""


@dataclass(frozen=True, slots=True)
class UnknownFeatures:
    """The features that may be unknown: absent from a state, None, or not a number.

    Args:
        ranges: the least and the greatest value of each numeric feature, by name, `Charge`;
            `ANY_NUMBER` for a feature without bounds, or of another kind.
        all_may_be: True if features that are not in `ranges` may be unknown, too.
    """

    ranges: Mapping[str, Range] = field(default_factory=dict)
    all_may_be: bool = False

    def __bool__(self) -> bool:
        return self.all_may_be or bool(self.ranges)

    def range_of(self, name: str) -> Range:
        """Return the bounds of a ground feature."""
        return self.ranges.get(_feature(name), ANY_NUMBER)

    def may_be(self, name: str) -> bool:
        """Return True if a ground feature may be unknown."""
        return self.all_may_be or _feature(name) in self.ranges

    def marked(self, names: Iterable[str], values: Values) -> Values:
        """Return the values of a state, with an UnknownValueError for each unknown value."""
        found: dict[str, Any] = dict(values)
        found.update({name: UnknownValueError(name) for name in self.among(names, values)})
        return found

    def among(self, names: Iterable[str], values: Values) -> list[str]:
        """Return the ground features that are unknown at a state."""
        return [name for name in names if is_unknown(values.get(name)) and self.may_be(name)]


ALL_KNOWN: Final = UnknownFeatures()


class UnknownValueError(ReasoningError):
    """A value is needed, but unknown.

    Args:
        name: the ground feature.
        bounds: the bounds of the value at this state; None: the bounds of the feature.
    """

    def __init__(self, name: str, bounds: Range | None = None) -> None:
        super().__init__(f"the value of '{name}' is unknown")
        self.name, self.bounds = name, bounds


def is_unknown(value: Any) -> bool:
    """Return True for None and NaN; only NaN differs from itself."""
    return value is None or bool(value != value)  # noqa: PLR0124


def _feature(name: str) -> str:
    return name if name.startswith('"') else name.partition('[')[0]


def bounded_truth(atom: Atom, values: Values, range_of: RangeOf, kinds: Kinds) -> bool | None:
    """Return the truth of a comparison of numbers for all unknown values; None if it differs.

    Args:
        atom: the comparison; other atoms have no bounds.
        values: the values of the features; an UnknownValueError for an unknown value.
        range_of: returns the bounds of an unknown feature.
        kinds: the kinds of the features.

    Raises:
        ReasoningError: for a value that is unusable.
    """
    sides = isinstance(atom, Comparison) and bounded_sides(atom, values, range_of, kinds)
    if not (isinstance(atom, Comparison) and sides):
        return None
    (low, high), (least, most) = sides
    if atom.operator in {'=', '!='}:
        is_one = low == high == least == most
        is_known = is_one or high < least or low > most
        return is_one == (atom.operator == '=') if is_known else None
    compare = COMPARISONS[atom.operator]  # Which is monotone, so the ends tell.
    truths = {bool(compare(low, most)), bool(compare(high, least))}
    return truths.pop() if len(truths) == 1 else None


def bounded_sides(
    atom: Comparison, values: Values, range_of: RangeOf, kinds: Kinds
) -> tuple[Range, Range] | None:
    """Return the bounds of both sides of a comparison; None if they are no numbers.

    Arguments as of `bounded_truth`.
    """
    sides = atom.left, atom.right
    are_numbers = Kind.NUMBER in {kind_of(each, kinds) for each in sides}  # Of one, so of both.
    if atom.operator not in MIRRORED_COMPARISONS or not are_numbers:
        return None
    left, right = (_bounds(each, values, range_of, kinds) for each in sides)
    return left, right


def _bounds(term: Term | Comparison, values: Values, range_of: RangeOf, kinds: Kinds) -> Range:
    try:
        found = term_reader(term, kinds)(values)
    except UnknownValueError as error:
        bounds = error.bounds
    else:
        return found, found
    match term:
        case Feature() | FieldReference():
            return bounds or range_of(str(term))
        case Arithmetic(operator, left, right):
            sides = [_bounds(each, values, range_of, kinds) for each in (left, right)]
            return _calculated(operator, *sides)
        case Function('count', atoms):
            return _counted(atoms, values, range_of, kinds)
        case Function(name, arguments):
            return _called(name, [_bounds(each, values, range_of, kinds) for each in arguments])
        case _:
            return ANY_NUMBER


def _calculated(operator: str, left: Range, right: Range) -> Range:
    if operator == '/' and right[0] <= 0 <= right[1]:
        return ANY_NUMBER
    try:
        corners = [CALCULATE[operator](*pair) for pair in product(left, right)]
    except OverflowError:
        return ANY_NUMBER
    return ANY_NUMBER if any(map(isnan, corners)) else (min(corners), max(corners))


def _counted(atoms: Sequence[Any], values: Values, range_of: RangeOf, kinds: Kinds) -> Range:
    least = most = 0
    for atom in atoms:
        truth: bool | None
        try:
            truth = predicate(atom, kinds)(values)
        except UnknownValueError:
            truth = bounded_truth(atom, values, range_of, kinds)
        least, most = least + (truth is True), most + (truth is not False)
    return least, most


def _called(name: str, ranges: Sequence[Range]) -> Range:
    lows, highs = zip(*ranges, strict=True)
    match name:
        case 'min' | 'max' | 'sum' | 'sqrt':  # None of them decreases.
            try:
                return call_function(name, lows), call_function(name, highs)
            except ReasoningError:
                return ANY_NUMBER
        case 'abs':
            return _absolute(ranges[0])
        case 'hypot':
            least, most = zip(*map(_absolute, ranges), strict=True)
            return nextafter(hypotenuse(*least), 0), nextafter(hypotenuse(*most), inf)
        case 'sin' | 'cos':
            return -1, 1
        case _:
            return ANY_NUMBER


def _absolute(bounds: Range) -> Range:
    low, high = bounds
    return (0 if low <= 0 <= high else min(abs(low), abs(high))), max(abs(low), abs(high))
