"""Forms of atoms: atoms of one form can be evaluated together as vectors."""

from __future__ import annotations

from typing import Any, Final

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
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import fields, kind_of

EXACT: Final = 1 << 53
"""The least absolute value from which on not every integer is a float."""


def form(atom: Atom, kinds: Kinds) -> Any:
    """What atoms must share to be evaluated together: all but their fields and constants.

    None if an atom cannot be evaluated with others, or depends on no field.
    """
    if not isinstance(atom, Comparison):
        return ('boolean',)
    left, right = _form_of_term(atom.left, kinds), _form_of_term(atom.right, kinds)
    constant = next(fields(atom), None) is None
    return None if constant or None in {left, right} else (atom.operator, left, right)


def _form_of_term(term: Term, kinds: Kinds) -> Any:
    match term:
        case Number(value):
            return None if abs(value) >= EXACT else ('constant', type(value))
        case TextLiteral(value) | Truth(value):
            return ('constant', type(value))
        case Arithmetic(symbol, left, right):
            sides = _form_of_term(left, kinds), _form_of_term(right, kinds)
            return None if None in sides else (symbol, *sides)
        case Feature() | FieldReference():
            return ('field', kind_of(term, kinds))
        case _:  # pragma: no cover - ground atoms compare values
            raise AssertionError(term)
