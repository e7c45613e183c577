"""Readers: functions that return the truth of atoms at a state, as bits.

Generated code reads values of the expected types. All other values are passed to the predicates of
`atoms`, which accept unusual values or raise an error that describes them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from dyknow_common import Value
from dyknow_reasoning.language.formula import Atom, Comparison, PastAtom
from dyknow_reasoning.language.terms import Feature, FieldReference, Number, Term, TextLiteral
from dyknow_reasoning.language.type_checking import Kind, Kinds, kind_of
from dyknow_reasoning.progression.atoms import (
    MAX_GENERATED,
    Predicate,
    Values,
    field_name,
    generated_reader,
    predicate,
)
from dyknow_reasoning.progression.nodes import slots

Reader: TypeAlias = Callable[[Values], int]
"""The truth of atoms as bits; raises ReasoningError if the values are unusable."""

JointReader: TypeAlias = Callable[[Values], list[int]]
"""The same for each of several instances."""

_UNUSUAL: Mapping[Kind, str] = {
    Kind.NUMBER: '(type({0}) is not float or {0} != {0}) and type({0}) is not int',
    Kind.BOOLEAN: '{0} is not True and {0} is not False',
    Kind.STRING: 'type({0}) is not str',
}
_CODE = {
    '=': '{0} == {1}',
    '<': '{0} < {1}',
    '<=': '{0} <= {1}',
    'contains': '{1} in {0}',
    'starts with': '{0}.startswith({1})',
}

_READ = Number, TextLiteral, Feature, FieldReference
"""The terms that generated code reads."""


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


def quick_reader(atoms: Sequence[Atom], kinds: Kinds, mask: int) -> Reader:
    """Return a reader of generated code, which calls predicates where needed.

    Args:
        atoms: the atoms of all slots.
        kinds: the kinds of the features.
        mask: the slots to read, as bits.
    """
    predicates = {slot: predicate(atoms[slot], kinds) for slot in slots(mask)}
    careful = careful_reader(predicates)
    if len(predicates) > MAX_GENERATED:
        return careful
    code = _ReaderCode(kinds)
    return code.reader(code.symbol(atoms, predicates), careful)


def joint_reader(parts: Sequence[tuple[Sequence[Atom], int]], kinds: Kinds) -> JointReader:
    """Return a reader of several instances at once.

    Args:
        parts: for each, the atoms of all slots and the slots to read.
        kinds: the kinds of the features.
    """
    if sum(mask.bit_count() for _, mask in parts) > MAX_GENERATED:
        return in_turn([quick_reader(atoms, kinds, mask) for atoms, mask in parts])
    code, symbols, careful = _ReaderCode(kinds), list[str](), list[Reader]()
    for atoms, mask in parts:
        predicates = {slot: predicate(atoms[slot], kinds) for slot in slots(mask)}
        symbols.append(code.symbol(atoms, predicates))
        careful.append(careful_reader(predicates))
    return code.reader(f'[{", ".join(symbols)}]', in_turn(careful))


def in_turn(readers: Sequence[Reader]) -> JointReader:
    """Return a reader that calls others one after the other."""
    return lambda values: [read(values) for read in readers]


class _ReaderCode:
    """Generates the code of a reader.

    Args:
        kinds: the kinds of the features.
    """

    def __init__(self, kinds: Kinds) -> None:
        self._kinds = kinds
        self._names: dict[str, Any] = {}
        self._fields: dict[tuple[str, Kind], str] = {}

    def symbol(self, atoms: Sequence[Atom], predicates: Mapping[int, Predicate]) -> str:
        """Return the expression for the truth of some atoms, given the predicate of each slot."""
        bits = []
        for slot, holds in predicates.items():
            text = self._atom(atoms[slot]) or f'{self._name(holds)}(values)'
            bits.append(f'({1 << slot} if {text} else 0)')
        return ' | '.join(bits) or '0'

    def reader(self, result: str, careful: Callable[[Values], Any]) -> Callable[[Values], Any]:
        """Return a reader with the result of an expression; `careful` reads unusual values."""
        fields = self._fields.items()
        if not fields:
            return careful
        unusual = ' or '.join(_UNUSUAL[kind].format(name) for (_, kind), name in fields)
        variables = {name: text for (text, _), name in fields}
        return generated_reader(variables, unusual, result, self._names, careful)

    def _name(self, thing: object) -> str:
        """Return a name by which the code can refer to an object."""
        name = f'name_{len(self._names)}'
        self._names[name] = thing
        return name

    def _atom(self, atom: Atom) -> str | None:
        """Return an expression for an atom; None if a predicate must evaluate it."""
        if not isinstance(atom, Comparison):
            return self._field(atom, Kind.BOOLEAN)
        sides = atom.left, atom.right
        kinds = {kind_of(each, self._kinds) if isinstance(each, _READ) else None for each in sides}
        if kinds not in ({Kind.NUMBER}, {Kind.STRING}):
            return None
        left, right = self._term(atom.left), self._term(atom.right)
        return _CODE[atom.operator].format(left, right)

    def _term(self, term: Term) -> str:
        kind = kind_of(term, self._kinds)
        if isinstance(term, Feature | FieldReference) and kind:
            return self._field(term, kind)
        return self._name(_literal(term))

    def _field(self, term: Feature | FieldReference | PastAtom, kind: Kind) -> str:
        return self._fields.setdefault((field_name(term), kind), f'value_{len(self._fields)}')


def _literal(term: Term) -> Value | None:
    """Return the value of a literal; a number as a float if it is exact, as most values are."""
    if isinstance(term, Number):
        is_exact = abs(term.value) < 1 << 53 or isinstance(term.value, float)
        return float(term.value) if is_exact else term.value
    return term.value if isinstance(term, TextLiteral) else None
