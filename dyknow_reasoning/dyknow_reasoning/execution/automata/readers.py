"""Readers: functions that return the truth of atoms at a state, as bits.

Generated code reads values of the expected types. All other values are passed to the predicates of
`atoms`, which accept unusual values or raise an error that describes them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, cast

from dyknow_reasoning.language.formula import (
    Atom,
    Comparison,
    PastAtom,
)
from dyknow_reasoning.language.terms import (
    Feature,
    FieldReference,
    Number,
    Term,
    TextLiteral,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds
from dyknow_reasoning.progression.atoms import Predicate, Values, field_name, kind_of

Reader: TypeAlias = Callable[[Values], int]
"""The truth of atoms as bits; raises ReasoningError if the values are unusable."""

_UNUSUAL: Mapping[Kind, str] = {
    Kind.NUMBER: '(type({0}) is not float or {0} != {0}) and type({0}) is not int',
    Kind.BOOLEAN: '{0} is not True and {0} is not False',
    Kind.STRING: 'type({0}) is not str',
}
MAX_GENERATED = 256
"""The most atoms of an instance for which code is generated, as Python compiles it recursively."""
_CODE = {
    '=': '{0} == {1}',
    '<': '{0} < {1}',
    '<=': '{0} <= {1}',
    'contains': '{1} in {0}',
    'starts with': '{0}.startswith({1})',
}


def careful_reader(predicates: Mapping[int, Predicate]) -> Reader:
    """Return a reader that calls the predicates, given by the slots of their atoms."""
    bits = [(1 << slot, holds) for slot, holds in predicates.items()]

    def read(values: Values) -> int:
        symbol = 0
        for bit, holds in bits:
            if holds(values):
                symbol |= bit
        return symbol

    return read


def quick_reader(
    atoms: Sequence[Atom], kinds: Kinds, predicates: Mapping[int, Predicate]
) -> Reader:
    """Return a reader of generated code, which calls predicates where needed.

    Args:
        atoms: the atoms of all slots.
        kinds: the kinds of the features.
        predicates: the predicates of the slots to read.
    """
    careful = careful_reader(predicates)
    if len(predicates) > MAX_GENERATED:
        return careful
    source = ReaderCode()
    symbol = source.symbol(atoms, kinds, predicates)
    if not source.reads_fields:
        return careful
    return cast('Reader', source.reader(symbol, careful))


class ReaderCode:
    """Generates the code of a function that reads the values of a state."""

    def __init__(self) -> None:
        self.names: dict[str, Any] = {}
        self._fields: dict[tuple[str, Kind], str] = {}

    @property
    def reads_fields(self) -> bool:
        """True if the code reads any field itself."""
        return bool(self._fields)

    @property
    def reads(self) -> str:
        """A statement that takes the fields from the values."""
        pairs = self._fields.items()
        return '; '.join(f'{name} = values[{text!r}]' for (text, _), name in pairs) or 'pass'

    @property
    def unusual(self) -> str:
        """An expression that is true if a field holds a value that the code cannot handle."""
        tests = (_UNUSUAL[kind].format(name) for (_, kind), name in self._fields.items())
        return ' or '.join(tests) or 'False'

    def symbol(
        self, atoms: Sequence[Atom], kinds: Kinds, predicates: Mapping[int, Predicate]
    ) -> str:
        """Return an expression for the truth of atoms as bits; the arguments of `quick_reader`."""
        bits = []
        for slot, holds in predicates.items():
            text = self.atom(atoms[slot], kinds) or f'{self.name(holds)}(values)'
            bits.append(f'({text}) << {slot}' if slot else f'({text})')
        return ' | '.join(bits) or '0'

    def name(self, thing: object) -> str:
        """Return a name by which the code can refer to an object."""
        name = f'name_{len(self.names)}'
        self.names[name] = thing
        return name

    def reader(self, result: str, careful: Callable[[Values], Any]) -> Any:
        """Return the function of a state whose value is an expression of the fields.

        Args:
            result: the expression.
            careful: is called instead for values that the code cannot handle.
        """
        self.names['careful'] = careful
        return self.run(
            f"""
def make():
    def read(values):
        try: {self.reads}
        except KeyError: return careful(values)
        if {self.unusual}: return careful(values)
        return {result}
    return read
"""
        )

    def run(self, code: str) -> Any:
        """Run code that defines a function `make`, and return the result of that function."""
        exec(code, self.names)  # noqa: S102 - built from checked parts
        return self.names['make']()

    def atom(self, atom: Atom, kinds: Kinds) -> str | None:
        """Return the code of an atom; None if a predicate must evaluate it."""
        if not isinstance(atom, Comparison):
            return self._field(atom, Kind.BOOLEAN)
        sides = {_kind(side, kinds) for side in (atom.left, atom.right)}
        if sides not in ({Kind.NUMBER}, {Kind.STRING}):
            return None
        left, right = (self._term(side, kinds) for side in (atom.left, atom.right))
        return _CODE[atom.operator].format(left, right)

    def _term(self, term: Term, kinds: Kinds) -> str:
        kind = _kind(term, kinds)
        if isinstance(term, Feature | FieldReference) and kind:
            return self._field(term, kind)
        return self.name(term.value if isinstance(term, Number | TextLiteral) else None)

    def _field(self, term: Feature | FieldReference | PastAtom, kind: Kind) -> str:
        return self._fields.setdefault((field_name(term), kind), f'value_{len(self._fields)}')


def _kind(term: Term, kinds: Kinds) -> Kind | None:
    match term:
        case Number():
            return Kind.NUMBER
        case TextLiteral():
            return Kind.STRING
        case Feature() | FieldReference():
            return kind_of(term, kinds)
        case _:
            return None
