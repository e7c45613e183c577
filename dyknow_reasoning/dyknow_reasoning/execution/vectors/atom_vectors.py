"""Evaluation of the atoms of many instances at once, over vectors of field values.

A vector of truth has an entry for each instance; over a recording it has a row for each state. A
value that a vector cannot represent exactly (another type, a missing field, an integer that no
float equals) raises `UnreadableError`. The states must then be read value by value. Atoms are
evaluated together if they have one *form*, and instances with one `batch_key`.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from operator import countOf, itemgetter
from struct import Struct
from typing import Any, Final, TypeAlias
from weakref import WeakValueDictionary

import numpy as np

from dyknow_common import COMPARISONS, TEXT_COMPARISONS
from dyknow_reasoning.language.formula import Atom, Comparison, Freeze
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Feature,
    FieldReference,
    Function,
    Number,
    Term,
    TextLiteral,
    Truth,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds, kind_of
from dyknow_reasoning.progression.atoms import (
    CALCULATE,
    Values,
    field_name,
    fields,
    has_unknown_kind,
)
from dyknow_reasoning.progression.functions import EXACT, call_function_on_vectors
from dyknow_reasoning.progression.instances import Instance

Array: TypeAlias = 'np.ndarray[Any, np.dtype[Any]]'

Truths: TypeAlias = Callable[[], Array]
"""The truth of an atom for each instance, from the values that were last loaded."""

Columns: TypeAlias = Mapping[str, Array]
"""For each field, its values at the states of a recording."""

# By the letters of numpy: the kinds of fields that may have values of a type.
_KINDS: Mapping[str, tuple[Kind | None, ...]] = {
    'f': (Kind.NUMBER, None),
    'i': (Kind.NUMBER, None),
    'b': (Kind.BOOLEAN, None),
}
_WIDE: Mapping[str, type] = {'i': int, 'f': float}
_MAX_INT = (1 << 63) - 1


class UnreadableError(Exception):
    """The values do not fit into vectors."""


VectorKey: TypeAlias = tuple[tuple[str, ...], Kind | None]
"""The names of fields, and the kind of their values."""


class VectorState(dict[str, Any]):
    """The values of a state by the names of their fields; they do not change.

    Fields whose values were computed as a vector are added when one of them is looked up.
    """

    _computed: tuple[tuple[Sequence[str], Array], ...] = ()

    def add(self, fields: Sequence[str], vector: Array) -> None:
        """Add fields with the values of a vector."""
        self._computed += ((fields, vector),)

    def __missing__(self, name: str) -> Any:
        computed, self._computed = self._computed, ()
        for names, vector in computed:
            self.update(zip(names, vector.tolist(), strict=True))
        if name in self:
            return self[name]
        raise KeyError(name)


class FieldVector:
    """The value of one field for each instance.

    Args:
        fields: the names of the fields, in the order of the instances.
        kind: the kind of the values; None if only the values show it.
    """

    def __init__(self, fields: tuple[str, ...], kind: Kind | None) -> None:
        self.values: Array = np.empty(0)
        self._fields = fields
        self._kind = kind
        self._items: Callable[[Values], Any] = itemgetter(*fields)
        self._pack = Struct(f'{len(fields)}d').pack
        self._state: VectorState | None = None

    def load(self, values: Values) -> None:
        """Load the values of a state; raise UnreadableError if they do not fit."""
        if values is self._state:
            return
        self._state = None
        try:
            items = self._items(values)
        except KeyError:
            raise UnreadableError from None
        self.values = self._array(items if len(self._fields) > 1 else (items,))
        if isinstance(values, VectorState):
            self._state = values

    def compute(self, values: Array, state: VectorState) -> None:
        """Set the values at a state, and add the fields to it."""
        self.values, self._state = values, state
        state.add(self._fields, values)

    def select(self, recording: Columns, states: slice) -> None:
        """Load states of a recording, as rows; raise UnreadableError if they do not fit."""
        self._state = None
        try:
            arrays = [recording[name][states] for name in self._fields]
        except KeyError:
            raise UnreadableError from None
        if len({array.dtype for array in arrays}) > 1:
            raise UnreadableError
        self.values = checked(np.ascontiguousarray(np.stack(arrays).T), self._kind)

    def _array(self, items: Sequence[Any]) -> Array:
        first = type(items[0])
        if countOf(map(type, items), first) != len(items):
            raise UnreadableError
        found: Array
        if first is float or first is np.float64:
            found = np.frombuffer(self._pack(*items))  # Faster than numpy from items.
        elif first is bool:
            found = np.frombuffer(bytes(items), dtype=bool)
        elif first is int or first is str:
            found = np.array(items, dtype=object)
        else:
            raise UnreadableError
        return checked(found, self._kind)


SharedVectors: TypeAlias = WeakValueDictionary[VectorKey, FieldVector]
"""The vectors in use; each is loaded once for all that need it."""


class FieldVectors:
    """The vectors that instances read, each loaded once for all of them.

    Args:
        shared: the vectors that others read, too.
    """

    def __init__(self, shared: SharedVectors | None = None) -> None:
        self._found: dict[VectorKey, FieldVector] = {}
        self._shared = SharedVectors() if shared is None else shared

    def truths(self, atoms: Sequence[Atom], kinds: Kinds) -> Truths:
        """Return the truth of atoms of one form, one for each instance."""
        atom = atoms[0]
        if not isinstance(atom, Comparison):
            field = self._field(atoms, Kind.BOOLEAN)
            return lambda: field.values
        compare: Callable[[Any, Any], Any] = COMPARISONS[atom.operator]
        if atom.operator in TEXT_COMPARISONS:
            compare = np.vectorize(compare, otypes=[bool])
        left = self.terms([each.left for each in atoms if isinstance(each, Comparison)], kinds)
        right = self.terms([each.right for each in atoms if isinstance(each, Comparison)], kinds)
        if has_unknown_kind(atom, kinds):
            return lambda: _compare_same_kind(compare, left(), right())
        return lambda: compare(left(), right())

    def vector(self, fields: tuple[str, ...], kind: Kind | None) -> FieldVector:
        """Return the vector of some fields."""
        key = fields, kind
        if key not in self._found:
            self._found[key] = self._shared.setdefault(key, FieldVector(fields, kind))
        return self._found[key]

    def load(self, values: Values) -> None:
        """Load the values of a state; raise UnreadableError if they do not fit."""
        for field in self._found.values():
            field.load(values)

    def select(self, recording: Columns, states: slice) -> None:
        """Load states of a recording; raise UnreadableError if they do not fit."""
        for field in self._found.values():
            field.select(recording, states)

    def _field(self, terms: Iterable[Term | Atom], kind: Kind | None) -> FieldVector:
        return self.vector(tuple(map(field_name, terms)), kind)

    def terms(self, terms: Sequence[Any], kinds: Kinds) -> Callable[[], Any]:
        """Return the values of terms of one form, one for each instance."""
        match terms[0]:
            case Number() | TextLiteral() | Truth():
                constant = _constant([term.value for term in terms if isinstance(term, _CONSTANTS)])
                return lambda: constant
            case Arithmetic(symbol):
                parts = [term for term in terms if isinstance(term, Arithmetic)]
                left = self.terms([part.left for part in parts], kinds)
                right = self.terms([part.right for part in parts], kinds)
                return lambda: _calculated(symbol, left(), right())
            case Function(name):
                calls = [term for term in terms if isinstance(term, Function)]
                columns = zip(*(call.arguments for call in calls), strict=True)
                operands = [self.terms(column, kinds) for column in columns]
                return lambda: _called(name, [operand() for operand in operands])
            case Comparison():
                return self.truths(terms, kinds)
            case Feature() | FieldReference() as term:
                field = self._field(terms, kind_of(term, kinds))
                return lambda: field.values
            case _:  # pragma: no cover - atoms compare values
                raise AssertionError(terms[0])


_CONSTANTS = Number | TextLiteral | Truth


def bits(truths: Sequence[tuple[int, Truths]]) -> Array:
    """Return the truth of atoms as bits; the slots of the atoms must increase."""
    integer = _integer_for(truths[-1][0])
    found: Array | None = None
    for slot, holds in truths:
        bit = holds().view(np.uint8)
        if integer is not np.uint8:
            bit = bit.astype(integer)
        shifted = bit << slot if slot else bit
        found = shifted if found is None else found | shifted
    assert found is not None  # noqa: S101 - there is an atom
    return found


def _integer_for(slot: int) -> type:
    """Return the smallest type of integers that has a bit for a slot."""
    if slot < 8:  # noqa: PLR2004 - the bits of a byte
        return np.uint8
    return np.int64 if slot < 63 else object  # noqa: PLR2004 - one bit is the sign


def column_vector(column: Iterable[Any]) -> Array:
    """Return a column of a recording as a vector of numbers or booleans, or else of objects."""
    if isinstance(column, np.ndarray) and is_masked(column):
        unmasked: Array = np.asarray(column).astype(object)
        unmasked[np.ma.getmaskarray(column)] = None
        return unmasked
    if isinstance(column, np.ndarray):
        return _plain(column)
    values = list(column)
    types = set(map(type, values))
    if types in ({bool}, {float}):
        return np.array(values)
    if types == {int} and min(values) >= -_MAX_INT and max(values) <= _MAX_INT:
        return np.array(values, int)
    return _object_vector(values)


def is_masked(column: Array) -> bool:
    """Return True for an array of `numpy.ma`; plain arrays do not load that module."""
    return type(column) is not np.ndarray and isinstance(column, np.ma.MaskedArray)


def _plain(column: Array) -> Array:
    """Return numbers and booleans in the types that Python has, other values as objects."""
    kind, size = column.dtype.kind, column.dtype.itemsize
    if kind == 'b':
        # A truth may be any byte but 0 if it was read from a message.
        return np.not_equal(column.view(np.uint8), 0)
    if kind == 'u' and (size < np.dtype(int).itemsize or int(column.max(initial=0)) <= _MAX_INT):
        return column.astype(int)
    is_narrow = kind in _WIDE and size <= np.dtype(_WIDE[kind]).itemsize
    return column.astype(_WIDE[kind] if is_narrow else object, copy=False)


def _object_vector(values: Sequence[Any]) -> Array:
    return np.fromiter(values, object, len(values))


def checked(found: Array, kind: Kind | None) -> Array:
    """Return a vector of one type; raise UnreadableError if the kind does not allow its values."""
    letter = found.dtype.kind
    if letter == 'O':
        return _checked_objects(found, kind)
    if kind not in _KINDS.get(letter, ()):
        raise UnreadableError
    if letter == 'f' and np.count_nonzero(np.isnan(found)):
        raise UnreadableError
    if letter == 'i' and found.size and max(-int(found.min()), int(found.max())) >= EXACT:
        raise UnreadableError
    return found


def _checked_objects(found: Array, kind: Kind | None) -> Array:
    types = set(map(type, found.flat))
    if types == {str} and kind in {Kind.STRING, None}:
        return found
    if types == {int}:
        try:
            return checked(found.astype(int), kind)
        except OverflowError:
            pass
    raise UnreadableError


def _constant(values: Sequence[Any]) -> Any:
    if len(set(values)) == 1:
        # Arrays are faster operands than numbers.
        return np.array(values[0]) if type(values[0]) in {int, float} else values[0]
    if isinstance(values[0], str):
        return _object_vector(values)
    return np.array(values)


def _compare_same_kind(compare: Callable[[Any, Any], Any], left: Any, right: Any) -> Array:
    if _family(left) != _family(right):
        raise UnreadableError
    result: Array = compare(left, right)
    return result


def _family(side: Any) -> str:
    kind = np.asarray(side, dtype=object if isinstance(side, str) else None).dtype.kind
    return 'f' if kind == 'i' else kind


def _calculated(symbol: str, left: Any, right: Any) -> Any:
    """Return the result of arithmetic, exactly as Python computes it for single values."""
    sides = [np.asarray(side, dtype=float) for side in (left, right)]
    whole = all(np.asarray(side).dtype.kind == 'i' for side in (left, right))
    if (whole and not _are_small(sides)) or (symbol == '/' and not sides[1].all()):
        raise UnreadableError
    with np.errstate(all='ignore'):
        result = CALCULATE[symbol](*sides)
    if np.isnan(result).any():
        raise UnreadableError
    return result.astype(int) if whole and symbol != '/' else result


def _called(name: str, operands: Sequence[Any]) -> Array:
    """Return the values of a function, exactly as for single values."""
    result = call_function_on_vectors(name, operands)
    if np.isnan(result).any():
        raise UnreadableError
    return result


def _are_small(sides: Iterable[Array]) -> bool:
    """Return True if all products of integers are below 2 ** 53, so that floats are exact."""
    return all(bool((np.abs(side) < 1 << 26).all()) for side in sides)


MAX_BATCH_SLOTS: Final = 6
"""The most atoms of an instance in a batch: they have 2 ** 6 symbols."""


def batch_key(instance: Instance, kinds: Kinds) -> Hashable:
    """Return the template and the forms of the atoms; None if no batch can hold the instance."""
    forms = tuple(atom_form(atom, kinds) for atom in instance.atoms)
    slots = instance.node.mask.bit_length()
    return (instance.node, forms) if 0 < slots <= MAX_BATCH_SLOTS and None not in forms else None


def atom_form(atom: Atom | Freeze, kinds: Kinds) -> Any:
    """Return all but the fields and constants of an atom.

    Return None if the atom cannot be evaluated with others, or depends on no field.
    """
    if isinstance(atom, Freeze):
        return None  # It stands for another formula at each state.
    if not isinstance(atom, Comparison):
        return ('boolean',)
    left, right = term_form(atom.left, kinds), term_form(atom.right, kinds)
    is_constant = next(fields(atom), None) is None
    return None if is_constant or None in {left, right} else (atom.operator, left, right)


def term_form(term: Term | Comparison, kinds: Kinds) -> Any:  # noqa: PLR0911 - one for each kind
    """Return all but the fields and constants of a term; None as of `atom_form`."""
    match term:
        case Number(value):
            return None if abs(value) >= EXACT else ('constant', type(value))
        case TextLiteral(value) | Truth(value):
            return ('constant', type(value))
        case Arithmetic(symbol, left, right):
            sides = term_form(left, kinds), term_form(right, kinds)
            return None if None in sides else (symbol, *sides)
        case Function(name, arguments):
            operands = [term_form(each, kinds) for each in arguments]
            return None if None in operands else (name, *operands)
        case Comparison():
            return atom_form(term, kinds)
        case Feature() | FieldReference():
            return ('field', kind_of(term, kinds))
        case _:
            return None  # An object: it is compared with the text of a field.
