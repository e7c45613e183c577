"""Checks of formulas, and inference of the kind of value of each feature, from its uses.

Features are not declared: a feature that is compared with a number is a number, and a feature that
stands alone is a boolean. A kind that the formula leaves open follows from the values in states:

    p and q = "a" and r = s      p is a boolean, q a string; r and s are open, but of one kind
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import chain
from typing import Any, Final, TypeAlias

from dyknow_common import (
    MIRRORED_COMPARISONS,
    TEXT_COMPARISONS,
    TEXTUAL,
    ComputedField,
    PositionedError,
    TextPosition,
    parse_field,
    shortened,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language import formula as syntax
from dyknow_reasoning.language import terms
from dyknow_reasoning.language.formula import (
    Formula,
    parts,
    walk,
)
from dyknow_reasoning.language.grammar import LANGUAGE
from dyknow_reasoning.language.spatial import LinkLength, Over, Spatial
from dyknow_reasoning.language.terms import Term


class Kind(StrEnum):
    """The kind of a term's value."""

    NUMBER = 'number'
    STRING = 'string'
    BOOLEAN = 'boolean'
    OBJECT = 'object'


Kinds: TypeAlias = Mapping[str, Kind]
"""The kind of each feature and syntactic reference, by name; open kinds are left out."""


def check_types(formula: Formula, text: str) -> Kinds:
    """Return the kinds of the features of a formula.

    Args:
        formula: the result of `parse_formula`.
        text: its text, for error messages.

    Raises:
        LanguageError: with the position, for a formula that is wrong whatever the values are.
    """
    checker = _TypeChecker(
        {
            str(node): kind
            for node in walk(formula)
            if isinstance(node, terms.FieldReference) and (kind := _computed_kind(node))
        },
        {},
    )
    with LANGUAGE.errors_in(text):
        checker.check_names(formula)
        checker.check_variables(formula, {})
        checker.infer_kinds(formula)
    return checker.kinds


def kind_of(term: Term, kinds: Kinds) -> Kind | None:
    """Return the kind of the values of a term; None if the formula does not determine it."""
    match valued(term):
        case terms.TextLiteral():
            return Kind.STRING
        case terms.Truth():
            return Kind.BOOLEAN
        case terms.Object() | terms.Variable():
            return Kind.OBJECT
        case terms.Feature() | terms.FieldReference() as feature:
            return kinds.get(_name(feature))
        case _:
            return Kind.NUMBER


_Wanted: TypeAlias = tuple[Any, Kind, str]
"""A term, the kind that it must have, and its purpose."""


@dataclass(slots=True)
class _TypeChecker:
    """A check of one formula; its methods raise `PositionedError`.

    Args:
        kinds: the kinds of features that are known, by name.
        uses: where the others were found to have their kinds.
    """

    kinds: dict[str, Kind]
    uses: dict[str, TextPosition]

    def check_names(self, formula: Formula) -> None:
        """Check that a name stands for one thing: a feature, a sort, a variable or an object."""
        nodes = list(walk(formula))
        quantifiers = [node for node in nodes if isinstance(node, terms.Quantifier)]
        variables = {node.variable for node in quantifiers}
        sorts = {node.sort for node in quantifiers}
        objects = {node.name for node in nodes if isinstance(node, terms.Object)}
        _check_sorts(quantifiers, nodes)
        arities: dict[str, terms.Feature] = {}
        for node in nodes:
            if isinstance(node, terms.Feature):
                _check_feature(node, variables, objects)
                _check_arity(node, arities.setdefault(node.name, node))
            elif isinstance(node, terms.Object):
                _check_object(node, variables, sorts)
            elif isinstance(node, terms.ValueBefore | terms.Kept):
                _check_before(node)
        _check_probabilities(formula)

    def check_variables(self, node: Formula | Term, bound: Mapping[str, TextPosition]) -> None:
        """Check that no quantifier binds a variable again."""
        if isinstance(node, terms.Quantifier):
            if node.variable in bound:
                raise PositionedError(
                    f"the variable '{node.variable}' is bound already, "
                    f'at {bound[node.variable]}; choose another name',
                    node.position,
                )
            bound = {**bound, node.variable: node.position}
        for part in parts(node):
            self.check_variables(part, bound)

    def infer_kinds(self, formula: Formula) -> None:
        """Check that every feature is used as one kind of value."""
        wanted = chain(_of_truth((formula,)), *map(_wanted, walk(formula)))
        for term, kind, purpose in sorted(wanted, key=_place):
            self._require(term, kind, purpose)
        comparisons: dict[str, list[syntax.Comparison]] = defaultdict(list)
        for node in walk(formula):
            if isinstance(node, syntax.Comparison) and node.operator not in TEXT_COMPARISONS:
                self._infer_equality(node)
                for side in map(valued, (node.left, node.right)):
                    if isinstance(side, terms.Feature | terms.FieldReference):
                        comparisons[_name(side)].append(node)
        pending = list(self.kinds)
        for name in pending:  # The list grows in the loop.
            for comparison in comparisons[name]:
                known = len(self.kinds)
                self._infer_equality(comparison)
                if len(self.kinds) > known:
                    pending.append(next(reversed(self.kinds)))

    def _infer_equality(self, node: syntax.Comparison) -> None:
        left, right = kind_of(node.left, self.kinds), kind_of(node.right, self.kinds)
        if left is not None:
            self._require(node.right, left, self._comparison_with(node.left))
        elif right is not None:
            self._require(node.left, right, self._comparison_with(node.right))

    def _require(self, term: Term, kind: Kind, purpose: str) -> None:
        known, term = kind_of(term, self.kinds), valued(term)
        if known is None:
            self.kinds[_name(term)], self.uses[_name(term)] = kind, term.position
        elif known is not kind:
            raise PositionedError(
                f"'{term}' is {_article(known)}{self._evidence(term)}; "
                f'{purpose} it must be {_article(kind)}{_advice(term)}',
                term.position,
            )

    def _comparison_with(self, term: Term) -> str:
        return f"compared with '{term}'{self._evidence(term)}"

    def _evidence(self, term: Term) -> str:
        use = self.uses.get(_name(term))
        return f' (from its use at {use})' if use else ''


def _place(wanted: _Wanted) -> tuple[int, int]:
    """Return where a term stands in the text."""
    position: TextPosition = wanted[0].position
    return position.line, position.column


def _wanted(node: Formula | Term) -> Iterator[_Wanted]:
    """Yield the kinds that the direct operands of a node must have, but for equal ones."""
    operands = parts(node)
    match node:
        case syntax.Comparison('=' | '!=') | terms.ValueBefore() | terms.Kept():
            return
        case syntax.Comparison(word) if word in TEXT_COMPARISONS:
            yield from ((each, Kind.STRING, f"as an operand of '{word}'") for each in operands)
            return
        case terms.Sampled(mean, samples):
            yield samples, Kind.STRING, "as the samples of 'sampled'"
            word, operands = 'sampled', (mean,)
        case terms.Uncertain(mean, deviation, _, covariances):
            word = 'within' if isinstance(node, terms.Bounded) else 'normal'
            pairs = ((each.left, each.right) for each in covariances)
            operands = mean, deviation, *chain.from_iterable(pairs)
        case LinkLength(condition, weight, place):
            yield from _of_truth((condition,))
            yield from ((each, Kind.NUMBER, "as an operand of 'delaunay'") for each in place)
            if weight is not None:
                yield weight, Kind.NUMBER, 'as a length of links'
            return
        case syntax.Freeze(body=body):
            yield from _of_truth((body,))
            return
        case terms.Operation(word) | terms.Function(word):
            pass
        case terms.Aggregate(function=word) if word != 'count':
            pass
        case _:
            yield from _of_truth(operands)
            return
    yield from ((each, Kind.NUMBER, f"as an operand of '{word}'") for each in operands)


def _of_truth(nodes: Sequence[Formula | Term]) -> Iterator[_Wanted]:
    """Yield the features that are formulas, which are booleans."""
    features = (each for each in nodes if isinstance(each, terms.Feature | terms.FieldReference))
    return ((each, Kind.BOOLEAN, 'as a formula') for each in features)


def _advice(term: Term) -> str:
    """Return what to write for a topic without a field, which is a string; else an empty text."""
    if not (isinstance(term, terms.TextLiteral) and term.value.startswith('/')):
        return ''
    topic, dot, field = term.value.partition('.')
    if dot:  # No name of a topic has a dot.
        return f'; the quotes enclose the topic alone: "{topic}".{field}'
    return f'; if it is a topic, name a field, such as {term}.data'


def _check_feature(node: terms.Feature, variables: set[str], objects: set[str]) -> None:
    if node.name in variables:
        raise PositionedError(
            f"the variable '{node.name}' stands for an object, not for a value; "
            f'give it to a feature, such as Feature[{node.name}]',
            node.position,
        )
    if node.name in objects:
        raise PositionedError(
            f"'{node.name}' is an object elsewhere in the formula, and cannot be a feature here",
            node.position,
        )


def _check_sorts(quantifiers: Sequence[terms.Quantifier], nodes: list[Formula | Term]) -> None:
    """Check that each variable without a sort is an argument of a feature, to get its sort."""
    arguments = {
        each.name for node in nodes if isinstance(node, terms.Feature) for each in node.arguments
    }
    for node in quantifiers:
        if not node.is_sorted and node.variable not in arguments:
            raise PositionedError(
                f"the sort of '{node.variable}' is unknown, as no feature has it as an argument; "
                f'write {node.words} {node.variable} in SORT: ...',
                node.position,
            )


def _check_arity(node: terms.Feature, first: terms.Feature) -> None:
    if len(node.arguments) != len(first.arguments):
        raise PositionedError(
            f"'{node.name}' has {_counted(node)} here and "
            f'{_counted(first)} at {first.position}; a feature always has the same number',
            node.position,
        )


def _check_object(node: terms.Object, variables: set[str], sorts: set[str]) -> None:
    if node.name in variables:
        raise PositionedError(
            f"the variable '{node.name}' is not bound here; its quantifier does not reach this far",
            node.position,
        )
    if node.name in sorts:
        raise PositionedError(
            f"'{node.name}' is a sort, not an object; bind a variable to it, "
            f'such as forall x in {node.name}: ...',
            node.position,
        )


def _check_before(node: terms.ValueBefore | terms.Kept) -> None:
    if isinstance(valued(node), terms.Object | terms.Variable):
        message = f"'{node.body}' is an object, which is the same at every state"
        correction = 'write its name' if isinstance(node, terms.Kept) else 'leave out the prev()'
        raise PositionedError(f'{message}; {correction}', node.position)


_PERCENT: Final = 100

_WITHOUT_PROBABILITY: Final = syntax.PastFormula | terms.PastTerm | Over | Spatial


def _check_probabilities(
    node: Formula | Term, outer: Formula | Term | None = None, *, is_within: bool = False
) -> None:
    """Check where `P(...)`, `normal(...)` and `within(...)` stand.

    Args:
        node: the part to check.
        outer: a temporal operator or a `P(...)` that it is within.
        is_within: True if it is within a `P(...)`.
    """
    match node:
        case terms.Uncertain() if not is_within:
            message = f"'{node}' is not known exactly; compare it within P(...), and that with"
            raise PositionedError(f'{message} a probability', node.position)
        case _ if is_within and isinstance(node, _WITHOUT_PROBABILITY):
            message = f"'{node}' has no probability; leave it out of P(...)"
            raise PositionedError(message, node.position)
        case syntax.Comparison('=' | '!=') if _holds_probability(node):
            message = 'probabilities are bounds, not equal to a number; write <, <=, > or >='
            raise PositionedError(message, node.position)
        case terms.Arithmetic() | terms.Function() | terms.Aggregate() | terms.ValueBefore():
            if _holds_probability(node):
                message = f"'{node}' calculates with a probability; compare that with a number"
                raise PositionedError(message, node.position)
        case terms.Probability(body):
            if outer is not None and syntax.looks_forward(body):
                raise PositionedError(
                    f"'{node}' looks into the future, so it is asked of the first state alone; "
                    f"move it out of '{outer}'",
                    node.position,
                )
            outer, is_within = node, True
        case _ if isinstance(node, syntax.FutureFormula | syntax.PastFormula | terms.PastTerm):
            outer = node
    for part in parts(node):
        _check_probabilities(part, outer, is_within=is_within)


def _holds_probability(node: Formula | Term) -> bool:
    return any(isinstance(each, terms.Probability) for each in parts(node))


def check_asked_once(formula: Formula) -> None:
    """Check that a formula may be asked from several states on.

    Raises:
        ReasoningError: for a probability that depends on the states after the first one.
    """
    for each in walk(formula):
        if isinstance(each, terms.Probability) and syntax.looks_forward(each.body):
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
            case syntax.Comparison(
                operator, terms.Probability(), terms.Number(value) | terms.Quantity(value) as limit
            ):
                pass
            case syntax.Comparison(
                operator, terms.Number(value) | terms.Quantity(value) as limit, terms.Probability()
            ):
                operator = MIRRORED_COMPARISONS.get(operator, operator)
            case _:
                continue
        is_decided = (operator, value) in {('<', 0), ('>', 1), ('<=', 1)}
        if is_decided or isinstance(limit, terms.Quantity) or not 0 <= value <= 1:
            fault = 'has a unit' if isinstance(limit, terms.Quantity) else 'always or never holds'
            mend = f', {value / _PERCENT:g}' if 1 < value <= _PERCENT else ''
            message = f"'{operator} {limit}' of a probability {fault}; write a number from 0 to 1"
            raise PositionedError(f'{message}{mend}', limit.position)


def asks_for_probability(formula: Formula) -> bool:
    """Return True if a formula has a `P(...)`."""
    return syntax.contains(formula, terms.Probability)


def is_uncertain(formula: Formula) -> bool:
    """Return True if a formula has a number that is not known exactly."""
    return syntax.contains(formula, terms.Uncertain)


def best_estimate(node: Any) -> Any:
    """Return a formula or a term in which uncertain numbers are their best estimates."""
    if isinstance(node, terms.Uncertain):
        return node.mean
    return syntax.with_changed_parts(node, best_estimate)


def _counted(feature: terms.Feature) -> str:
    count = len(feature.arguments)
    return '1 argument' if count == 1 else f'{count} arguments'


def _computed_kind(reference: terms.FieldReference) -> Kind | None:
    """Return the kind of a function of a field, whatever its use is."""
    field = parse_field(reference.path)
    if not isinstance(field, ComputedField):
        return None
    if field.gives_number:
        return Kind.NUMBER
    return Kind.STRING if field.function in TEXTUAL else Kind.BOOLEAN


def valued(term: Term) -> Term:
    """Return the term whose present or earlier value a term is."""
    return valued(term.body) if isinstance(term, terms.ValueBefore | terms.Kept) else term


def _name(term: Term) -> str:
    return term.name if isinstance(term, terms.Feature) else str(term)


def _article(kind: Kind) -> str:
    return f'an {kind}' if kind is Kind.OBJECT else f'a {kind}'
