"""The abstract syntax of formulas: metric temporal logic over features (paper, section IV).

Operators of the past are not in the paper; they mirror the operators of the future.

`str` of a node is its canonical text: every compound operand in brackets, every duration with its
unit, in the ASCII spelling.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, Final, TypeAlias

from dyknow_common import SyntaxNode, format_duration
from dyknow_reasoning.language.interval import ALL_FUTURE, Interval
from dyknow_reasoning.language.spatial import LinkEnd, LinkLength, Over, Spatial, SpatialAtom
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Object,
    Operation,
    PastTerm,
    Quantifier,
    StateCount,
    Term,
    Truth,
    Uncertain,
    ValueBefore,
    operand_text,
)

NEGATED_COMPARISONS: Final[Mapping[str, str]] = {
    '=': '!=',
    '!=': '=',
    '<': '>=',
    '>=': '<',
    '<=': '>',
    '>': '<=',
    'contains': 'does not contain',
    'does not contain': 'contains',
    'starts with': 'does not start with',
    'does not start with': 'starts with',
}
"""The negation of each comparison operator."""


@dataclass(frozen=True, slots=True)
class Comparison(Operation):
    """Two terms joined by `=`, `!=`, `<`, `<=`, `>` or `>=`."""

    @property
    def opposite(self) -> Comparison:
        """The comparison that holds where this one does not."""
        return replace(self, operator=NEGATED_COMPARISONS[self.operator])


@dataclass(frozen=True, slots=True)
class Not(SyntaxNode):
    """The negation of a formula."""

    body: Formula
    part_names: ClassVar[tuple[str, ...]] = ('body',)

    def __str__(self) -> str:
        return f'not {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class Connective(SyntaxNode):
    """Two formulas joined by a word of logic."""

    left: Formula
    right: Formula
    symbol: ClassVar[str]
    part_names: ClassVar[tuple[str, ...]] = ('left', 'right')

    def __str__(self) -> str:
        return f'{operand_text(self.left)} {self.symbol} {operand_text(self.right)}'


@dataclass(frozen=True, slots=True)
class And(Connective):
    """Both formulas."""

    symbol: ClassVar[str] = 'and'


@dataclass(frozen=True, slots=True)
class Or(Connective):
    """At least one of two formulas."""

    symbol: ClassVar[str] = 'or'


@dataclass(frozen=True, slots=True)
class Implies(Connective):
    """The right formula wherever the left one holds."""

    symbol: ClassVar[str] = '->'


@dataclass(frozen=True, slots=True)
class Equivalent(Connective):
    """Both formulas or none."""

    symbol: ClassVar[str] = '<->'


@dataclass(frozen=True, slots=True)
class Forall(Quantifier):
    """The body for every object of a sort."""

    symbol: ClassVar[str] = 'forall'


@dataclass(frozen=True, slots=True)
class Exists(Quantifier):
    """The body for at least one object of a sort."""

    symbol: ClassVar[str] = 'exists'


class CountBound(StrEnum):
    """The comparison of a count with a number."""

    AT_LEAST = 'at least'
    AT_MOST = 'at most'
    EXACTLY = 'exactly'


@dataclass(frozen=True, slots=True)
class Count(Quantifier):
    """The body for at least, at most or exactly a number of the objects of a sort."""

    bound: CountBound
    number: int

    @property
    def words(self) -> str:
        """The words before the variable."""
        return f'{self.bound} {self.number}'


@dataclass(frozen=True, slots=True)
class CountOf(SyntaxNode):
    """At least, at most or exactly a number of some formulas."""

    bound: CountBound
    number: int
    members: tuple[Formula, ...]
    part_names: ClassVar[tuple[str, ...]] = ('members',)

    def __str__(self) -> str:
        return f'{self.bound} {self.number} of ({", ".join(map(str, self.members))})'


@dataclass(frozen=True, slots=True)
class _Temporal(SyntaxNode):
    body: Formula
    interval: Interval = ALL_FUTURE
    symbol: ClassVar[str]
    usage: ClassVar[str]
    part_names: ClassVar[tuple[str, ...]] = ('body',)

    def __str__(self) -> str:
        return f'{self.symbol}{self.interval.suffix} {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class Always(_Temporal):
    """The body at every state of an interval."""

    symbol: ClassVar[str] = 'always'
    usage: ClassVar[str] = 'always[0 s, 10 s] F: F at every state in the interval'


@dataclass(frozen=True, slots=True)
class Eventually(_Temporal):
    """The body at some state of an interval."""

    symbol: ClassVar[str] = 'eventually'
    usage: ClassVar[str] = 'eventually[0 s, 10 s] F: F at some state in the interval'


@dataclass(frozen=True, slots=True)
class Historically(_Temporal):
    """The body at every state of an interval that reaches into the past."""

    symbol: ClassVar[str] = 'historically'
    usage: ClassVar[str] = 'historically[0 s, 10 s] F: F at every state before'


@dataclass(frozen=True, slots=True)
class Once(_Temporal):
    """The body at some state of an interval that reaches into the past."""

    symbol: ClassVar[str] = 'once'
    usage: ClassVar[str] = 'once[0 s, 10 s] F: F at some state before'


@dataclass(frozen=True, slots=True)
class Previous(SyntaxNode):
    """The body at the state before; false at the first state."""

    body: Formula
    symbol: ClassVar[str] = 'previous'
    usage: ClassVar[str] = 'previous F: F at the state before'
    part_names: ClassVar[tuple[str, ...]] = ('body',)

    def __str__(self) -> str:
        return f'{self.symbol} {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class _BinaryTemporal(SyntaxNode):
    left: Formula
    right: Formula
    interval: Interval = ALL_FUTURE
    symbol: ClassVar[str]
    usage: ClassVar[str]
    part_names: ClassVar[tuple[str, ...]] = ('left', 'right')

    def __str__(self) -> str:
        operator = f'{self.symbol}{self.interval.suffix}'
        return f'{operand_text(self.left)} {operator} {operand_text(self.right)}'


@dataclass(frozen=True, slots=True)
class Until(_BinaryTemporal):
    """The right formula at some state of an interval, the left at all states strictly between."""

    symbol: ClassVar[str] = 'until'
    usage: ClassVar[str] = 'F until[0 s, 10 s] G: F up to a state at which G is true'


@dataclass(frozen=True, slots=True)
class Since(_BinaryTemporal):
    """The same towards the past."""

    symbol: ClassVar[str] = 'since'
    usage: ClassVar[str] = 'F since[0 s, 10 s] G: F from a state on at which G was true'


@dataclass(frozen=True, slots=True)
class Soon(SyntaxNode):
    """The body is possible by forecasts until a horizon; parsing writes it out (`language.soon`).

    Args:
        horizon: in nanoseconds.
        body: a formula of one state.
    """

    horizon: int
    body: Formula
    part_names: ClassVar[tuple[str, ...]] = ('body',)

    def __str__(self) -> str:
        return f'soon[{format_duration(self.horizon)}] {operand_text(self.body)}'


@dataclass(frozen=True, slots=True)
class PastAtom(SyntaxNode):
    """A past operator over ground operands without future operators: an atom of each state.

    Args:
        formula: the operator, a comparison with values of the past, or a spatial operator.
        field: the name of the field that holds its truth; empty before a group has given it one.
    """

    formula: PastFormula | Comparison | SpatialAtom
    field: str = ''
    part_names: ClassVar[tuple[str, ...]] = ('formula',)

    def __str__(self) -> str:
        return str(self.formula)

    @property
    def depends_on_others(self) -> bool:
        """True if it depends on other states: a state that is missing may change it."""
        formula = self.formula  # Operands in space are about one state, and many.
        return not isinstance(formula, SpatialAtom) and (
            looks_back(formula) or looks_forward(formula)
        )


@dataclass(frozen=True, slots=True)
class Let(SyntaxNode):
    """A formula with constants and the units of features; parsing replaces it by its meaning.

    Args:
        constants: the values by their names.
        units: the unit of each feature, by its name, or of a reference, by its text.
        body: the formula.
        uncertainties: the stated errors of features, by name.
    """

    constants: tuple[tuple[Object, Term], ...]
    units: tuple[tuple[Object, str], ...]
    body: Formula
    uncertainties: tuple[tuple[Object, Uncertain], ...] = ()
    part_names: ClassVar[tuple[str, ...]] = ('body',)


@dataclass(frozen=True, slots=True)
class Freeze(SyntaxNode):
    """A formula about the value that a term has at the state at which it is reached.

    Args:
        name: the name of the value; a `Kept` in the body uses it.
        term: the term.
        body: the formula.
    """

    name: str
    term: Term
    body: Formula
    part_names: ClassVar[tuple[str, ...]] = ('term', 'body')

    def __str__(self) -> str:
        return f'let {self.name} = {self.term} in {operand_text(self.body)}'


FutureFormula: TypeAlias = Always | Eventually | Until
"""An operator of the future."""

PastFormula: TypeAlias = Historically | Once | Previous | Since
"""A formula whose operator looks back; its memory is in `progression.past_operators`."""

SpatialSyntax: TypeAlias = Over | Spatial | SpatialAtom | LinkEnd | LinkLength
"""Operators of space, and the links that belong to them."""

StateAtom: TypeAlias = Feature | FieldReference | Comparison
"""A formula that is true or false in a single state."""

Atom: TypeAlias = StateAtom | PastAtom
"""A formula that is known at each state."""

Formula: TypeAlias = (
    Truth
    | Atom
    | Not
    | And
    | Or
    | Implies
    | Equivalent
    | Forall
    | Exists
    | Count
    | CountOf
    | Always
    | Eventually
    | Until
    | PastFormula
    | SpatialSyntax
    | Let
    | Freeze
    | Soon
)
"""A formula, which is true or false of a sequence of states."""


def parts(node: Formula | Term) -> tuple[Formula | Term, ...]:
    """Return the formulas and terms that a node directly consists of, from left to right."""
    if isinstance(node, SpatialAtom):
        return tuple(node.places)
    found: list[Formula | Term] = []
    for name in getattr(node, 'part_names', ()):
        part: Any = getattr(node, name)
        if isinstance(part, tuple):
            found += part
        elif part is not None:
            found.append(part)
    return tuple(found)


def flat_parts(node: Formula | Term) -> tuple[Formula | Term, ...]:
    """Return the parts of a node, or all operands of `a and b and c`, of `or` and of `+`."""
    if (chain := _chain(node)) is None:
        return parts(node)
    found, pending = [], [node]
    while pending:
        each = pending.pop()
        if _chain(each) == chain:
            pending += reversed(parts(each))
        else:
            found.append(each)
    return tuple(found)


def balanced(node: Any) -> Any:
    """Return a formula whose flat parts nest less deep: `(a and b) and (c and d)`."""
    if _chain(node) is None:
        return with_changed_parts(node, balanced)
    return _tree(
        list(map(balanced, flat_parts(node))),
        lambda left, right: replace(node, left=left, right=right, position=left.position),
    )


def _chain(node: Formula | Term) -> str | None:
    """Return the operator of a node, if it is associative."""
    operator = getattr(node, 'symbol' if isinstance(node, And | Or) else 'operator', None)
    return operator if operator in {'and', 'or', '+'} else None


def _tree(operands: Sequence[Any], join: Callable[[Any, Any], Any]) -> Any:
    if len(operands) == 1:
        return operands[0]
    middle = len(operands) // 2
    return join(_tree(operands[:middle], join), _tree(operands[middle:], join))


def with_changed_parts(node: Any, change: Callable[[Any], Any]) -> Any:
    """Return a node with a function applied to each of its parts."""
    if isinstance(node, PastAtom):
        return node
    names = ('formula',) if isinstance(node, SpatialAtom) else getattr(node, 'part_names', ())
    if isinstance(node, Spatial):
        names = (*names, 'links')
    changed = {name: _changed(getattr(node, name), change) for name in names}
    return replace(node, **changed) if changed else node


def _changed(part: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(part, tuple):
        return tuple(map(change, part))
    return None if part is None else change(part)


def joined(members: Sequence[Formula], kind: type[And | Or]) -> Formula:
    """Return members in a balanced tree, which functions may recurse over."""
    found: Formula = _tree(members, kind) if members else Truth(kind is And)
    return found


def walk(node: Formula | Term) -> Iterator[Formula | Term]:
    """Yield a node and all nodes in it, in the order of the text."""
    pending = [node]
    while pending:
        each = pending.pop()
        yield each
        pending.extend(reversed(parts(each)))


def contains(node: Formula | Term, kinds: Any) -> bool:
    """Return True if a node, or one in it, is of some types."""
    return any(isinstance(each, kinds) for each in walk(node))


def looks_forward(formula: Formula) -> bool:
    """Return True if a formula contains an operator of the future: one state may not decide it."""
    return contains(formula, FutureFormula)


def looks_back(formula: Formula) -> bool:
    """Return True if a formula contains an operator or a value of earlier states."""
    return contains(formula, PastFormula | ValueBefore | StateCount)


def outermost_foralls(formula: Formula) -> tuple[list[Forall], Formula]:
    """Return the outermost `forall` of a formula, and the formula below them.

    One below `always` counts, too: they commute.
    """
    found: list[Forall] = []
    while True:
        match formula:
            case Forall():
                found.append(formula)
                formula = formula.body
            case Always(body=Forall() as inner):
                formula = replace(inner, body=replace(formula, body=inner.body))
            case _:
                return found, formula


def is_about_one_state(node: Formula | Term) -> bool:
    """Return True if a formula contains neither an operator nor a value of other states."""
    kinds = FutureFormula | PastFormula | PastTerm | Freeze
    return not contains(node, kinds)


def compares_past(node: Formula | Term) -> bool:
    """Return True for a comparison with a value of the past, directly or in an operand."""
    return isinstance(node, Comparison) and contains(node, PastTerm)


def first_complete(node: Formula | Term, times: Sequence[int]) -> int:
    """Return the index of the first state from which on a formula looks back to none before all.

    `once[0 s, 2 s] p` over the states from 10 s on is known from 12 s on: the index of that state.

    Args:
        node: a formula, or a part of one.
        times: the valid times of the states in nanoseconds, increasing.

    Returns:
        The number of states if there is no such state.
    """
    first = max((first_complete(each, times) for each in parts(node)), default=0)
    if first == len(times):
        return first
    match node:
        case Previous() | ValueBefore():
            return first + 1
        case Once(body=Truth(value=True)):  # Any state so long ago will do.
            return bisect_left(times, times[first] + node.interval.start)
        case Historically() | Once() | Since() | StateCount() if node.interval.end is not None:
            return bisect_left(times, times[first] + node.interval.end)
    return len(times) if isinstance(node, PastFormula | StateCount) else first
