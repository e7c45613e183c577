"""Reads the truth of the atoms of a formula from the values of a state, by generated code.

The code handles values that are plainly what they should be. For all others it hands over to the
predicates of `atoms`, which tell exactly what is wrong, or take what is unusual.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias, cast

from dyknow_reasoning.language.formula import (
    Atom,
    Comparison,
    Feature,
    FieldReference,
    Number,
    Term,
    TextLiteral,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds
from dyknow_reasoning.progression.atoms import Predicate, Values, kind_of

Reader: TypeAlias = Callable[[Values], int]
"""The truth of atoms as bits; raises ReasoningError where the values do not tell."""

_UNUSUAL: Mapping[Kind, str] = {
    Kind.NUMBER: '(type({0}) is not float or {0} != {0}) and type({0}) is not int',
    Kind.BOOLEAN: '{0} is not True and {0} is not False',
    Kind.STRING: 'type({0}) is not str',
}
_OPERATORS = {'=': '==', '<': '<', '<=': '<='}


def careful_reader(predicates: Mapping[int, Predicate]) -> Reader:
    """Reads by predicates.

    Args:
        predicates: by the slots of their atoms.
    """
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
    """Reads by generated code what is simple, and by predicates what is not.

    Args:
        atoms: of all slots.
        kinds: of the features.
        predicates: of the slots to read.
    """
    careful = careful_reader(predicates)
    source = ReaderCode()
    symbol = source.symbol(atoms, kinds, predicates)
    if not source.is_simple:
        return careful
    source.names['careful'] = careful
    return cast(
        'Reader',
        source.compiled(
            f"""
def made():
    def read(values):
        try: {source.reads}
        except KeyError: return careful(values)
        if {source.unusual}: return careful(values)
        return {symbol}
    return read
"""
        ),
    )


class ReaderCode:
    """Puts together the code of a function that reads the values of a state."""

    def __init__(self) -> None:
        self.names: dict[str, Any] = {}
        self._fields: dict[tuple[str, Kind], str] = {}

    @property
    def is_simple(self) -> bool:
        """Whether there is a field to be read by code."""
        return bool(self._fields)

    @property
    def reads(self) -> str:
        """A statement that takes the fields from the values."""
        pairs = self._fields.items()
        return '; '.join(f'{name} = values[{text!r}]' for (text, _), name in pairs) or 'pass'

    @property
    def unusual(self) -> str:
        """An expression for whether a field holds what the code cannot deal with."""
        tests = (_UNUSUAL[kind].format(name) for (_, kind), name in self._fields.items())
        return ' or '.join(tests) or 'False'

    def symbol(
        self, atoms: Sequence[Atom], kinds: Kinds, predicates: Mapping[int, Predicate]
    ) -> str:
        """An expression for the truth of atoms as bits.

        Args:
            atoms: of all slots.
            kinds: of the features.
            predicates: of the slots to read.
        """
        bits = []
        for slot, holds in predicates.items():
            text = self._atom(atoms[slot], kinds) or f'{self.name(holds)}(values)'
            bits.append(f'({text}) << {slot}' if slot else f'({text})')
        return ' | '.join(bits) or '0'

    def name(self, thing: object) -> str:
        """A name for something that the code refers to."""
        name = f'name_{len(self.names)}'
        self.names[name] = thing
        return name

    def compiled(self, code: str) -> Any:
        """What the function `made` in some code returns."""
        exec(code, self.names)  # noqa: S102 - built from checked parts
        return self.names['made']()

    def _atom(self, atom: Atom, kinds: Kinds) -> str | None:
        """The code of an atom; None if it is not simple."""
        if not isinstance(atom, Comparison):
            return self._field(atom, Kind.BOOLEAN)
        if {_kind(side, kinds) for side in (atom.left, atom.right)} not in _COMPARABLE:
            return None
        left, right = (self._term(side, kinds) for side in (atom.left, atom.right))
        return f'{left} {_OPERATORS[atom.operator]} {right}'

    def _term(self, term: Term, kinds: Kinds) -> str:
        kind = _kind(term, kinds)
        if isinstance(term, Feature | FieldReference) and kind:
            return self._field(term, kind)
        return self.name(term.value if isinstance(term, Number | TextLiteral) else None)

    def _field(self, term: Feature | FieldReference, kind: Kind) -> str:
        return self._fields.setdefault((str(term), kind), f'value_{len(self._fields)}')


_COMPARABLE = ({Kind.NUMBER}, {Kind.STRING})


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
