"""Sums of uncertain numbers and of certain terms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from dyknow_reasoning.language.formula import contains
from dyknow_reasoning.language.terms import Arithmetic, Number, Term, Uncertain
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import Values, term_reader


@dataclass(frozen=True, slots=True)
class Sum:
    """A sum of uncertain numbers and of certain terms.

    Args:
        factors: the factors of the uncertain numbers.
        rest: the certain terms with their factors.
    """

    factors: Mapping[Uncertain, float]
    rest: tuple[tuple[float, Callable[[Values], Any]], ...]

    def plus(self, other: Sum, factor: float) -> Sum:
        """Return the sum with a multiple of another."""
        factors = dict(self.factors)
        for number, each in other.factors.items():
            factors[number] = factors.get(number, 0.0) + factor * each
        rest = (*self.rest, *((factor * each, read) for each, read in other.rest))
        return Sum({number: each for number, each in factors.items() if each}, rest)


_NOTHING: Final = Sum({}, ())


def sum_of(term: Term, kinds: Kinds) -> Sum | None:  # noqa: PLR0911 - one for each kind
    """Return a term as a sum; None if it is not linear in its uncertain numbers."""
    if isinstance(term, Uncertain):
        return Sum({term: 1.0}, ())
    if not contains(term, Uncertain):
        return Sum({}, ((1.0, term_reader(term, kinds)),))
    match term:
        case Arithmetic('+' | '-' as operator, left, right):
            sides = sum_of(left, kinds), sum_of(right, kinds)
            if sides[0] is None or sides[1] is None:
                return None
            return sides[0].plus(sides[1], 1.0 if operator == '+' else -1.0)
        case Arithmetic('*', Number(factor), body) | Arithmetic('*', body, Number(factor)):
            found = sum_of(body, kinds)
            return found and _NOTHING.plus(found, factor)
        case Arithmetic('/', body, Number(factor)) if factor:
            found = sum_of(body, kinds)
            return found and _NOTHING.plus(found, 1 / factor)
        case _:
            return None
