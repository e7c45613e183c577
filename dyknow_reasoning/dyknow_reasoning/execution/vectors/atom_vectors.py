"""The truth of the atoms of many instances at once, over columns of values.

An array of truth has an entry for each instance; over a recording it has a row for each state. What
an array could not represent exactly (a value of another type, a missing field, an integer that no
float equals) raises `UnreadableError`: then the states are to be read value by value.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import itemgetter
from typing import Any, TypeAlias

import numpy as np

from dyknow_reasoning.execution.automata.atom_forms import EXACT
from dyknow_reasoning.language.formula import (
    Arithmetic,
    Atom,
    Comparison,
    Feature,
    FieldReference,
    Number,
    Term,
    TextLiteral,
    Truth,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds
from dyknow_reasoning.progression.atoms import Values, kind_of

Array: TypeAlias = 'np.ndarray[Any, np.dtype[Any]]'

Truths: TypeAlias = Callable[[], Array]
"""Whether an atom holds, for each instance, of the columns that were last loaded."""

Recording: TypeAlias = Mapping[str, Array]
"""For each field its values, one for each state."""

_COMPARE: Mapping[str, Callable[[Any, Any], Any]] = {
    '=': operator.eq,
    '<': operator.lt,
    '<=': operator.le,
}


_WIDE: Mapping[str, type] = {'b': bool, 'i': int, 'f': float}


class UnreadableError(Exception):
    """The values do not fit into columns."""


class FieldVector:
    """The values of some fields, one for each instance.

    Args:
        fields: their names, in the order of the instances.
        kind: what they hold; None if only the values tell.
    """

    def __init__(self, fields: Sequence[str], kind: Kind | None) -> None:
        self.values: Array = np.empty(0)
        self._recorded: Array = np.empty((0, 0))
        self._fields = fields
        self._kind = kind
        self._items: Callable[[Values], Any] = itemgetter(*fields)

    def load(self, values: Values) -> None:
        """Takes the values of a state.

        Raises:
            UnreadableError: if they do not fit.
        """
        try:
            items = self._items(values)
        except KeyError:
            raise UnreadableError from None
        self.values = _array(items if len(self._fields) > 1 else (items,), self._kind)

    def open(self, recording: Recording) -> None:
        """Takes the values of a recording, for `select`.

        Raises:
            UnreadableError: if they do not fit.
        """
        try:
            arrays = [recording[name] for name in self._fields]
        except KeyError:
            raise UnreadableError from None
        if len({array.dtype for array in arrays}) > 1:
            raise UnreadableError
        self._recorded = np.stack(arrays)

    def select(self, states: slice) -> None:
        """Takes the values of some states of the recording: a row for each state.

        Raises:
            UnreadableError: if they do not fit.
        """
        selected = np.ascontiguousarray(self._recorded[:, states].T)
        self.values = _checked(selected, self._kind)


class FieldVectors:
    """The columns that instances need, each loaded once for all of them."""

    def __init__(self) -> None:
        self._found: dict[tuple[tuple[str, ...], Kind | None], FieldVector] = {}

    def truths(self, atoms: Sequence[Atom], kinds: Kinds) -> Truths:
        """The truth of atoms that are alike, one for each instance."""
        atom = atoms[0]
        if not isinstance(atom, Comparison):
            column = self._column(atoms, Kind.BOOLEAN)
            return lambda: column.values
        compare = _COMPARE[atom.operator]
        left = self._terms([each.left for each in atoms if isinstance(each, Comparison)], kinds)
        right = self._terms([each.right for each in atoms if isinstance(each, Comparison)], kinds)
        if _is_open(atom.left, kinds) or _is_open(atom.right, kinds):
            return lambda: _compare_alike(compare, left(), right())
        return lambda: compare(left(), right())

    def load(self, values: Values) -> None:
        """Takes the values of a state.

        Raises:
            UnreadableError: if they do not fit.
        """
        for column in self._found.values():
            column.load(values)

    def open(self, recording: Recording) -> None:
        """Takes the values of a recording, for `select`.

        Raises:
            UnreadableError: if they do not fit.
        """
        for column in self._found.values():
            column.open(recording)

    def select(self, states: slice) -> None:
        """Takes the values of some states of the recording.

        Raises:
            UnreadableError: if they do not fit.
        """
        for column in self._found.values():
            column.select(states)

    def _column(self, terms: Iterable[Term | Atom], kind: Kind | None) -> FieldVector:
        fields = tuple(map(str, terms))
        return self._found.setdefault((fields, kind), FieldVector(fields, kind))

    def _terms(self, terms: Sequence[Term], kinds: Kinds) -> Callable[[], Any]:
        match terms[0]:
            case Number() | TextLiteral() | Truth():
                constant = _constant([term.value for term in terms if isinstance(term, _CONSTANTS)])
                return lambda: constant
            case Arithmetic(symbol):
                parts = [term for term in terms if isinstance(term, Arithmetic)]
                left = self._terms([part.left for part in parts], kinds)
                right = self._terms([part.right for part in parts], kinds)
                return lambda: _calculated(symbol, left(), right())
            case Feature() | FieldReference() as term:
                column = self._column(terms, kind_of(term, kinds))
                return lambda: column.values
            case _:  # pragma: no cover - ground atoms compare values
                raise AssertionError(terms[0])


_CONSTANTS = Number | TextLiteral | Truth


def bits(truths: Sequence[tuple[int, Truths]]) -> Array:
    """The truth of atoms as bits, from what was last loaded; the atoms by their slots."""
    found: Array | None = None
    for slot, holds in truths:
        bit = holds().view(np.uint8)
        shifted = bit << slot if slot else bit
        found = shifted if found is None else found | shifted
    assert found is not None  # noqa: S101 - there is an atom
    return found


def recorded(columns: Mapping[str, Iterable[Any]]) -> Recording:
    """The columns of a recording as arrays: numbers, booleans, or else objects."""
    return {name: _plain_array(column) for name, column in columns.items()}


def _is_open(term: Term, kinds: Kinds) -> bool:
    return isinstance(term, Feature | FieldReference) and kind_of(term, kinds) is None


def _plain_array(column: Iterable[Any]) -> Array:
    if isinstance(column, np.ndarray):
        wide = _WIDE.get(column.dtype.kind)
        narrow = wide is not None and column.dtype.itemsize <= np.dtype(wide).itemsize
        return column.astype(wide if narrow else object, copy=False)
    values = list(column)
    if set(map(type, values)) in ({bool}, {float}):
        return np.array(values)
    found = np.empty(len(values), dtype=object)
    found[:] = values
    return found


def _array(items: Sequence[Any], kind: Kind | None) -> Array:
    """The values of a state, checked."""
    types = set(map(type, items))
    found: Array
    if types == {bool}:
        found = np.frombuffer(bytes(items), dtype=bool)
    elif types in ({float}, {np.float64}):
        found = np.fromiter(items, float, len(items))
    elif types in ({int}, {str}):
        found = np.array(items, dtype=object)
    else:
        raise UnreadableError
    return _checked(found, kind)


def _checked(found: Array, kind: Kind | None) -> Array:
    """An array of one type, if it holds what that kind allows."""
    match found.dtype.kind:
        case 'f' if kind in {Kind.NUMBER, None}:
            if math.isnan(np.minimum.reduce(found, axis=None)):
                raise UnreadableError
        case 'i' if kind in {Kind.NUMBER, None}:
            if found.size and max(-int(found.min()), int(found.max())) >= EXACT:
                raise UnreadableError
        case 'b' if kind in {Kind.BOOLEAN, None}:
            pass
        case 'O':
            return _checked_objects(found, kind)
        case _:
            raise UnreadableError
    return found


def _checked_objects(found: Array, kind: Kind | None) -> Array:
    types = set(map(type, found.flat))
    if types == {str} and kind in {Kind.STRING, None}:
        return found
    if types == {int}:
        try:
            return _checked(found.astype(int), kind)
        except OverflowError:
            pass
    raise UnreadableError


def _constant(values: Sequence[Any]) -> Any:
    if len(set(values)) == 1:
        return values[0]
    if isinstance(values[0], str):
        found = np.empty(len(values), dtype=object)
        found[:] = values
        return found
    return np.array(values)


def _compare_alike(compare: Callable[[Any, Any], Any], left: Any, right: Any) -> Array:
    """Compares values of which only they tell what they are."""
    if len({_family(side) for side in (left, right)}) > 1:
        raise UnreadableError
    result: Array = compare(left, right)
    return result


def _family(side: Any) -> str:
    kind = np.asarray(side, dtype=object if isinstance(side, str) else None).dtype.kind
    return 'f' if kind == 'i' else kind


def _calculated(symbol: str, left: Any, right: Any) -> Any:
    """The result of arithmetic, as Python would compute it."""
    sides = [np.asarray(side, dtype=float) for side in (left, right)]
    whole = all(np.asarray(side).dtype.kind == 'i' for side in (left, right))
    if (whole and not _small(sides)) or (symbol == '/' and not sides[1].all()):
        raise UnreadableError
    with np.errstate(all='ignore'):
        result = _CALCULATE[symbol](*sides)
    if np.isnan(result).any():
        raise UnreadableError
    return result.astype(int) if whole and symbol != '/' else result


_CALCULATE: Mapping[str, Callable[[Any, Any], Any]] = {
    '+': operator.add,
    '-': operator.sub,
    '*': operator.mul,
    '/': operator.truediv,
}


def _small(sides: Iterable[Array]) -> bool:
    """Whether floats hold what integers would give: all products are below 2 ** 53."""
    return all(bool((np.abs(side) < 1 << 26).all()) for side in sides)
