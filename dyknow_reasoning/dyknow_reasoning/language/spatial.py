"""The abstract syntax of spatial operators over the links between objects (STREL).

    over (Dist[a, b] <= 50 m for a, b in Robot) from r to s: somewhere[0, 100 m] Charge[s] > 20

`over` states which objects are linked, and binds a variable, here `s`, to the object from which the
spatial operators in its body look, at first `r`. An operator moves this variable along the links.

Operators as in E. Bartocci, L. Bortolussi, M. Loreti, L. Nenzi, "Monitoring mobile and spatially
distributed cyber-physical systems" (MEMOCODE 2017); the distance of an object is the length of the
shortest route to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final

from dyknow_common import SyntaxNode
from dyknow_reasoning.language.terms import (
    Number,
    Quantifier,
    Quantity,
    Term,
    Truth,
    operand_text,
)


@dataclass(frozen=True, slots=True)
class LinkLength(SyntaxNode):
    """A link between two objects.

    Args:
        condition: the formula that holds if they are linked, about one state.
        weight: the length of the link; None if only links can be counted.
        place: x and y of the first object, if only Delaunay neighbours are linked.
    """

    condition: Any
    weight: Term | None
    place: tuple[Term, ...] = ()
    part_names: ClassVar[tuple[str, ...]] = ('place', 'condition', 'weight')

    def __str__(self) -> str:
        text = str(self.condition)
        if self.place:
            text = f'delaunay({", ".join(map(str, self.place))})'
            if self.condition != Truth(True):
                text = f'{text} and {operand_text(self.condition)}'
        if self.weight is None or self.weight == compared_number(self.condition):
            return text
        return f'{text} by {operand_text(self.weight)}'


@dataclass(frozen=True, slots=True)
class LinkEnd(Quantifier):
    """One end of the links; its body is the other end, whose body is the link."""

    symbol: ClassVar[str] = 'link'

    def __str__(self) -> str:
        end: LinkEnd = self.body
        return f'({end.body} for {self.variable}, {end.variable} in {self.sort})'

    @property
    def link(self) -> LinkLength:
        """The link between the variables of both ends."""
        found: LinkLength = self.body.body
        return found


@dataclass(frozen=True, slots=True)
class Over(Quantifier):
    """A formula with spatial operators, from an object on, over some links.

    Args:
        links: between the objects of the sort.
        origin: the object.
    """

    links: LinkEnd
    origin: Any
    symbol: ClassVar[str] = 'over'
    part_names: ClassVar[tuple[str, ...]] = ('links', 'origin', 'body')

    def __str__(self) -> str:
        return f'over {self.links} from {self.origin} to {self.variable}: {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class DistanceInterval(SyntaxNode):
    """An interval of distances, `[0, 100 "m"]` or `[0, 3 hops]`.

    Args:
        start: its start.
        end: its end; None if it is infinite.
        brackets: `[]`, or round ones at an end that is excluded.
        hops: True if links are counted, not measured.
    """

    start: Number | Quantity
    end: Number | Quantity | None
    brackets: str
    hops: bool

    def __str__(self) -> str:
        start, end = str(self.start), 'inf' if self.end is None else str(self.end)
        if self.hops and self.end is not None:
            end = f'{end} hops'
        elif self.hops and not self.is_any:
            start = f'{start} hops'
        return f'{self.brackets[0]}{start}, {end}{self.brackets[1]}'

    @property
    def is_any(self) -> bool:
        """True if every distance is in the interval, in links and in any unit."""
        return self.brackets[0] == '[' and not self.start.value and self.end is None

    @property
    def quantities(self) -> list[Quantity]:
        """The ends whose unit is not converted."""
        return [each for each in (self.start, self.end) if isinstance(each, Quantity)]

    def contains(self, distance: Any) -> Any:
        """Return True for a distance in the interval; also for each one of an array."""
        return self.keeps_start(distance) & self.keeps_end(distance)

    def keeps_start(self, distance: Any) -> Any:
        """Return True for a distance in the interval or beyond it."""
        start = self.start.value
        return distance > start if self.brackets[0] == '(' else distance >= start

    def keeps_end(self, distance: Any) -> Any:
        """Return True for a distance in the interval or before it."""
        if self.end is None:
            return distance < float('inf')
        end = self.end.value
        return distance < end if self.brackets[1] == ')' else distance <= end


ANY_DISTANCE: Final = DistanceInterval(Number(0), None, '[)', hops=True)
"""`[0, inf)`, which counts links."""


@dataclass(frozen=True, slots=True)
class Spatial(SyntaxNode):
    """A spatial operator.

    Args:
        operator: `somewhere`, `everywhere`, `escape` or `reach`.
        distances: the distances of the objects that it reaches.
        left: the formula along the route, but not at its end; None without it.
        right: the formula at the end of the route; for `escape`, along the whole route.
        place: the variable that stands for the object.
        links: the links.
    """

    operator: str
    distances: DistanceInterval
    left: Any
    right: Any
    place: str = ''
    links: Any = None
    part_names: ClassVar[tuple[str, ...]] = ('left', 'right')

    def __str__(self) -> str:
        return self.with_right(str(self.right))

    def with_right(self, right: str) -> str:
        """Return the text with another right side."""
        text = f'{self.operator}{self.distances} ({right})'
        return text if self.left is None else f'{operand_text(self.left)} {text}'


@dataclass(frozen=True, slots=True)
class SpatialAtom(SyntaxNode):
    """A spatial operator, starting from one object; its operands are about one state.

    Args:
        formula: the operator, without variables but its own.
        origin: the object.
        target: the object that is reached; empty for any.
        places: the operands at each object, a part of the abstract syntax.
    """

    formula: Spatial
    origin: str
    target: str
    places: Any = field(compare=False)

    def __str__(self) -> str:
        formula = self.formula
        reached = f'{formula.place} = {self.target}' if self.target else str(formula.right)
        return (
            f'over {formula.links} from {self.origin} to {formula.place}: '
            f'({formula.with_right(reached)})'
        )


def compared_number(condition: Any) -> Term | None:
    """Return the term that a link requires to be small, `Dist[a, b]` of `Dist[a, b] <= 50 m`."""
    is_bound = getattr(condition, 'operator', '') in {'<', '<='}
    found: Term | None = condition.left if is_bound else None
    return found if not isinstance(found, Number | Quantity | Truth) else None
