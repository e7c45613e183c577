"""From a formula and the domains of its sorts to nodes over numbered ground atoms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, cast

from dyknow_common import Symbol
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Arithmetic,
    Atom,
    Comparison,
    Equivalent,
    Eventually,
    Exists,
    Feature,
    FieldReference,
    Forall,
    Formula,
    Implies,
    Not,
    Object,
    Or,
    Term,
    Truth,
    Until,
    Variable,
)
from dyknow_reasoning.language.symbols import feature_symbol
from dyknow_reasoning.progression.atoms import NEGATED_COMPARISONS, fields
from dyknow_reasoning.progression.bounds import Bound
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import FALSE, TRUE, Node, constant, slots

Domains: TypeAlias = Mapping[str, Sequence[str]]
"""The objects of each sort."""

Binding: TypeAlias = Mapping[str, str]
"""The object that each variable stands for."""


@dataclass(frozen=True, slots=True)
class Instance:
    """A formula for one choice of objects for its outermost universal variables.

    Args:
        binding: that choice.
        atoms: the ground atom of each slot; comparisons only with `=`, `<` and `<=`.
        node: the formula over these slots.
    """

    binding: Binding
    atoms: tuple[Atom, ...]
    node: Node


def instances_of(formula: Formula, domains: Domains, store: NodeStore) -> list[Instance]:
    """The instances that must all hold for the formula to hold, without duplicates.

    Raises:
        ReasoningError: for a sort without a domain.
    """
    instances: dict[tuple[Node, tuple[Atom, ...]], Instance] = {}
    for binding, body in _instances(formula, domains, {}):
        grounder = _Grounder(store, domains)
        node = grounder.node(body, binding)
        atoms = tuple(grounder.slots)
        instances.setdefault((node, atoms), Instance(binding, atoms, node))
    return list(instances.values())


def ground_symbols(instances: Iterable[Instance]) -> list[Symbol]:
    """The ground features that instances still depend on, each once."""
    atoms = (instance.atoms[slot] for instance in instances for slot in slots(instance.node.mask))
    return list(
        dict.fromkeys(feature_symbol(field, {}) for atom in atoms for field in fields(atom))
    )


def objects(sort: str, domains: Domains) -> list[str]:
    """The objects of a sort, each once.

    Raises:
        ReasoningError: for a sort without a domain.
    """
    if sort not in domains:
        known = ', '.join(sorted(domains)) or 'none'
        raise ReasoningError(
            f"the sort '{sort}' has no domain (there are: {known}); give its objects"
        )
    return list(dict.fromkeys(domains[sort]))


def _instances(
    formula: Formula, domains: Domains, binding: Binding
) -> Iterator[tuple[Binding, Formula]]:
    match formula:
        case Forall(variable, sort, body):
            for name in objects(sort, domains):
                yield from _instances(body, domains, {**binding, variable: name})
        case Always(body=Forall() as inner):
            # `always` and `forall` commute, and instances apart are cheaper than together.
            outer = replace(inner, body=replace(formula, body=inner.body))
            yield from _instances(outer, domains, binding)
        case _:
            yield binding, formula


class _Grounder:
    def __init__(self, store: NodeStore, domains: Domains) -> None:
        self.slots: dict[Atom, int] = {}
        self._store = store
        self._domains = domains

    def node(self, formula: Formula, binding: Binding) -> Node:
        """The node of a formula, its free variables bound."""
        match formula:
            case Truth(value):
                return constant(value=value)
            case Feature() | FieldReference():
                return self._atom(cast('Atom', _ground_term(formula, binding)), positive=True)
            case Comparison():
                return self._comparison(formula, binding)
            case Not(body):
                return self._store.negation(self.node(body, binding))
            case Forall() | Exists():
                return self._quantified(formula, binding)
            case _:
                return self._temporal_or_connective(formula, binding)

    def _quantified(self, formula: Forall | Exists, binding: Binding) -> Node:
        names = objects(formula.sort, self._domains)
        members = [self.node(formula.body, {**binding, formula.variable: name}) for name in names]
        return self._store.junction(members, universal=isinstance(formula, Forall))

    def _temporal_or_connective(
        self,
        formula: Always | Eventually | Until | And | Or | Implies | Equivalent,
        binding: Binding,
    ) -> Node:
        sides: tuple[Node, Node]
        match formula:
            case Always(body):
                sides = FALSE, self.node(body, binding)
            case Eventually(body):
                sides = TRUE, self.node(body, binding)
            case Until(left, right):
                sides = self.node(left, binding), self.node(right, binding)
            case _:
                return self._connective(formula, binding)
        start, end = formula.interval.start, formula.interval.end
        bounds = Bound(0, start) if start else None, None if end is None else Bound(0, end)
        return self._store.window(*bounds, *sides, universal=isinstance(formula, Always))

    def _connective(self, formula: And | Or | Implies | Equivalent, binding: Binding) -> Node:
        left, right = self.node(formula.left, binding), self.node(formula.right, binding)
        store = self._store
        match formula:
            case And():
                return store.junction((left, right), universal=True)
            case Or():
                return store.junction((left, right), universal=False)
            case Implies():
                return store.junction((store.negation(left), right), universal=False)
            case Equivalent():
                both = store.junction((left, right), universal=True)
                negations = store.negation(left), store.negation(right)
                neither = store.junction(negations, universal=True)
                return store.junction((both, neither), universal=False)

    def _comparison(self, formula: Comparison, binding: Binding) -> Node:
        left, right = _ground_term(formula.left, binding), _ground_term(formula.right, binding)
        if isinstance(left, Object) and isinstance(right, Object):
            return constant(value=(left == right) == (formula.operator == '='))
        # One of each pair of opposites, so that both share an atom.
        negative = formula.operator in {'!=', '>', '>='}
        operator = NEGATED_COMPARISONS[formula.operator] if negative else formula.operator
        return self._atom(Comparison(operator, left, right), positive=not negative)

    def _atom(self, atom: Atom, *, positive: bool) -> Node:
        slot = self.slots.setdefault(atom, len(self.slots))
        return self._store.literal(slot, positive=positive)


def _ground_term(term: Term, binding: Binding) -> Term:
    match term:
        case Variable(name):
            return Object(binding[name])
        case Feature(name, arguments):
            names = (binding.get(each.name, each.name) for each in arguments)
            return Feature(name, tuple(map(Object, names)))
        case Arithmetic(operator, left, right):
            return Arithmetic(operator, _ground_term(left, binding), _ground_term(right, binding))
        case _:
            return term
