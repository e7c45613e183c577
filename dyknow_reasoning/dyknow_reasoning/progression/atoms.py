"""Atoms without variables, as predicates over the values of a state."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from typing import Any, Final, TypeAlias, cast

from dyknow_common import COMPARISONS, Value
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.language.formula import (
    Atom,
    Comparison,
    Formula,
    PastAtom,
    compares_past,
    parts,
    walk,
)
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Feature,
    FieldReference,
    Function,
    Number,
    PastTerm,
    Term,
    TextLiteral,
    Truth,
)
from dyknow_reasoning.language.type_checking import Kind, Kinds, kind_of
from dyknow_reasoning.progression.functions import call_function

Values: TypeAlias = Mapping[str, Value]
"""A value for each ground feature, by its canonical text."""

Predicate: TypeAlias = Callable[[Values], bool]
"""The truth of an atom at a state; raises ReasoningError if the values are unusable."""

Reader: TypeAlias = Callable[[Values], Any]

CALCULATE: Mapping[str, Callable[[Any, Any], Any]] = {
    '+': operator.add,
    '-': operator.sub,
    '*': operator.mul,
    '/': operator.truediv,
}
"""The arithmetic operators."""

_PYTHON_TYPES: Mapping[Kind | None, tuple[type, ...]] = {
    Kind.NUMBER: (float, int),
    Kind.BOOLEAN: (bool,),
    Kind.STRING: (str,),
}

POSITIVE_COMPARISONS = frozenset({'=', '<', '<=', 'contains', 'starts with'})
"""One comparison operator of each pair of opposites."""

MAX_GENERATED: Final = 256
"""The most atoms or fields for which code is generated, as Python compiles it recursively."""


class NoStateBeforeError(Exception):
    """A value of the past is asked for where there was no state before."""


def field_name(node: Term | Atom) -> str:
    """Return the name of the field that holds the value of a feature or of a past operator."""
    return node.field if isinstance(node, PastAtom) else str(node)


def fields(node: Formula | Term) -> Iterator[Feature | FieldReference]:
    """Return the features and syntactic references of a formula, in the order of the text."""
    return (part for part in walk(node) if isinstance(part, Feature | FieldReference))


def evaluate(term: Term | Comparison, values: Values) -> Value:
    """Return the value of a term without variables; the state must hold its features."""
    found: Value = term_reader(term, {})(values)
    return found


def generated_reader(
    variables: Mapping[str, str],
    unusual: str,
    result: str,
    names: Mapping[str, Any],
    careful: Callable[[Values], Any],
) -> Callable[[Values], Any]:
    """Return a function of a state, of generated code that reads each field once.

    Args:
        variables: the fields, by the names of their variables in the code.
        unusual: the condition under which `careful` reads the state, also if a field is missing.
        result: the expression for the result.
        names: what other names in the expressions stand for.
        careful: reads any state.
    """
    reads = '; '.join(f'{name} = values[{text!r}]' for name, text in variables.items())
    known = {**names, 'careful': careful}
    exec(  # noqa: S102 - built from checked parts
        f"""
def read(values):
    try: {reads}
    except KeyError: return careful(values)
    if {unusual}: return careful(values)
    return {result}
""",
        known,
    )
    return cast('Callable[[Values], Any]', known['read'])


def predicate(atom: Atom, kinds: Kinds) -> Predicate:
    """Return the predicate of an atom without variables.

    Args:
        atom: the atom.
        kinds: the kinds of features, from `check_types`.
    """
    if not isinstance(atom, Comparison):
        return _field(atom, Kind.BOOLEAN)
    holds = _comparison(atom, kinds)
    return _false_without_past(atom, holds, kinds) if compares_past(atom) else holds


def _comparison(atom: Comparison, kinds: Kinds) -> Predicate:
    compare = COMPARISONS[atom.operator]
    left, right = term_reader(atom.left, kinds), term_reader(atom.right, kinds)
    if isinstance(atom.right, Number | TextLiteral | Truth) and not has_unknown_kind(atom, kinds):
        constant = atom.right.value
        return lambda values: compare(left(values), constant)
    if has_unknown_kind(atom, kinds):
        return _compare_same_kind(atom, left, right)
    return lambda values: compare(left(values), right(values))


def _false_without_past(atom: Comparison, holds: Predicate, kinds: Kinds) -> Predicate:
    """Return a predicate that is false where a value before is missing, if the others are usable.

    So `prev(x) < 5` is `previous (x < 5)`, also at the first state and for each operator.
    """
    others = [term_reader(each, kinds) for each in _present_fields(atom)]

    def holds_with_past(values: Values) -> bool:
        try:
            return holds(values)
        except NoStateBeforeError:
            for read in others:
                read(values)
            return False

    return holds_with_past


def _present_fields(node: Formula | Term) -> Iterator[Feature | FieldReference]:
    """Return the features of a comparison whose present values it compares."""
    if isinstance(node, Feature | FieldReference):
        yield node
    elif not isinstance(node, PastTerm):
        for part in parts(node):
            yield from _present_fields(part)


def has_unknown_kind(atom: Comparison, kinds: Kinds) -> bool:
    """Return True if only the values show the kind of a side of a comparison."""
    return None in {kind_of(side, kinds) for side in (atom.left, atom.right)}


def _compare_same_kind(atom: Comparison, left: Reader, right: Reader) -> Predicate:
    compare = COMPARISONS[atom.operator]

    def holds(values: Values) -> bool:
        first, second = left(values), right(values)
        if _kind_of_value(first) is not _kind_of_value(second):
            raise ReasoningError(
                f"'{atom}' compares {_description(first)} with {_description(second)}; "
                'both must be of one type'
            )
        return compare(first, second)

    return holds


def term_reader(term: Term | Comparison, kinds: Kinds) -> Reader:  # noqa: PLR0911
    """Return the value of a term without variables; it raises ReasoningError if unusable.

    Args:
        term: the term.
        kinds: the kinds of features, from `check_types`.
    """
    match term:
        case Number(value) | TextLiteral(value) | Truth(value):
            return lambda _: value
        case Arithmetic():
            return _calculation(term, kinds)
        case Function():
            return _call(term, kinds)
        case Comparison():
            return predicate(term, kinds)
        case Feature() | FieldReference():
            return _field(term, kind_of(term, kinds))
        case PastTerm():
            return _past_value(term)
        case _:
            name = str(term)  # The name of an object, as in the text of a field.
            return lambda _: name


def _past_value(term: PastTerm) -> Reader:
    name = str(term)

    def read(values: Values) -> Value:
        value: Value | ReasoningError | None = values[name]
        if value is None:
            raise NoStateBeforeError
        if isinstance(value, ReasoningError):
            raise value
        return value

    return read


def _calculation(term: Arithmetic, kinds: Kinds) -> Reader:
    calculate = CALCULATE[term.operator]
    left, right = term_reader(term.left, kinds), term_reader(term.right, kinds)

    def read(values: Values) -> int | float:
        first, second = left(values), right(values)
        try:
            result: int | float = calculate(first, second)
        except ArithmeticError as error:
            shown = f'{first} {term.operator} {second}'
            raise UnusableValueError(f"'{term}' is {shown}: {error}") from None
        if result != result:  # noqa: PLR0124 - only NaN differs from itself
            raise UnusableValueError(f"'{term}' is {first} {term.operator} {second}: not a number")
        return result

    return read


def _call(term: Function, kinds: Kinds) -> Reader:
    readers = [term_reader(each, kinds) for each in term.arguments]

    def read(values: Values) -> int | float:
        operands = [reader(values) for reader in readers]
        try:
            return call_function(term.name, operands)
        except ReasoningError as error:
            shown = ', '.join(map(str, operands))
            raise UnusableValueError(f"'{term}' is {term.name}({shown}): {error}") from None

    return read


def _field(term: Feature | FieldReference | PastAtom, kind: Kind | None) -> Reader:
    name = field_name(term)
    types = _PYTHON_TYPES.get(kind, tuple(chain.from_iterable(_PYTHON_TYPES.values())))
    # Subclasses, such as the floats of numpy, are usable as numbers only.
    subclass_kinds = {Kind.NUMBER: {Kind.NUMBER}, None: set(Kind)}.get(kind, set[Kind]())

    def read(values: Values) -> Value:
        try:
            value = values[name]
        except KeyError:
            raise ReasoningError(
                f"the state has no field '{name}'; the state stream must hold it"
            ) from None
        is_usable = type(value) in types or _kind_of_value(value) in subclass_kinds
        if is_usable and value == value:  # noqa: PLR0124 - not NaN
            return value
        if isinstance(error := cast('object', value), ReasoningError):
            raise error  # Of an operand of a past operator.
        if is_usable:
            is_reference = isinstance(term, FieldReference)
            mend = "add 'missing: unknown' to the feature"
            mend = "use a feature from it with 'missing: unknown'" if is_reference else mend
            raise UnusableValueError(
                f"the field '{name}' holds nan, not a number",
                f"{mend} in robot.yaml, or check the recording with '--missing unknown'",
            )
        wanted = f'a {kind}' if kind else 'a number, a string or a boolean'
        mend = ' of Python; write value.item()' if type(value).__module__ == 'numpy' else ''
        raise ReasoningError(f"the field '{name}' holds {_description(value)}, not {wanted}{mend}")

    return read


def _kind_of_value(value: object) -> Kind | None:
    if isinstance(value, bool):
        return Kind.BOOLEAN
    if isinstance(value, int | float):
        return Kind.NUMBER
    return Kind.STRING if isinstance(value, str) else None


def _description(value: object) -> str:
    kind, own = _kind_of_value(value), type(value)
    if own.__module__ == 'numpy':
        return f'a value of type numpy.{own.__name__}'
    if kind is None:
        return f'a value of type {own.__name__}'
    if kind is Kind.STRING:
        return f'the string "{value}"'
    return f'the {kind} {str(value).lower()}'
