"""Features whose errors are stated before a formula.

In `let Height ~ normal(Height, sqrt(Variance), 2 s) in P(always Height[u] > 3) > 0.9`, a name after
`~` stands for the feature of the same objects, so the formula is
`P(always normal(Height[u], sqrt(Variance[u]), 2 s) > 3) > 0.9`. Outside of `P(...)`, Height is its
best estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from dyknow_common import MIRRORED_COMPARISONS, PositionedError, shortened
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Comparison,
    Formula,
    contains,
    looks_forward,
    walk,
    with_changed_parts,
)
from dyknow_reasoning.language.terms import (
    Covariance,
    Feature,
    Number,
    Object,
    Probability,
    Quantity,
    Uncertain,
    Variable,
    holds_terms,
)

_PERCENT: Final = 100


def with_uncertain_features(formula: Formula, stated: Mapping[str, Uncertain]) -> Formula:
    """Return a formula in which probabilities are of uncertain numbers."""
    changed: Formula = _changed(formula, stated, is_within=False) if stated else formula
    return changed


def check_asked_once(formula: Formula) -> None:
    """Check that a formula may be asked from several states on.

    Raises:
        ReasoningError: for a probability that depends on the states after the first one.
    """
    for each in walk(formula):
        if isinstance(each, Probability) and looks_forward(each.body):
            raise ReasoningError(
                f"'{shortened(each)}' looks into the future, so it is asked of the first state "
                'alone; ask the formula once, or for the probability at each state'
            )


def check_limits(formula: Formula) -> None:
    """Check that probabilities are compared with numbers that they may be more and less than.

    `P(...) >= 0` is allowed, as it asks for the probability.

    Raises:
        PositionedError: for another number.
    """
    for each in walk(formula):
        match each:
            case Comparison(operator, Probability(), Number(value) | Quantity(value) as limit):
                pass
            case Comparison(operator, Number(value) | Quantity(value) as limit, Probability()):
                operator = MIRRORED_COMPARISONS.get(operator, operator)
            case _:
                continue
        is_decided = (operator, value) in {('<', 0), ('>', 1), ('<=', 1)}
        if is_decided or isinstance(limit, Quantity) or not 0 <= value <= 1:
            fault = 'has a unit' if isinstance(limit, Quantity) else 'always or never holds'
            mend = f', {value / _PERCENT:g}' if 1 < value <= _PERCENT else ''
            message = f"'{operator} {limit}' of a probability {fault}; write a number from 0 to 1"
            raise PositionedError(f'{message}{mend}', limit.position)


def asks_for_probability(formula: Formula) -> bool:
    """Return True if a formula has a `P(...)`."""
    return contains(formula, Probability)


def is_uncertain(formula: Formula) -> bool:
    """Return True if a formula has a number that is not known exactly."""
    return contains(formula, Uncertain)


def best_estimate(node: Any) -> Any:
    """Return a formula or a term in which uncertain numbers are their best estimates."""
    if isinstance(node, Uncertain):
        return node.mean
    return with_changed_parts(node, best_estimate)


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
