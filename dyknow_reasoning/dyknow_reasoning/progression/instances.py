"""Instances of a formula: nodes over numbered atoms, without variables.

`forall` at the outside of a formula yields an instance for each choice of objects. Other
quantifiers become junctions. All variables are substituted, so the atoms are about objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias, cast

from dyknow_common import Symbol, Verdict, listed
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
    parts,
)
from dyknow_reasoning.language.symbols import feature_symbol
from dyknow_reasoning.progression.atoms import NEGATED_COMPARISONS, fields, predicate
from dyknow_reasoning.progression.bounds import Bound
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import FALSE, TRUE, Constant, Node, constant, slots

Domains: TypeAlias = Mapping[str, Sequence[str]]
"""The objects of each sort."""

Binding: TypeAlias = Mapping[str, str]
"""The object of each variable."""


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """A formula for one choice of objects for its outermost universal variables.

    Args:
        binding: the choice.
        atoms: the atom of each slot; comparisons only with `=`, `<` and `<=`.
        node: the formula over these slots.
    """

    binding: Binding
    atoms: tuple[Atom, ...]
    node: Node


def instances_of(formula: Formula, domains: Domains, store: NodeStore) -> list[Instance]:
    """Return the instances that must all hold for the formula to hold, without duplicates.

    Raises:
        ReasoningError: for a sort without a domain.
    """
    instances: dict[tuple[Node, tuple[Atom, ...]], Instance] = {}
    for binding, body in _instances(formula, domains, {}):
        translator = _Translator(store, domains)
        node = translator.node(body, binding)
        atoms = tuple(translator.slots)
        instances.setdefault((node, atoms), Instance(binding, atoms, node))
    return list(instances.values())


def verdict_of(instances: Sequence[Instance]) -> Verdict:
    """Return the verdict on a formula that holds for all states, or undecided."""
    if any(instance.node is FALSE for instance in instances):
        return Verdict.FALSE
    decided = all(type(instance.node) is Constant for instance in instances)
    return Verdict.TRUE if decided else Verdict.UNDECIDED


def required_features(instances: Iterable[Instance]) -> list[Symbol]:
    """Return the features of objects that simplified instances depend on, each once."""
    atoms = (instance.atoms[slot] for instance in instances for slot in slots(instance.node.mask))
    return list(
        dict.fromkeys(feature_symbol(field, {}) for atom in atoms for field in fields(atom))
    )


def ground_atoms(formula: Formula, domains: Domains) -> list[tuple[Binding, tuple[Atom, ...]]]:
    """Return the choice of objects and the atoms of each instance, as the text has them.

    Raises:
        ReasoningError: for a sort without a domain.
    """
    return [
        (binding, tuple(dict.fromkeys(_ground_atoms(body, binding, domains))))
        for binding, body in _instances(formula, domains, {})
    ]


def ground_atom(atom: Atom, binding: Binding) -> Atom:
    """Return an atom with objects for its variables."""
    if isinstance(atom, Comparison):
        left, right = _substitute(atom.left, binding), _substitute(atom.right, binding)
        return Comparison(atom.operator, left, right)
    return cast('Atom', _substitute(atom, binding))


def objects_of(sort: str, domains: Domains) -> list[str]:
    """Return the objects of a sort, each once.

    Raises:
        ReasoningError: for a sort without a domain.
    """
    return _objects(sort, domains)


def _ground_atoms(formula: Formula, binding: Binding, domains: Domains) -> Iterator[Atom]:
    match formula:
        case Feature() | FieldReference() | Comparison():
            yield ground_atom(formula, binding)
        case Forall(variable, sort, body) | Exists(variable, sort, body):
            for name in _objects(sort, domains):
                yield from _ground_atoms(body, {**binding, variable: name}, domains)
        case _:
            for part in parts(formula):
                yield from _ground_atoms(cast('Formula', part), binding, domains)


def _instances(
    formula: Formula, domains: Domains, binding: Binding
) -> Iterator[tuple[Binding, Formula]]:
    match formula:
        case Forall(variable, sort, body):
            for name in _objects(sort, domains):
                yield from _instances(body, domains, {**binding, variable: name})
        case Always(body=Forall() as inner):
            # `always` and `forall` commute; separate instances are cheaper than a junction.
            outer = replace(inner, body=replace(formula, body=inner.body))
            yield from _instances(outer, domains, binding)
        case _:
            yield binding, formula


class _Translator:
    """Translates a formula to nodes, and numbers its atoms."""

    def __init__(self, store: NodeStore, domains: Domains) -> None:
        self.slots: dict[Atom, int] = {}
        self._store = store
        self._domains = domains

    def node(self, formula: Formula, binding: Binding) -> Node:
        """Return the node of a formula whose free variables are bound."""
        match formula:
            case Truth(value):
                return constant(value=value)
            case Feature() | FieldReference() | Comparison():
                return self._atom(formula, binding)
            case Not(body):
                return self._store.negation(self.node(body, binding))
            case Forall(variable, sort, body) | Exists(variable, sort, body):
                names = _objects(sort, self._domains)
                members = [self.node(body, {**binding, variable: name}) for name in names]
                return self._store.junction(members, universal=isinstance(formula, Forall))
            case And() | Or() | Implies() | Equivalent():
                return self._connective(formula, binding)
            case _:
                return self._window(formula, binding)

    def _window(self, formula: Always | Eventually | Until, binding: Binding) -> Node:
        sides: tuple[Node, Node]
        match formula:
            case Always(body):
                sides = FALSE, self.node(body, binding)
            case Eventually(body):
                sides = TRUE, self.node(body, binding)
            case Until(left, right):
                sides = self.node(left, binding), self.node(right, binding)
        start, end = formula.interval.start, formula.interval.end
        bounds = Bound(0, start) if start else None, None if end is None else Bound(0, end)
        return self._store.window(*bounds, *sides, universal=isinstance(formula, Always))

    def _connective(self, formula: And | Or | Implies | Equivalent, binding: Binding) -> Node:
        left, right = self.node(formula.left, binding), self.node(formula.right, binding)
        negation = self._store.negation
        all_of = partial(self._store.junction, universal=True)
        any_of = partial(self._store.junction, universal=False)
        match formula:
            case And():
                return all_of((left, right))
            case Or():
                return any_of((left, right))
            case Implies():
                return any_of((negation(left), right))
            case Equivalent():
                neither = all_of((negation(left), negation(right)))
                return any_of((all_of((left, right)), neither))

    def _atom(self, formula: Atom, binding: Binding) -> Node:
        if not isinstance(formula, Comparison):
            return self._literal(cast('Atom', _substitute(formula, binding)), positive=True)
        left, right = _substitute(formula.left, binding), _substitute(formula.right, binding)
        if isinstance(left, Object) and isinstance(right, Object):
            return constant(value=(left == right) == (formula.operator == '='))
        # Opposite comparisons share an atom.
        negative = formula.operator in {'!=', '>', '>='}
        operator = NEGATED_COMPARISONS[formula.operator] if negative else formula.operator
        atom = Comparison(operator, left, right)
        known = _value_without_state(atom)
        if known is not None:
            return constant(value=known is not negative)
        return self._literal(atom, positive=not negative)

    def _literal(self, atom: Atom, *, positive: bool) -> Node:
        slot = self.slots.setdefault(atom, len(self.slots))
        return self._store.literal(slot, positive=positive)


def _value_without_state(atom: Comparison) -> bool | None:
    """Return the truth of a comparison of constants; None if it needs a state, or has no value."""
    if next(fields(atom), None) is not None:
        return None
    try:
        return predicate(atom, {})({})
    except ReasoningError:
        return None  # A division by zero is an error at the first state.


def _substitute(term: Term, binding: Binding) -> Term:
    match term:
        case Variable(name):
            return Object(binding[name])
        case Feature(name, arguments):
            names = (binding.get(each.name, each.name) for each in arguments)
            return Feature(name, tuple(map(Object, names)))
        case Arithmetic(operator, left, right):
            return Arithmetic(operator, _substitute(left, binding), _substitute(right, binding))
        case _:
            return term


def _objects(sort: str, domains: Domains) -> list[str]:
    """Return the objects of a sort, each once; raise ReasoningError for a sort without a domain."""
    if sort not in domains:
        if variable := sort.removeprefix('?') if sort.startswith('?') else '':
            raise ReasoningError(
                f"the variable '{variable}' has no sort; write {variable} in SORT after forall or "
                'exists'
            )
        known = listed(sorted(domains)) or 'none'
        raise ReasoningError(
            f"the sort '{sort}' has no domain (there are: {known}); give its objects"
        )
    return list(dict.fromkeys(domains[sort]))
