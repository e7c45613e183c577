"""Named constants: `let limit = 150 W in always Power[u] < limit`.

A constant is replaced by its value before names are resolved. Its name is nothing else in the same
formula, so it hides no feature.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Final, TypeAlias

from dyknow_common import NOWHERE, PositionedError, TextPosition, Value
from dyknow_reasoning.language.formula import (
    Formula,
    Let,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Feature,
    Number,
    Object,
    Quantity,
    TextLiteral,
    Truth,
    holds_terms,
)

Constant: TypeAlias = Number | Quantity | TextLiteral | Truth
"""The value of a constant."""

Constants: TypeAlias = tuple[tuple[str, Constant], ...]
"""Constants by their names."""

NO_CONSTANTS: Final[Constants] = ()

Units: TypeAlias = Mapping[str, str]
"""The units of features and references, by name."""

_Bound: TypeAlias = Mapping[str, tuple[Constant, TextPosition]]


def without_lets(formula: Formula, constants: Constants) -> tuple[Formula, Units]:
    """Return a formula with constants replaced by their values, and the units that it states.

    Args:
        formula: nests no deeper than functions may recurse.
        constants: those that the formula does not define.

    Raises:
        PositionedError: for a name that is a constant and something else, or two constants.
    """
    lets = [node for node in walk(formula) if isinstance(node, Let)]
    units: dict[str, str] = {}
    for feature, unit in (each for let in lets for each in let.units):
        if units.setdefault(feature.name, unit) != unit:
            message = f"'{feature}' has two units, {units[feature.name]} and {unit}; state one"
            raise PositionedError(message, feature.position)
    if not lets and not constants:
        return formula, units
    known = {name: (value, NOWHERE) for name, value in constants}
    replaced: Formula = _replaced(formula, known, is_operand=False)
    names = {name.name: name.position for let in lets for name, _ in let.constants}
    _check_uses(replaced, {**dict.fromkeys(known, NOWHERE), **names})
    return replaced, units


def literal_of(value: Value) -> Constant:
    """Return the term that stands for a value."""
    if isinstance(value, bool):
        return Truth(value)
    return TextLiteral(value) if isinstance(value, str) else Number(value)


def constants_of(node: Any, name: str) -> list[tuple[str, Constant]]:
    """Return the one constant that a formula `let NAME = VALUE in true` defines.

    Raises:
        PositionedError: if it defines another, or none.
    """
    is_one = isinstance(node, Let) and [each.name for each, _ in node.constants] == [name]
    if not is_one or node.units or node.body != Truth(True):
        message = f"the constant '{name}' must be one number, quoted text, true or false"
        raise PositionedError(message, NOWHERE)
    ((defined, value),) = node.constants
    return [(name, _checked(defined, value))]


def _checked(name: Object, value: Any) -> Constant:
    if not isinstance(value, Constant):
        raise PositionedError(
            f"the constant '{name}' must be a number, a quoted text, true or false",
            name.position,
        )
    return value


def _replaced(node: Any, bound: _Bound, *, is_operand: bool) -> Any:
    match node:
        case Let(constants, _, body):
            return _replaced(body, {**bound, **_new(constants, bound)}, is_operand=False)
        case Feature(name, ()) if name in bound:
            value, _ = bound[name]
            if not is_operand and not isinstance(value, Truth):
                raise PositionedError(
                    f"the constant '{name}' is {value}, not a formula; compare it with another",
                    node.position,
                )
            return replace(value, position=node.position)
    are_operands = holds_terms(node)
    return with_changed_parts(node, lambda part: _replaced(part, bound, is_operand=are_operands))


def _new(
    constants: Iterable[tuple[Object, Any]], bound: _Bound
) -> dict[str, tuple[Constant, TextPosition]]:
    found: dict[str, tuple[Constant, TextPosition]] = {}
    for name, value in constants:
        first = found.get(name.name) or bound.get(name.name)
        if first is not None:
            message = f"the constant '{name}' is defined already, {_place(first[1])}"
            raise PositionedError(f'{message}; choose another name', name.position)
        found[name.name] = _checked(name, value), name.position
    return found


def _check_uses(formula: Formula, constants: Mapping[str, TextPosition]) -> None:
    """Check that no name of a constant names anything else."""
    for node in walk(formula):
        uses: dict[str, str | None] = {
            'feature': node.name if isinstance(node, Feature) else None,
            'object': node.name if isinstance(node, Object) else None,
            'variable': getattr(node, 'variable', None),
            'sort': getattr(node, 'sort', None),
        }
        for kind, name in uses.items():
            if name is not None and name in constants:
                article = 'an' if kind == 'object' else 'a'
                raise PositionedError(
                    f"'{name}' is {article} {kind} here and a constant {_place(constants[name])}; "
                    'rename the constant',
                    node.position,
                )


def _place(position: TextPosition) -> str:
    return 'in the configuration' if position == NOWHERE else f'at {position}'
