"""Numbers with units of measurement, converted to the units of the features beside them.

Terms that are compared, added or subtracted must have one unit: the unit of the first term that is
not a number. Numbers are converted, values of features never. Example, where `Distance` is in m and
`Time` in s:

    Distance[u] - 1 km < Time[u] * 10 m/s      1 km beside Distance[u] is 1000.0, in m
    Distance[u] - 1000.0 < Time[u] * 10        m and (s)*(m/s) are the same unit

With `36 km/h` instead, the right side would be in (s)*(km/h). That is an error, as it is no number.

Comparisons without such a number are not checked: their plain numbers are in the units of the
features. `mixed_units` finds those whose features have different units.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

from dyknow_common import DyKnowError, PositionedError, UnitConversion, unit_conversion
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.constants import Units
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    Freeze,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.functions import built_in_unit
from dyknow_reasoning.language.soon import ForecastFeature
from dyknow_reasoning.language.spatial import LinkLength, Over, Spatial
from dyknow_reasoning.language.terms import (
    Aggregate,
    Arithmetic,
    Feature,
    FieldReference,
    Function,
    Kept,
    Number,
    Probability,
    Quantity,
    StateCount,
    Term,
    Uncertain,
    ValueBefore,
)

_Measured: TypeAlias = tuple[Term, str | None]
"""A term and its unit; None for a plain number."""

_NONE_STATED: Final[Units] = {'': ''}
"""No units, when none will be stated later."""

_NO_UNITS = 'state the unit, let {name}: UNIT in ..., or write a plain number'
_NO_UNIT = 'give the feature its unit, let {name}: UNIT in ..., or write a plain number'


def with_converted_numbers(formula: Formula, units: Units) -> Formula:
    """Return a formula in which numbers have no units.

    If no units are given, numbers beside features keep their units: these may be stated later.

    Args:
        formula: a formula without `let`.
        units: the units of features and references, by name; empty for a pure number.

    Raises:
        PositionedError: for a number that does not convert, or beside something without a unit.
    """
    converted: Formula = _converted(formula, _Conversion(units))
    return converted


def check_units_are_known(formula: Formula) -> None:
    """Check that all numbers with a unit were converted.

    Raises:
        ReasoningError: names the first that was not, and a feature beside it.
    """
    ends = (each.distances for each in walk(formula) if isinstance(each, Spatial) and each.links)
    found = (_quantity(formula), *(each for one in ends for each in one.quantities))
    if quantity := next(filter(None, found), None):
        try:
            _converted(formula, _Conversion(_NONE_STATED))
        except PositionedError as error:
            raise ReasoningError(f"'{quantity}' has a unit, and {error}") from None


def mixed_units(formula: Formula, units: Mapping[str, str]) -> Iterator[tuple[Feature, Feature]]:
    """Yield features that stand beside each other, though their numbers mean different units.

    Args:
        formula: searched for comparisons, sums and functions of operands of one unit.
        units: the units of features, by name; empty for a pure number.
    """
    for node in walk(formula):
        match node:
            case Comparison() | Arithmetic('+' | '-'):
                terms: tuple[Term, ...] = node.left, node.right
            case Function('min' | 'max' | 'hypot' | 'angle_difference'):
                terms = node.arguments
            case _:
                continue
        found = [each for each in map(_measured_feature, terms) if each is not None]
        measured = [each for each in found if units.get(each.name)]
        for each in measured[1:]:
            if not _are_equal(units[measured[0].name], units[each.name]):
                yield measured[0], each


def _measured_feature(term: Term) -> Feature | None:
    while isinstance(term, Aggregate | ValueBefore | Kept):
        if isinstance(term, Aggregate) and term.function == 'count':
            return None
        term = term.body
    return term if isinstance(term, Feature) else None


def _are_equal(one: str, other: str) -> bool:
    try:
        return unit_conversion(one, other) is None
    except DyKnowError:
        return False


_RESULTS: Final = {'sin': None, 'cos': None, 'atan2': 'rad'}
"""The units of functions that do not take their first operand's unit; None: plain numbers."""

_EXPONENTS: Final = frozenset({0.5, *range(-99, 100)})
"""The exponents that a unit may have."""


def _converted(node: Any, conversion: _Conversion) -> Any:
    if isinstance(node, Over):
        found = with_changed_parts(node, lambda part: _converted(part, conversion))
        return replace(found, body=_measured_by(found.body, node.links.link.weight, conversion))
    if isinstance(node, Freeze):
        body = _converted(node.body, conversion)
        return replace(node, term=_converted_alone(node.term, conversion), body=body)
    if isinstance(node, LinkLength):
        place = tuple(_converted_alone(each, conversion) for each in node.place)
        weight = node.weight and _converted_alone(node.weight, conversion)
        return LinkLength(_converted(node.condition, conversion), weight, place)
    if not isinstance(node, Comparison):
        return with_changed_parts(node, lambda part: _converted(part, conversion))
    if not _is_convertible(node, conversion):
        return node
    (left, _), (right, _) = conversion.alike((node.left, node.right))
    return Comparison(node.operator, left, right, position=node.position)


def _converted_alone(term: Term, conversion: _Conversion) -> Term:
    return conversion.alike((term,))[0][0] if _is_convertible(term, conversion) else term


def _is_convertible(node: Comparison | Term, conversion: _Conversion) -> bool:
    """Return True for numbers with units, unless the units of features may follow later."""
    if _quantity(node) is None:
        return False
    fields = [each for each in walk(node) if isinstance(each, Feature | FieldReference)]
    return not fields or bool(conversion.units) or not all(isinstance(e, Feature) for e in fields)


def _measured_by(node: Any, length: Term | None, conversion: _Conversion) -> Any:
    """Return a formula with the distances of its spatial operators in the unit of a length."""
    if isinstance(node, Over):
        return node
    found = with_changed_parts(node, lambda part: _measured_by(part, length, conversion))
    if not isinstance(found, Spatial) or not found.distances.quantities or length is None:
        return found
    fields = [each for each in walk(length) if isinstance(each, Feature | FieldReference)]
    if fields and not conversion.units and all(isinstance(each, Feature) for each in fields):
        return found
    ends: list[Any] = [
        conversion.alike((length, each))[1][0] if isinstance(each, Quantity) else each
        for each in (found.distances.start, found.distances.end)
    ]
    return replace(found, distances=replace(found.distances, start=ends[0], end=ends[1]))


def _quantity(node: Formula | Term) -> Quantity | None:
    return next((each for each in walk(node) if isinstance(each, Quantity)), None)


@dataclass(frozen=True, slots=True)
class _Conversion:
    """The conversion of the numbers of comparisons; its methods raise `PositionedError`."""

    units: Units

    def alike(
        self, terms: Sequence[Term], wanted: str | None = None, *, is_sum: bool = False
    ) -> list[_Measured]:
        """Return terms that must have one unit, with their numbers converted to it.

        Args:
            terms: the terms.
            wanted: the unit; None: the unit of the first term that is not a number.
            is_sum: True if they are added or subtracted.
        """
        measured = [self._measured(each) for each in terms]
        fixed = [each for each in measured if not isinstance(each[0], Number | Quantity)]
        anchor = next((each for each in (*fixed, *measured) if each[1] is not None), None)
        if anchor is None:
            return measured
        unit = wanted or anchor[1] or ''
        may_shift = not is_sum and isinstance(anchor[0], Feature | FieldReference)
        return [
            (self._in_unit(term, given, unit, may_shift=may_shift, is_sum=is_sum), unit)
            for term, given in measured
        ]

    def _in_unit(
        self, term: Term, given: str | None, unit: str, *, may_shift: bool, is_sum: bool
    ) -> Term:
        if given is None:
            if is_sum and isinstance(term, Number) and not term.value:
                return term
            message = f"'{term}' has no unit, and the number beside it has; give it one, or none"
            raise PositionedError(message, term.position)
        try:
            convert = unit_conversion(given, unit)
        except DyKnowError:
            message = f"'{term}' is in {given}, which does not convert to {unit}"
            raise PositionedError(message, term.position) from None
        if isinstance(term, Quantity):
            value = term.value if convert is None else _converted_value(term.value, convert)
            if math.isinf(value):
                raise PositionedError(f"'{term}' is too large in {unit}", term.position)
            if convert is not None and convert(0) and not may_shift:
                raise PositionedError(
                    f"'{term}' is not a difference, as 0 {given} is not 0 {unit}; compare it with "
                    f'a feature alone, or write a difference in {unit}',
                    term.position,
                )
            return Number(value, quantity=term, unit=unit, position=term.position)
        if convert is not None:
            message = f"'{term}' is in {given} and the term beside it in {unit}"
            raise PositionedError(f'{message}; convert one by a factor', term.position)
        return term

    def _measured(self, term: Term) -> _Measured:  # noqa: PLR0911 - one for each kind
        match term:
            case Quantity():
                return term, term.unit
            case Feature() | FieldReference():
                return term, self._unit_of(term)
            case Arithmetic('+' | '-' as operator, left, right):
                (first, unit), (second, _) = self.alike((left, right), is_sum=True)
                return Arithmetic(operator, first, second, position=term.position), unit
            case Arithmetic():
                return self._product(term)
            case Function():
                return self._function(term)
            case Aggregate(function='count') | StateCount() | Probability():
                return with_changed_parts(term, lambda body: _converted(body, self)), None
            case Aggregate() | ValueBefore() | Kept():
                ((body, unit),) = self.alike((term.body,))
                return replace(term, body=body), unit
            case Uncertain(mean, deviation):
                mean, unit = self._measured(mean)
                if isinstance(deviation, Quantity):  # Another one is in the unit of the mean.
                    ((deviation, _),) = self.alike((deviation,), unit, is_sum=True)
                return replace(term, mean=mean, deviation=deviation), unit
            case _:
                return term, None

    def _product(self, term: Arithmetic) -> _Measured:
        (left, first), (right, second) = self._measured(term.left), self._measured(term.right)
        match left, term.operator, right:
            case (Quantity(value, unit), '*', Number(factor)) | (
                Number(factor),
                '*',
                Quantity(value, unit),
            ):
                return _multiple(Quantity(value * factor, unit, position=term.position)), unit
        sides = (_plain(each) for each in (left, right))
        product = Arithmetic(term.operator, *sides, position=term.position)
        if second is None:
            return product, first
        return product, f'({first or "dimensionless"}){term.operator}({second})'

    def _function(self, term: Function) -> _Measured:
        if term.name in {'sqrt', 'pow'}:
            return self._power(term)
        if term.name == 'bit':
            measured = self.alike(term.arguments)
            if any(unit is not None for _, unit in measured):
                raise _unknown_unit(term)
            return replace(term, arguments=tuple(each for each, _ in measured)), None
        wanted = 'rad' if term.name in {'angle_difference', 'sin', 'cos'} else None
        measured = self.alike(term.arguments, wanted)
        arguments = tuple(argument for argument, _ in measured)
        unit = _RESULTS.get(term.name, measured[0][1])
        return Function(term.name, arguments, position=term.position), unit

    def _power(self, term: Function) -> _Measured:
        base, exponent = (*term.arguments, Number(0.5))[:2]
        ((argument, unit),), (power, other) = self.alike((base,)), self._measured(exponent)
        if unit is None and other is None:
            return replace(term, arguments=(argument, power)[: len(term.arguments)]), None
        if not isinstance(exponent, Number) or exponent.value not in _EXPONENTS:
            raise _unknown_unit(term)
        arguments = (argument, *term.arguments[1:])
        found = f'({unit or "dimensionless"})^{exponent.value:g}'
        return Function(term.name, arguments, position=term.position), found

    def _unit_of(self, term: Feature | FieldReference) -> str:
        name = term.name if isinstance(term, Feature) else str(term)
        if name not in self.units and (bound := ForecastFeature.of(name)):
            name = bound.feature
        if unit := self.units.get(name):
            return unit
        if isinstance(term, FieldReference) and (unit := built_in_unit(term)):
            return unit
        if isinstance(term, FieldReference):
            reason, correction = f"'{term}' is a field of a stream, which states no unit", _NO_UNITS
        elif name in self.units:
            reason, correction = f"'{name}' has no unit", _NO_UNIT
        else:
            reason, correction = f"the unit of '{name}' is not known", _NO_UNITS
        raise PositionedError(f'{reason}; {correction.format(name=name)}', term.position)


def _unknown_unit(term: Function) -> PositionedError:
    message = f"the unit of '{term}' is not known; write plain numbers beside it"
    return PositionedError(message, term.position)


def _converted_value(value: float, conversion: UnitConversion) -> float:
    try:
        return conversion.of_constant(value)
    except OverflowError:
        return math.inf


def _multiple(product: Quantity) -> Quantity:
    """Return a product; raise PositionedError for a unit with another zero, such as degC."""
    try:
        unit_conversion(f'({product.unit})*(dimensionless)', product.unit)
    except DyKnowError:
        message = f"a number in {product.unit} has no multiples; write the product, '{product}'"
        raise PositionedError(message, product.position) from None
    return product


def _plain(term: Term) -> Term:
    return Number(term.value, position=term.position) if isinstance(term, Quantity) else term
