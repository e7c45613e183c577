"""Batch keys: equal for instances whose atoms can be evaluated together as vectors."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Final

from dyknow_reasoning.language.formula import Atom, Comparison
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
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import fields, kind_of
from dyknow_reasoning.progression.functions import EXACT
from dyknow_reasoning.progression.instances import Instance

MAX_BATCH_SLOTS: Final = 6
"""The most atoms of instances in a batch, for which there are 2 ** 6 symbols."""


def batch_key(instance: Instance, kinds: Kinds) -> Hashable:
    """Return the template and the forms of the atoms; None if no batch can hold the instance."""
    forms = tuple(atom_form(atom, kinds) for atom in instance.atoms)
    slots = instance.node.mask.bit_length()
    return (instance.node, forms) if 0 < slots <= MAX_BATCH_SLOTS and None not in forms else None


def atom_form(atom: Atom, kinds: Kinds) -> Any:
    """Return all but the fields and constants of an atom.

    Return None if the atom cannot be evaluated with others, or depends on no field.
    """
    if not isinstance(atom, Comparison):
        return ('boolean',)
    left, right = _term_form(atom.left, kinds), _term_form(atom.right, kinds)
    is_constant = next(fields(atom), None) is None
    return None if is_constant or None in {left, right} else (atom.operator, left, right)


def _term_form(term: Term | Comparison, kinds: Kinds) -> Any:  # noqa: PLR0911 - one for each kind
    match term:
        case Number(value):
            return None if abs(value) >= EXACT else ('constant', type(value))
        case TextLiteral(value) | Truth(value):
            return ('constant', type(value))
        case Arithmetic(symbol, left, right):
            sides = _term_form(left, kinds), _term_form(right, kinds)
            return None if None in sides else (symbol, *sides)
        case Function(name, arguments):
            operands = [_term_form(each, kinds) for each in arguments]
            return None if None in operands else (name, *operands)
        case Comparison():
            return atom_form(term, kinds)
        case Feature() | FieldReference():
            return ('field', kind_of(term, kinds))
        case _:
            return None  # An object, which is compared with the text of a field.
