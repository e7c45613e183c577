"""The operator `soon`, which asks forecasts: `soon[5 s] Altitude[u] > 120`.

A feature with a forecast has two more features for each of its horizons: the least and the greatest
value that the forecast allows from now until the horizon, such as `Altitude_low_5s` and
`Altitude_high_5s`. `soon[h] p` is true at a state if these intervals do not exclude p, as in
interval arithmetic: it is an alarm, which says that p is *possible*. So the example is written out
to `Altitude_high_5s[u] > 120`, and is a condition of one state like any other.

If p compares one feature with a constant by `<`, `<=`, `>`, `>=` or `!=`, or is an `or` of such
comparisons, `soon` is exact: it is true if and only if the interval of the forecast at some time
allows p. With `=`, in a conjunction and in a term of several features, each feature has the
interval of the whole window. Then `soon` may be true although no single time allows p, but it is
never false if some time does.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from typing import Any, Final, NamedTuple, TypeAlias

from dyknow_common import (
    TEXT_COMPARISONS,
    PositionedError,
    format_duration,
    parse_duration,
    shortened,
)
from dyknow_reasoning.language.formula import (
    And,
    Comparison,
    Exists,
    Forall,
    Formula,
    Implies,
    Not,
    Or,
    Soon,
    contains,
    with_changed_parts,
)
from dyknow_reasoning.language.sugar import checked_size
from dyknow_reasoning.language.terms import (
    Aggregate,
    Arithmetic,
    Feature,
    Function,
    Number,
    Quantity,
    Term,
    Truth,
)


class ForecastBound(StrEnum):
    """A bound of the values that a forecast allows until a horizon."""

    LOW = 'low'
    HIGH = 'high'

    @property
    def other(self) -> ForecastBound:
        """The opposite bound."""
        return ForecastBound.LOW if self is ForecastBound.HIGH else ForecastBound.HIGH


class ForecastFeature(NamedTuple):
    """A feature that holds a bound of a forecast.

    Args:
        feature: the name of the feature that is forecast.
        bound: the least or the greatest value.
        horizon: until when, in nanoseconds from the state on.
    """

    feature: str
    bound: ForecastBound
    horizon: int

    @property
    def name(self) -> str:
        """The name of the feature, `Altitude_high_5s`."""
        return f'{self.feature}_{self.bound}_{format_duration(self.horizon).replace(" ", "")}'

    @classmethod
    def of(cls, name: str) -> ForecastFeature | None:
        """Return what the name of a feature says about a forecast; None for any other name."""
        found = _NAME.fullmatch(name)
        if found is None:
            return None
        feature, bound, horizon = found.groups()
        parsed = cls(feature, ForecastBound(bound), parse_duration(horizon))
        return parsed if parsed.name == name else None


_NAME: Final = re.compile(r'(\w+)_(low|high)_([0-9]+(?:ns|us|ms|s|min|h))')

_Bounds: TypeAlias = dict[ForecastBound, Term]

_MONOTONE: Final = frozenset({'min', 'max', 'sum', 'mean'})
"""The functions that do not decrease in any operand."""


def without_soon(node: Any) -> Any:
    """Return a formula with each `soon` written out.

    Args:
        node: a formula without constants, which nests no deeper than functions may recurse.

    Raises:
        PositionedError: for a body that no forecast can decide.
    """
    if not contains(node, Soon):
        return node
    if isinstance(node, Soon):
        return checked_size(_Possible(node.horizon).formula(node.body), 'soon')
    return with_changed_parts(node, without_soon)


class _Possible:
    """Writes out what a forecast does not exclude until a horizon."""

    def __init__(self, horizon: int) -> None:
        self._horizon = horizon

    def formula(self, node: Formula, *, negated: bool = False) -> Formula:
        """Return the formula that is true if a formula, or its negation, is possible."""
        match node:
            case Truth(value):
                return replace(node, value=value != negated)
            case Not(body):
                return self.formula(body, negated=not negated)
            case And() | Or():
                kind = And if isinstance(node, And) != negated else Or
                sides = (self.formula(side, negated=negated) for side in (node.left, node.right))
                return kind(*sides, position=node.position)
            case Implies(left, right):
                return self.formula(Or(Not(left), right, position=node.position), negated=negated)
            case Forall() | Exists():
                kind_of_all = Forall if isinstance(node, Forall) != negated else Exists
                body = self.formula(node.body, negated=negated)
                return kind_of_all(node.variable, node.sort, body, position=node.position)
            case Comparison(operator) if operator not in TEXT_COMPARISONS:
                return self._comparison(node.opposite if negated else node)
        raise PositionedError(
            f"'soon' cannot ask a forecast for '{shortened(node)}'; it takes comparisons of "
            "numbers with 'not', 'and', 'or', '->', 'forall' and 'exists'; write all else outside "
            'of its brackets',
            node.position,
        )

    def _comparison(self, node: Comparison) -> Formula:
        operator, left, right = node.operator, self._bounds(node.left), self._bounds(node.right)
        low, high = ForecastBound.LOW, ForecastBound.HIGH

        def compared(symbol: str, bound: ForecastBound) -> Comparison:
            sides = left[bound], right[bound.other]
            return Comparison(symbol, *sides, position=node.position)

        if not contains(node, Feature):
            message = f"'{shortened(node)}' has no feature; write it outside of 'soon'"
            raise PositionedError(message, node.position)
        if operator == '=':
            return And(compared('<=', low), compared('>=', high), position=node.position)
        if operator == '!=':
            return Or(compared('<', low), compared('>', high), position=node.position)
        return compared(operator, low if operator[0] == '<' else high)

    def _bounds(self, term: Term) -> _Bounds:  # noqa: PLR0911 - one for each kind
        """Return the least and the greatest value that a term may have."""
        match term:
            case Number() | Quantity():
                return dict.fromkeys(ForecastBound, term)
            case Feature(name):
                return {
                    bound: replace(term, name=ForecastFeature(name, bound, self._horizon).name)
                    for bound in ForecastBound
                }
            case Arithmetic('+' | '-' as operator, left, right):
                first, second = self._bounds(left), self._bounds(right)
                return {
                    bound: replace(
                        term,
                        left=first[bound],
                        right=second[bound if operator == '+' else bound.other],
                    )
                    for bound in ForecastBound
                }
            case Arithmetic('*' | '/', left, Number(factor) | Quantity(factor)):
                return self._scaled(left, factor, lambda side: replace(term, left=side))
            case Arithmetic('*', Number(factor) | Quantity(factor), right):
                return self._scaled(right, factor, lambda side: replace(term, right=side))
            case Function('abs', (operand,)):
                return _absolute(self._bounds(operand), term)
            case Function(name, arguments) if name in _MONOTONE:
                each = [self._bounds(argument) for argument in arguments]
                return {
                    bound: replace(term, arguments=tuple(found[bound] for found in each))
                    for bound in ForecastBound
                }
            case Aggregate(function=name) if name in _MONOTONE:
                body = self._bounds(term.body)
                return {bound: replace(term, body=body[bound]) for bound in ForecastBound}
        raise PositionedError(
            f"'soon' cannot bound '{shortened(term)}'; it takes features with a forecast, numbers, "
            'sums, differences, products with a number, abs, min, max, sum and mean',
            term.position,
        )

    def _scaled(self, operand: Term, factor: float, scaled: Callable[[Term], Term]) -> _Bounds:
        bounds = self._bounds(operand)
        return {
            bound: scaled(bounds[bound if factor >= 0 else bound.other]) for bound in ForecastBound
        }


def _absolute(bounds: _Bounds, term: Term) -> _Bounds:
    low, high = (bounds[each] for each in ForecastBound)

    def greater(one: Term, other: Term) -> Term:
        minus = Arithmetic('-', Number(0), other, position=term.position)
        return Function('max', (one, minus), position=term.position)

    nearest = greater(low, high)
    # If both signs are possible it is negative, and 0 is meant: this keeps the unit of the term.
    twice = Arithmetic('+', nearest, Function('abs', (nearest,)), position=term.position)
    return {
        ForecastBound.LOW: Arithmetic('/', twice, Number(2), position=term.position),
        ForecastBound.HIGH: greater(high, low),
    }
