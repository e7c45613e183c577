"""What kind of value each feature of a formula has, inferred from how it is used.

A feature is declared nowhere: comparing it with a number makes it a number, standing alone makes it
a boolean. What cannot be told stays open and is seen from the values in the states.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TypeAlias

from dyknow_common import LanguageError, TextPosition
from dyknow_reasoning.language.formula import (
    Arithmetic,
    Comparison,
    Exists,
    Feature,
    FieldReference,
    Forall,
    Formula,
    Number,
    Object,
    Term,
    TextLiteral,
    Truth,
    Variable,
    parts,
    walk,
)


class Kind(StrEnum):
    """What a term stands for."""

    NUMBER = 'number'
    STRING = 'string'
    BOOLEAN = 'boolean'
    OBJECT = 'object'


Kinds: TypeAlias = Mapping[str, Kind]
"""The kind of each feature and syntactic reference, by name; one that is open is not in it."""


def check_types(formula: Formula, text: str) -> Kinds:
    """The kinds of the features of a formula.

    Args:
        formula: what `parse_formula` made of the text.
        text: what the messages show.

    Raises:
        LanguageError: with the place, for what makes no sense whatever the values.
    """
    checker = _TypeChecker()
    try:
        checker.check_names(formula)
        checker.check_variables(formula, {})
        checker.infer_kinds(formula)
    except ValueError as error:
        raise LanguageError(error.args[0], 'formula', text, error.args[1]) from None
    return {name: use.kind for name, use in checker.uses.items()}


@dataclass(frozen=True, slots=True)
class _Use:
    kind: Kind
    place: TextPosition


@dataclass(slots=True)
class _TypeChecker:
    """Raises ValueError(message, place)."""

    uses: dict[str, _Use] = field(default_factory=dict)

    def check_names(self, formula: Formula) -> None:
        """A name stands for one thing: a feature, a sort, a variable or an object."""
        nodes = list(walk(formula))
        quantifiers = [node for node in nodes if isinstance(node, Forall | Exists)]
        variables = {node.variable for node in quantifiers}
        sorts = {node.sort for node in quantifiers}
        objects = {node.name for node in nodes if isinstance(node, Object)}
        arities: dict[str, Feature] = {}
        for node in nodes:
            if isinstance(node, Feature):
                _check_feature(node, variables, objects)
                _check_arity(node, arities.setdefault(node.name, node))
            elif isinstance(node, Object):
                _check_object(node, variables, sorts)

    def check_variables(self, node: Formula | Term, bound: Mapping[str, TextPosition]) -> None:
        """No quantifier binds a variable again that is bound already."""
        if isinstance(node, Forall | Exists):
            if node.variable in bound:
                raise ValueError(
                    f"the variable '{node.variable}' is bound already, "
                    f'at {_spelled(bound[node.variable])}; choose another name',
                    node.place,
                )
            bound = {**bound, node.variable: node.place}
        for part in parts(node):
            self.check_variables(part, bound)

    def infer_kinds(self, formula: Formula) -> None:
        """Every feature is used as one kind of value."""
        self._infer_use(formula)
        comparisons = [node for node in walk(formula) if isinstance(node, Comparison)]
        known = -1
        while known != len(self.uses):
            known = len(self.uses)
            for comparison in comparisons:
                self._infer_equality(comparison)

    def _infer_use(self, node: Formula | Term) -> None:
        match node:
            case Feature() | FieldReference():
                self._require(node, Kind.BOOLEAN, 'as a formula')
            case Comparison('=' | '!=', left, right):
                self._infer_arithmetic(left)
                self._infer_arithmetic(right)
            case Comparison() | Arithmetic():
                self._infer_numbers(node)
            case _:
                for part in parts(node):
                    self._infer_use(part)

    def _infer_numbers(self, node: Comparison | Arithmetic) -> None:
        for side in (node.left, node.right):
            self._infer_arithmetic(side)
            self._require(side, Kind.NUMBER, f"as an operand of '{node.operator}'")

    def _infer_arithmetic(self, node: Term) -> None:
        if isinstance(node, Arithmetic):
            self._infer_numbers(node)

    def _infer_equality(self, node: Comparison) -> None:
        left, right = self._kind(node.left), self._kind(node.right)
        if left is not None:
            self._require(node.right, left, self._comparison_with(node.left))
        elif right is not None:
            self._require(node.left, right, self._comparison_with(node.right))

    def _kind(self, term: Term) -> Kind | None:
        match term:
            case Number() | Arithmetic():
                return Kind.NUMBER
            case TextLiteral():
                return Kind.STRING
            case Truth():
                return Kind.BOOLEAN
            case Object() | Variable():
                return Kind.OBJECT
            case Feature() | FieldReference():
                use = self.uses.get(_name(term))
                return use.kind if use else None

    def _require(self, term: Term, kind: Kind, purpose: str) -> None:
        known = self._kind(term)
        if known is None:
            self.uses[_name(term)] = _Use(kind, term.place)
        elif known is not kind:
            raise ValueError(
                f"'{term}' is {_article(known)}{self._evidence(term)}; "
                f'{purpose} it must be {_article(kind)}',
                term.place,
            )

    def _comparison_with(self, term: Term) -> str:
        return f"compared with '{term}'{self._evidence(term)}"

    def _evidence(self, term: Term) -> str:
        use = self.uses.get(_name(term))
        return f' (from its use at {_spelled(use.place)})' if use else ''


def _check_feature(node: Feature, variables: set[str], objects: set[str]) -> None:
    if node.name in variables:
        raise ValueError(
            f"the variable '{node.name}' stands for an object, not for a value; "
            f'give it to a feature, such as Feature[{node.name}]',
            node.place,
        )
    if node.name in objects:
        raise ValueError(
            f"'{node.name}' is an object elsewhere in the formula, and cannot be a feature here",
            node.place,
        )


def _check_arity(node: Feature, first: Feature) -> None:
    if len(node.arguments) != len(first.arguments):
        raise ValueError(
            f"'{node.name}' has {_counted(node)} here and "
            f'{_counted(first)} at {_spelled(first.place)}; a feature always has the same number',
            node.place,
        )


def _check_object(node: Object, variables: set[str], sorts: set[str]) -> None:
    if node.name in variables:
        raise ValueError(
            f"the variable '{node.name}' is not bound here; its quantifier does not reach this far",
            node.place,
        )
    if node.name in sorts:
        raise ValueError(
            f"'{node.name}' is a sort, not an object; bind a variable to it, "
            f'such as forall x in {node.name}: ...',
            node.place,
        )


def _counted(feature: Feature) -> str:
    count = len(feature.arguments)
    return '1 argument' if count == 1 else f'{count} arguments'


def _name(term: Term) -> str:
    return term.name if isinstance(term, Feature) else str(term)


def _article(kind: Kind) -> str:
    return f'an {kind}' if kind is Kind.OBJECT else f'a {kind}'


def _spelled(place: TextPosition) -> str:
    return f'{place.line}:{place.column}'
