"""The abstract syntax of terms, the operands of comparisons in formulas.

`str` of a node is its canonical text, as of formulas.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeAlias

from dyknow_common import ComputedField, SyntaxNode, format_duration, parse_field
from dyknow_reasoning.language.grammar import LANGUAGE
from dyknow_reasoning.language.interval import Interval


@dataclass(frozen=True, slots=True)
class Quantity(SyntaxNode):
    """A number with a unit of measurement, until it is converted to the unit of a feature."""

    value: int | float
    unit: str

    def __str__(self) -> str:
        return f'{self.value!r} "{self.unit}"'


@dataclass(frozen=True, slots=True)
class ShownQuantity(Quantity):
    """A number with a unit of measurement in a message: the unit has no needless quotes."""

    def __str__(self) -> str:
        return f'{self.value!r} {LANGUAGE.name_text(self.unit, "UNIT")}'


@dataclass(frozen=True, slots=True, eq=False)
class Number(SyntaxNode):
    """A number. 1, 1.0, 0.0 and -0.0 all differ: terms calculate other values with them.

    Args:
        value: the number.
        quantity: what it is in the text, if it was converted from another unit.
        unit: the unit that it was converted to.
    """

    value: int | float
    quantity: Quantity | None = field(default=None, compare=False, kw_only=True)
    unit: str = field(default='', compare=False, kw_only=True)

    def __eq__(self, other: object) -> bool:
        is_alike = isinstance(other, Number) and self.value == other.value
        return is_alike and str(self) == str(other)

    def __hash__(self) -> int:
        return hash(self.value)

    def __str__(self) -> str:
        return repr(self.value)


@dataclass(frozen=True, slots=True)
class TextLiteral(SyntaxNode):
    """A quoted string."""

    value: str

    def __str__(self) -> str:
        escaped = self.value.replace('\\', '\\\\').replace('"', '\\"')
        return f'"{escaped}"'


@dataclass(frozen=True, slots=True)
class Truth(SyntaxNode):
    """`true` or `false`: a formula, and a value that a boolean feature can be compared with."""

    value: bool

    def __str__(self) -> str:
        return 'true' if self.value else 'false'


@dataclass(frozen=True, slots=True)
class _Name(SyntaxNode):
    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Object(_Name):
    """An object of the domain."""


@dataclass(frozen=True, slots=True)
class Variable(_Name):
    """A variable that a quantifier binds to the objects of a sort."""


@dataclass(frozen=True, slots=True)
class Feature(SyntaxNode):
    """A feature of objects, `XYDist[x, uav1]`, or of none, `p`."""

    name: str
    arguments: tuple[Object | Variable, ...] = ()
    part_names: ClassVar[tuple[str, ...]] = ('arguments',)

    def __str__(self) -> str:
        if not self.arguments:
            return self.name
        return f'{self.name}[{", ".join(map(str, self.arguments))}]'


@dataclass(frozen=True, slots=True)
class FieldReference(SyntaxNode):
    """A syntactic reference: a field of a stream, by name.

    Args:
        stream: the name of a stream or topic, or the text of a built-in source, `action("/dock")`.
        path: the path to the field, `ranges[0]`, or a function of it, `min(ranges[90:270])`.
    """

    stream: str
    path: str

    def __str__(self) -> str:
        is_name = self.stream.isascii() and self.stream.isidentifier()
        plain = is_name or '"' in self.stream
        stream = self.stream if plain else f'"{self.stream}"'
        field = parse_field(self.path)
        if not isinstance(field, ComputedField):
            return f'{stream}.{self.path}'
        return f'{field.function}({field.of(f"{stream}.")})'


@dataclass(frozen=True, slots=True)
class Operation(SyntaxNode):
    """Two terms joined by an operator."""

    operator: str
    left: Term
    right: Term
    part_names: ClassVar[tuple[str, ...]] = ('left', 'right')

    def __str__(self) -> str:
        return f'{operand_text(self.left)} {self.operator} {operand_text(self.right)}'


@dataclass(frozen=True, slots=True)
class Arithmetic(Operation):
    """Two numbers joined by `+`, `-`, `*` or `/`."""


@dataclass(frozen=True, slots=True)
class Function(SyntaxNode):
    """A function of numbers, `hypot(x, y)`; the operands of `count` are atoms.

    Args:
        name: the name of the function.
        arguments: the operands.
        aggregate: if given, the operands are its body for all objects; the text shows it instead.
    """

    name: str
    arguments: tuple[Term, ...]
    aggregate: Aggregate | None = field(default=None, compare=False, kw_only=True)
    part_names: ClassVar[tuple[str, ...]] = ('arguments',)

    def __str__(self) -> str:
        if self.aggregate is not None:
            return str(self.aggregate)
        return f'{self.name}({", ".join(map(str, self.arguments))})'


@dataclass(frozen=True, slots=True)
class Quantifier(SyntaxNode):
    """A formula or term about all objects of a sort."""

    variable: str
    sort: str
    body: Any
    symbol: ClassVar[str]
    part_names: ClassVar[tuple[str, ...]] = ('body',)

    def __str__(self) -> str:
        sort = f' in {self.sort}' if self.is_sorted else ''
        return f'{self.words} {self.variable}{sort}: {operand_text(self.body)}'

    @property
    def words(self) -> str:
        """The words before the variable."""
        return self.symbol

    @property
    def is_sorted(self) -> bool:
        """True if the text gives the sort; otherwise it is `?` and the variable."""
        return not self.sort.startswith('?')


@dataclass(frozen=True, slots=True)
class Aggregate(Quantifier):
    """A function of a number for each object of a sort, `max(Speed[r] for r in Robot)`.

    Args:
        function: the function of the values; for `count`, the body is a comparison or a boolean.
    """

    function: str
    symbol: ClassVar[str] = 'for'

    def __str__(self) -> str:
        sort = f' in {self.sort}' if self.is_sorted else ''
        return f'{self.function}({self.body} for {self.variable}{sort})'


@dataclass(frozen=True, slots=True)
class PastTerm(SyntaxNode):
    """A value that depends on earlier states; it comes from `execution.past.past_comparisons`."""

    body: Any
    part_names: ClassVar[tuple[str, ...]] = ('body',)


@dataclass(frozen=True, slots=True)
class ValueBefore(PastTerm):
    """The value of a term at the state before; the first state has none."""

    def __str__(self) -> str:
        return f'prev({self.body})'


@dataclass(frozen=True, slots=True)
class StateCount(PastTerm):
    """The number of states at which a formula held, from `interval.end` before this one on."""

    interval: Interval

    def __str__(self) -> str:
        return f'count({self.body}, {format_duration(self.interval.end or 0)})'


@dataclass(frozen=True, slots=True)
class Covariance(Operation):
    """The covariance with an error: `left` is the estimate of the other number."""

    def __str__(self) -> str:
        return f'covariance({self.left}, {self.right})'


@dataclass(frozen=True, slots=True)
class Kept(SyntaxNode):
    """The value that a term had at the state at which `let NAME = TERM in` was reached.

    Args:
        name: the name of the value.
        body: the term.
    """

    name: str
    body: Any
    part_names: ClassVar[tuple[str, ...]] = ('body',)

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Uncertain(SyntaxNode):
    """A number that is known up to a normal error; it stands in `P(...)` only.

    Equal ones are one number: 1 and 1.0 are equal deviations, unlike the numbers of other terms.

    Args:
        mean: the best estimate.
        deviation: the standard deviation of the error, in the unit of the estimate.
        time_constant: the time constant of the error as a first-order Gauss-Markov process, in
            nanoseconds; 0: errors at different states are independent. None: nothing is known
            about correlation. Unless None, errors of different numbers are independent, too.
        covariances: with the errors of other numbers at the same state, whatever the time constant.
    """

    mean: Any
    deviation: Any
    time_constant: int | None = None
    covariances: tuple[Covariance, ...] = ()
    part_names: ClassVar[tuple[str, ...]] = ('mean', 'deviation', 'covariances')

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def _identity(self) -> tuple[object, ...]:
        deviation = self.deviation.value if isinstance(self.deviation, Number) else self.deviation
        return self.mean, deviation, self.time_constant, self.covariances

    def __str__(self) -> str:
        time = '' if self.time_constant is None else f', {format_duration(self.time_constant)}'
        others = ''.join(f', {each}' for each in self.covariances)
        return f'normal({self.mean}, {self.deviation}{time}{others})'


@dataclass(frozen=True, slots=True, eq=False)
class Bounded(Uncertain):
    """A number that is known up to an error of at most `deviation`, of any distribution."""

    def __str__(self) -> str:
        return f'within({self.mean}, {self.deviation})'


@dataclass(frozen=True, slots=True, eq=False)
class Sampled(Uncertain):
    """A number with known independent samples; the text `deviation` lists them."""

    def __str__(self) -> str:
        return f'sampled({self.mean}, {self.deviation})'


@dataclass(frozen=True, slots=True)
class Probability(PastTerm):
    """The probability that a formula holds from this state on; see `execution.probability`."""

    def __str__(self) -> str:
        return f'P({self.body})'


NumericTerm: TypeAlias = (
    Number | Quantity | Arithmetic | Function | Aggregate | StateCount | Uncertain | Probability
)
"""The terms that are numbers, whatever their parts are."""

Term: TypeAlias = (
    NumericTerm
    | ValueBefore
    | Kept
    | TextLiteral
    | Truth
    | Object
    | Variable
    | Feature
    | FieldReference
)
"""An operand of a comparison."""


def holds_terms(node: Any) -> bool:
    """Return True if the parts of a node are terms, not formulas."""
    is_aggregate = isinstance(node, Aggregate) and node.function != 'count'
    return is_aggregate or isinstance(node, Operation | Function | ValueBefore | Kept | Uncertain)


def operand_text(node: Any) -> str:
    """Return the canonical text of a node within another: in brackets if it is compound."""
    is_leaf = isinstance(node, Term) and not isinstance(node, Arithmetic)
    return str(node) if is_leaf else f'({node})'
