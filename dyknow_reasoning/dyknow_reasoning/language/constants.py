"""Names that `let` defines: `let limit = 150 W in always Power[u] < limit`.

A constant is replaced by its value before names are resolved. Its name is nothing else in the same
formula, so it hides no feature.

The value may also be a term, `let before = Speed in eventually[0 s, 3 s] Speed < before - 1`. It is
kept from the state at which the formula is reached (`Freeze`), as in temporal logics with freeze
quantifiers (R. Alur and T. A. Henzinger, "A really temporal logic", 1994).

In `let Height ~ normal(Height, sqrt(Variance), 2 s) in P(always Height[u] > 3) > 0.9`, a name after
`~` stands for the feature of the same objects, so the formula is
`P(always normal(Height[u], sqrt(Variance[u]), 2 s) > 3) > 0.9`. Outside of `P(...)`, Height is its
best estimate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import islice
from typing import Any, Final, TypeAlias

from dyknow_common import NOWHERE, PositionedError, TextPosition, Value, shortened
from dyknow_reasoning.language.formula import (
    Formula,
    Freeze,
    Let,
    PastFormula,
    Soon,
    SpatialSyntax,
    contains,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Covariance,
    Feature,
    FieldReference,
    Kept,
    Number,
    Object,
    PastTerm,
    Probability,
    Quantity,
    Term,
    TextLiteral,
    Truth,
    Uncertain,
    Variable,
    holds_terms,
)

Constant: TypeAlias = Number | Quantity | TextLiteral | Truth
"""The value of a constant."""

Constants: TypeAlias = tuple[tuple[str, Constant], ...]
"""Constants by their names."""

NO_CONSTANTS: Final[Constants] = ()

Units: TypeAlias = Mapping[str, str]
"""The units of features and references, by name."""

_Bound: TypeAlias = Mapping[str, tuple[Constant | Kept, TextPosition]]

_NOT_AROUND: Final = PastFormula | PastTerm | SpatialSyntax | Soon
"""Nodes that may neither contain a formula with a kept value nor be inside one."""

MAX_TERM_PARTS: Final = 100
"""The most parts of a term whose value is kept: each use of the name copies the term."""


def without_lets(
    formula: Formula, constants: Constants
) -> tuple[Formula, Units, dict[str, Uncertain]]:
    """Return a formula with constants replaced by their values, and what it states of features.

    Args:
        formula: nests no deeper than functions may recurse.
        constants: the constants that the formula does not define.

    Returns:
        The formula, the units, and the uncertainties of features by name.

    Raises:
        PositionedError: for a name that is a constant and something else, or two constants, or
            that has two statements.
    """
    lets = [node for node in walk(formula) if isinstance(node, Let)]
    units: dict[str, str] = {}
    for feature, unit in (each for let in lets for each in let.units):
        if units.setdefault(feature.name, unit) != unit:
            message = f"'{feature}' has two units, {units[feature.name]} and {unit}; state one"
            raise PositionedError(message, feature.position)
    uncertain: dict[str, Uncertain] = {}
    if not lets and not constants:
        return formula, units, uncertain
    known = {name: (value, NOWHERE) for name, value in constants}
    replaced: Formula = _replaced(formula, known, uncertain, is_operand=False)
    if contains(replaced, Freeze):
        _check_kept(replaced)
    names = {name.name: name.position for let in lets for name, _ in let.constants}
    stated = (name for let in lets for name, _ in let.uncertainties)
    features = (Feature(each.name, position=each.position) for each in stated)
    for each in (replaced, *uncertain.values(), *features):
        _check_uses(each, {**dict.fromkeys(known, NOWHERE), **names})
    return replaced, units, uncertain


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
            f"the constant '{name}' must be a number, a quoted text, true or false; or a term with "
            'a feature, whose value is kept',
            name.position,
        )
    return value


def _value(name: Object, value: Any, bound: _Bound) -> Constant | Kept:
    """Return a constant, or the value of a term that is to be kept."""
    term = _replaced(value, bound, {}, is_operand=True)
    parts = list(islice(walk(term), MAX_TERM_PARTS + 1))
    if not isinstance(term, Term) or not any(
        isinstance(each, Feature | FieldReference) for each in parts
    ):
        return _checked(name, term)
    if len(parts) > MAX_TERM_PARTS:
        message = f"the value of '{name}' has more than {MAX_TERM_PARTS} parts; write less in one"
        raise PositionedError(message, name.position)
    return Kept(name.name, term)


def _check_kept(formula: Formula) -> None:
    """Check that kept values are used, and apart from operators of the past and of space."""
    for node in walk(formula):
        inner = list(walk(node)) if isinstance(node, Freeze | _NOT_AROUND) else []
        if isinstance(node, Freeze):
            found = next((each for each in inner if isinstance(each, _NOT_AROUND)), None)
            if found is not None:
                message = f"'{shortened(found)}' cannot stand in 'let {node.name} = ...'"
                raise PositionedError(
                    f'{message}; make it a feature of a stream, or move it before the let',
                    found.position,
                )
            if not any(isinstance(each, Kept) and each.name == node.name for each in inner):
                raise PositionedError(f"nothing uses '{node.name}'; leave it out", node.position)
        elif freeze := next((each for each in inner if isinstance(each, Freeze)), None):
            message = (
                f"the value of '{freeze.name}' is kept for states to come; '{shortened(node)}'"
            )
            raise PositionedError(f'{message} cannot hold that; move it out', freeze.position)


def _replaced(
    node: Any, bound: _Bound, uncertain: dict[str, Uncertain], *, is_operand: bool
) -> Any:
    """Return a part with constants replaced by their values; note what it says is uncertain."""
    match node:
        case Let(constants, _, body, uncertainties):
            new = _new(constants, bound)
            inner = {**bound, **new}
            for feature, stated in uncertainties:
                _state(feature, _replaced(stated, inner, {}, is_operand=True), uncertain)
            body = _replaced(body, inner, uncertain, is_operand=False)
            for name, (value, position) in reversed(new.items()):
                if isinstance(value, Kept):
                    body = Freeze(name, value.body, body, position=position)
            return body
        case Feature(name, ()) if name in bound:
            value, _ = bound[name]
            if isinstance(value, Kept) and not is_operand:
                message = f"'{name}' is a kept value, not a formula; compare it: {name} = true"
                raise PositionedError(message, node.position)
            if not is_operand and not isinstance(value, Truth):
                raise PositionedError(
                    f"the constant '{name}' is {value}, not a formula; compare it with another",
                    node.position,
                )
            return replace(value, position=node.position)
    are_operands = holds_terms(node)
    return with_changed_parts(
        node, lambda part: _replaced(part, bound, uncertain, is_operand=are_operands)
    )


def _state(feature: Object, value: Uncertain, uncertain: dict[str, Uncertain]) -> None:
    """Note what is known of a feature."""
    if kept := next((each for each in walk(value) if isinstance(each, Kept)), None):
        message = f"'{kept}' is a kept value, which tells nothing of the errors of '{feature}'"
        raise PositionedError(f'{message}; write a constant or a feature', feature.position)
    if uncertain.setdefault(feature.name, value) != value:
        message = f"'{feature}' is uncertain in two ways; state one"
        raise PositionedError(message, feature.position)


def _new(
    constants: Iterable[tuple[Object, Any]], bound: _Bound
) -> dict[str, tuple[Constant | Kept, TextPosition]]:
    found: dict[str, tuple[Constant | Kept, TextPosition]] = {}
    for name, value in constants:
        first = found.get(name.name) or bound.get(name.name)
        if first is not None:
            message = f"the constant '{name}' is defined already, {_place(first[1])}"
            raise PositionedError(f'{message}; choose another name', name.position)
        found[name.name] = _value(name, value, {**bound, **found}), name.position
    return found


def _check_uses(formula: Formula | Term, constants: Mapping[str, TextPosition]) -> None:
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


def with_uncertain_features(formula: Formula, stated: Mapping[str, Uncertain]) -> Formula:
    """Return a formula in which probabilities are of uncertain numbers."""
    changed: Formula = _changed(formula, stated, is_within=False) if stated else formula
    return changed


def _changed(node: Any, stated: Mapping[str, Uncertain], *, is_within: bool) -> Any:
    """Return a part, which may be within a probability."""
    match node:
        case Uncertain():
            return node
        case Probability():
            is_within, stated = True, _among(node, stated)
        case _ if is_within and holds_terms(node):
            return with_changed_parts(node, lambda part: _operand(part, stated))
    return with_changed_parts(node, lambda part: _changed(part, stated, is_within=is_within))


def _among(probability: Probability, stated: Mapping[str, Uncertain]) -> Mapping[str, Uncertain]:
    """Return what is known of the features in a probability, without covariances with others."""
    used = {each.name for each in walk(probability) if isinstance(each, Feature)}

    def is_used(covariance: Covariance) -> bool:
        return not isinstance(covariance.left, Feature) or covariance.left.name in used

    return {
        name: replace(each, covariances=tuple(filter(is_used, each.covariances)))
        for name, each in stated.items()
    }


def _operand(node: Any, stated: Mapping[str, Uncertain]) -> Any:
    if isinstance(node, Feature) and node.name in stated:
        found = _of_objects(stated[node.name], node.arguments)
        return replace(found, position=node.position)
    return _changed(node, stated, is_within=True)


def _of_objects(node: Any, arguments: tuple[Object | Variable, ...]) -> Any:
    if isinstance(node, Feature) and not node.arguments:
        return replace(node, arguments=arguments)
    return with_changed_parts(node, lambda part: _of_objects(part, arguments))
