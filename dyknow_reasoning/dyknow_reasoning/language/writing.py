"""Formulas as people wrote them: numbers in their units, and operators that are written out.

Parsing converts numbers, and writes `unless` and the like with other operators
(`language.sugar`); texts for people show what the formula says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice, product
from typing import Any, Final

from dyknow_common import NOWHERE, SyntaxNode
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Formula,
    Not,
    Or,
    PastAtom,
    Until,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.interval import Interval
from dyknow_reasoning.language.parsing import definition_of
from dyknow_reasoning.language.spatial import Spatial
from dyknow_reasoning.language.sugar import HEADINGS, spatial
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Feature,
    Function,
    Number,
    ShownQuantity,
    operand_text,
)

_LONGEST_HEADING: Final = 20
"""More parts than the definition of a heading has."""


@dataclass(frozen=True, slots=True)
class WrittenOperator(SyntaxNode):
    """`holds until`, `unless` or `release`, which parsing replaces by its meaning.

    Args:
        word: the word of the operator.
        left: the left side.
        right: the right side.
        interval: the interval of the operator.
    """

    word: str
    left: Formula
    right: Formula
    interval: Interval

    def __str__(self) -> str:
        word = f'{self.word}{self.interval.suffix}'
        return f'{operand_text(self.left)} {word} {operand_text(self.right)}'


def as_written(node: Any) -> Any:
    """Return a node with the numbers and operators of the source text, for messages."""
    if isinstance(node, PastAtom):
        return as_written(node.formula)
    if isinstance(node, Function) and node.aggregate:
        return as_written(node.aggregate)
    if isinstance(node, Number):
        given = node.quantity
        return ShownQuantity(given.value, given.unit) if given else node
    if isinstance(node, Spatial):
        ends = {name: as_written(getattr(node.distances, name)) for name in ('start', 'end')}
        node = replace(node, distances=replace(node.distances, **ends))
    if heading := _written_heading(node):
        return heading
    if found := written_operator(node):
        return replace(found, left=as_written(found.left), right=as_written(found.right))
    return with_changed_parts(node, as_written)


def _written_heading(node: Any) -> Function | None:
    """Return the distance or bearing of two objects that a term stands for."""
    if not isinstance(node, Arithmetic | Function):
        return None
    parts = islice(walk(node), _LONGEST_HEADING)
    features = [each for each in parts if isinstance(each, Feature)]
    if all(each.name != 'yaw' for each in features):
        return None
    objects = dict.fromkeys(each.arguments[0] for each in features if len(each.arguments) == 1)
    for name, (r, s) in product(HEADINGS, product([*objects][:2], repeat=2)):
        if spatial(definition_of(name), {'r': r, 's': s}, NOWHERE) == node:
            return Function(name, (r, s))
    return None


def written_operator(node: Any) -> WrittenOperator | None:
    """Return the operator that a formula stands for, if `language.sugar` wrote it out."""
    match node:
        case Not(body):
            found = _holds_until(body)
            if found and isinstance(found.left, Not) and isinstance(found.right, Not):
                left, right = found.left.body, found.right.body
                return WrittenOperator('release', left, right, found.interval)
            return None
        case Or(strong, Always(left, interval)) if interval.start == 0:
            found = _holds_until(strong)
            if found and (found.left, found.interval.end) == (left, interval.end):
                return replace(found, word='unless')
    return _holds_until(node)


def _holds_until(node: Any) -> WrittenOperator | None:
    match node:
        case Or(now, And(left, Until() as until)) if until.interval.start == 0:
            is_written = (left, now) == (until.left, until.right)
        case And(left, Until() as until) if until.interval.start > 0:
            is_written = left == until.left
        case _:
            return None
    sides = until.left, until.right, until.interval
    return WrittenOperator('holds until', *sides) if is_written else None
