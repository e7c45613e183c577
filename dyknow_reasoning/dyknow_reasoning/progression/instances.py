"""Instances of a formula: nodes over numbered atoms, without variables.

`forall` at the outside of a formula yields an instance for each choice of objects. Other
quantifiers become junctions. All variables are substituted, so the atoms are about objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import product
from typing import Any, NamedTuple, TypeAlias, cast

from dyknow_common import Symbol, Verdict, amount, listed
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Atom,
    Comparison,
    Count,
    CountBound,
    CountOf,
    Equivalent,
    Eventually,
    Exists,
    Forall,
    Formula,
    Freeze,
    Implies,
    Not,
    Or,
    PastAtom,
    PastFormula,
    Previous,
    StateAtom,
    Until,
    compares_past,
    contains,
    joined,
    looks_forward,
    outermost_foralls,
    parts,
    with_changed_parts,
)
from dyknow_reasoning.language.quantities import check_units_are_known
from dyknow_reasoning.language.spatial import Over, Spatial, SpatialAtom
from dyknow_reasoning.language.symbols import Binding, feature_symbol, with_objects
from dyknow_reasoning.language.terms import (
    Aggregate,
    Feature,
    FieldReference,
    Function,
    Kept,
    Number,
    Object,
    Operation,
    Probability,
    Quantifier,
    Term,
    Truth,
    Uncertain,
    Variable,
)
from dyknow_reasoning.language.writing import as_written, written_operator
from dyknow_reasoning.progression.atoms import (
    POSITIVE_COMPARISONS,
    fields,
    predicate,
)
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import (
    FALSE,
    TRUE,
    Bound,
    Chronology,
    Constant,
    Literal,
    Node,
    Sides,
    constant,
    slots,
)
from dyknow_reasoning.progression.past_operators import is_dual
from dyknow_reasoning.progression.residual import Wording, holds_at_the_end
from dyknow_reasoning.progression.spatial_atoms import spatial_formula
from dyknow_reasoning.progression.thresholds import Thresholds

Domains: TypeAlias = Mapping[str, Sequence[str]]
"""The objects of each sort."""


class Source(NamedTuple):
    """A formula of the source text, with the objects of each sort."""

    formula: Formula
    domains: Domains


@dataclass(frozen=True, slots=True, eq=False)
class Instance:
    """A formula for one choice of objects for its outermost universal variables.

    Args:
        binding: the choice.
        atoms: the atom of each slot; comparisons only with `POSITIVE_COMPARISONS`. A formula about
            a kept value has a slot, too (see `execution.kept_values`).
        node: the formula over these slots.
        source: the formula in the text that this is an instance of.
    """

    binding: Binding
    atoms: Sequence[Atom]
    node: Node
    source: Source | None = field(default=None, kw_only=True)

    @property
    def keeps_values(self) -> bool:
        """True if it has atoms of kept values, which come and go: they are a list."""
        return isinstance(self.atoms, list)


def instances_of(
    formula: Formula, domains: Domains, store: NodeStore, node_limit: int
) -> list[Instance]:
    """Return the instances that must all hold for the formula to hold, without duplicates.

    Raises:
        ReasoningError: for a sort without a domain, a number in a unit that is not converted, or an
            instance with too many nodes.
    """
    check_units_are_known(formula)
    instances: dict[tuple[Node, tuple[Atom, ...]], Instance] = {}
    for binding, body in _instances(formula, domains):
        translator = Translator(store, domains)
        node = translator.node(body, binding)
        atoms = tuple(translator.slots)
        source = Source(body, domains)
        if node.size > node_limit:
            raise ReasoningError(
                f'the formula has {amount(node.size)} nodes, more than {node_limit} (the limit '
                "'node_limit'); each '<->' doubles those of both sides"
            )
        instances.setdefault((node, atoms), Instance(binding, atoms, node, source=source))
    return list(instances.values())


def written_atoms(instance: Instance) -> tuple[Atom, ...]:
    """Return the atoms of an instance as its formula says them; see `wording_of`."""
    return (_as_written if instance.keeps_values else _written_atoms)(instance)


def _as_written(instance: Instance) -> tuple[Atom, ...]:
    return tuple(map(as_written, instance.atoms))


_written_atoms = lru_cache(maxsize=128)(_as_written)


@lru_cache(maxsize=128)
def wording_of(instance: Instance) -> Wording:
    """Return the parts of an instance as its formula says them.

    They stay the same, while what remains is told at many states.
    """
    if instance.source is None:
        return Wording()
    formula, domains = instance.source
    recorder = _Recorder(NodeStore(Chronology(), [instance.node]), domains)
    recorder.node(formula, instance.binding)
    return Wording({**recorder.negated, **recorder.said}, recorder.operators)


def verdict_of(instances: Sequence[Instance]) -> Verdict:
    """Return the verdict on a formula that holds for all states, or undecided."""
    if any(instance.node is FALSE for instance in instances):
        return Verdict.FALSE
    decided = all(type(instance.node) is Constant for instance in instances)
    return Verdict.TRUE if decided else Verdict.UNDECIDED


def required_features(instances: Iterable[Instance]) -> list[Symbol]:
    """Return the features of objects that simplified instances depend on, each once."""
    atoms = (instance.atoms[slot] for instance in instances for slot in slots(instance.node.mask))
    # An operator of space has the same operands for all objects.
    roots = dict.fromkeys(
        atom.formula.places
        if isinstance(atom, PastAtom) and isinstance(atom.formula, SpatialAtom)
        else (atom,)
        for atom in atoms
    )
    found = (field for root in roots for part in root for field in fields(part))
    return list(dict.fromkeys(feature_symbol(field, {}) for field in found))


def ground_atoms(formula: Formula, domains: Domains) -> list[tuple[Binding, tuple[StateAtom, ...]]]:
    """Return the choice of objects and the atoms of each instance, as the text has them.

    Raises:
        ReasoningError: for a sort without a domain.
    """
    return [
        (binding, tuple(dict.fromkeys(_ground_atoms(body, binding, domains))))
        for binding, body in _instances(formula, domains)
    ]


def with_origin(formula: Over, binding: Binding) -> Binding:
    """Return a binding in which the variable of links is the object that they start from."""
    origin: str = ground(formula.origin, binding, {}).name
    return {**binding, formula.variable: origin}


def _ground_atoms(formula: Formula, binding: Binding, domains: Domains) -> Iterator[StateAtom]:
    pending: list[Any] = [ground(formula, binding, domains)]
    while pending:
        each = pending.pop()
        match each:
            case Comparison() if contains(each, Kept):
                pass  # It depends on an earlier state, too.
            case Feature() | FieldReference() | Comparison():
                yield each
            case Freeze(body=body):
                pending.append(body)
            case SpatialAtom(places=places):
                pending += reversed([*places.lefts, *places.rights])
            case _:
                pending += reversed(parts(each))


def _instances(formula: Formula, domains: Domains) -> Iterator[tuple[Binding, Formula]]:
    # Separate instances are cheaper than a junction.
    every, body = outermost_foralls(formula)
    for names in product(*(objects_of(each.sort, domains) for each in every)):
        yield {each.variable: name for each, name in zip(every, names, strict=True)}, body


class Translator:
    """Translates a formula to nodes, and numbers its atoms."""

    def __init__(self, store: NodeStore, domains: Domains) -> None:
        self.slots: dict[Atom, int] = {}
        self._store = store
        self._thresholds = Thresholds(store)
        self._domains = domains

    def node(  # noqa: C901, PLR0911 - one for each kind
        self, formula: Formula, binding: Binding
    ) -> Node:
        """Return the node of a formula whose free variables are bound."""
        match formula:
            case Truth(value):
                return constant(value=value)
            case Feature() | FieldReference() | Comparison():
                return self._atom(formula, binding)
            case Not(body):
                return self._store.negation(self.node(body, binding))
            case Forall() | Exists() | Count() | CountOf():
                return self._quantified(formula, binding)
            case And() | Or() | Implies() | Equivalent():
                return self._connective(formula, binding)
            case _ if isinstance(formula, PastFormula):
                return self._past(formula, binding)
            case PastAtom():
                return self._literal(formula, positive=True)
            case Freeze():
                return self._literal(ground(formula, binding, self._domains), positive=True)
            case Over() | Spatial():
                return self.node(ground(formula, binding, self._domains), {})
            case Always() | Eventually() | Until():
                return self._window(formula, binding)
            case _:  # pragma: no cover - parsing replaces it, or it is no formula
                raise AssertionError(formula)

    def _past(self, formula: PastFormula, binding: Binding) -> Node:
        universal = is_dual(formula)
        window: tuple[int | None, int | None] = None, None
        if not isinstance(formula, Previous):
            window = formula.interval.start, formula.interval.end
        if looks_forward(formula):
            *lefts, right = (self.node(cast('Formula', part), binding) for part in parts(formula))
            left = lefts[0] if lefts else constant(value=not universal)
            return self._store.past_window(*window, left, right, universal=universal)
        grounded = ground(formula, binding, self._domains)
        operands = past_operands(grounded, self._store)
        known = self._store.past_window(*window, operands.left, operands.right, universal=False)
        if type(known) is Constant:
            return constant(value=known.value is not universal)
        return self._literal(PastAtom(grounded), positive=True)

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
        universal = isinstance(formula, Always)
        # The present state is in the interval, and decides what needs one state.
        if not start and sides[1] is constant(value=not universal):
            return sides[1]
        return self._store.window(*bounds, *sides, universal=universal)

    def _quantified(self, formula: Forall | Exists | Count | CountOf, binding: Binding) -> Node:
        if isinstance(formula, CountOf):
            members = [self.node(each, binding) for each in formula.members]
            return self._count(formula.bound, formula.number, members)
        members = [
            self.node(formula.body, {**binding, formula.variable: name})
            for name in objects_of(formula.sort, self._domains)
        ]
        if isinstance(formula, Count):
            return self._count(formula.bound, formula.number, members)
        return self._thresholds.junction(members, universal=isinstance(formula, Forall))

    def _count(self, bound: CountBound, number: int, members: Sequence[Node]) -> Node:
        store = self._store
        enough = store.at_least(number, members)
        # At most `number` hold if all others do not.
        rest = len(members) - number
        few = store.at_least(rest, [store.negation(each) for each in members])
        match bound:
            case CountBound.AT_LEAST:
                return enough
            case CountBound.AT_MOST:
                return few
            case CountBound.EXACTLY:
                return store.junction((enough, few), universal=True)

    def _connective(self, formula: And | Or | Implies | Equivalent, binding: Binding) -> Node:
        left, right = self.node(formula.left, binding), self.node(formula.right, binding)
        negation = self._store.negation
        all_of = partial(self._thresholds.junction, universal=True)
        any_of = partial(self._thresholds.junction, universal=False)
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
        found = ground(formula, binding, self._domains)
        if not isinstance(found, Comparison):
            return self._literal(found, positive=True)
        if compares_past(found):  # At the first state, opposite comparisons are both false.
            literal = self._literal(PastAtom(found), positive=True)
            return self._awaited(found, literal) if looks_forward(found) else literal
        left, right = found.left, found.right
        if isinstance(left, Object) and isinstance(right, Object):
            return constant(value=(left == right) == (found.operator == '='))
        # Opposite comparisons share an atom.
        negative = found.operator not in POSITIVE_COMPARISONS
        atom = found.opposite if negative else found
        known = _value_without_state(atom)
        if known is not None:
            return constant(value=known is not negative)
        return self._literal(atom, positive=not negative)

    def _awaited(self, comparison: Comparison, known: Node) -> Node:
        """Return a comparison of a probability that becomes known, true or false, later.

        If no further state comes, it counts as true if more is likely and the formula counts as
        true then, or if less is likely and it does not.
        """
        is_open = self._literal(PastAtom(comparison.opposite), positive=False)
        is_left = isinstance(comparison.left, Probability)
        asked = comparison.left if is_left else comparison.right
        body = Translator(self._store, {}).node(cast('Probability', asked).body, {})
        wants_more = (comparison.operator in {'>', '>='}) is is_left
        if holds_at_the_end(body) is wants_more:
            later = self._store.window(None, None, known, is_open, universal=True)
        else:
            later = self._store.window(None, None, is_open, known, universal=False)
        waiting = self._store.junction((is_open, later), universal=True)
        return self._store.junction((known, waiting), universal=False)

    def _literal(self, atom: Atom, *, positive: bool) -> Node:
        slot = self._slot(atom)
        self._thresholds.add(slot, atom)
        return self._store.literal(slot, positive=positive)

    def _slot(self, atom: Atom) -> int:
        return self.slots.setdefault(atom, len(self.slots))


class _Recorder(Translator):
    """A translator that records the part of the formula that each node stands for."""

    def __init__(self, store: NodeStore, domains: Domains) -> None:
        super().__init__(store, domains)
        self.said: dict[Node, Formula] = {}
        self.negated: dict[Node, Formula] = {}
        self.operators: dict[Sides, str] = {}

    def node(self, formula: Formula, binding: Binding) -> Node:
        """Return the node of a formula whose free variables are bound."""
        found = super().node(formula, binding)
        if isinstance(found, Constant | Literal) or found in self.said:
            return found
        said = self.said[found] = as_written(with_objects(formula, binding))
        self.negated.setdefault(self._store.negation(found), Not(said))
        if operator := written_operator(formula):
            sides = self.node(operator.left, binding), self.node(operator.right, binding)
            self.operators[operator.word == 'release', *sides] = operator.word
        return found


@dataclass(frozen=True, slots=True)
class PastOperands:
    """Operands of a ground past operator. Most operators have only `right`.

    Args:
        atoms: the atom of each slot.
        left: the left side of `since`; true for other operators.
        right: the right side; for `historically F`, it is `not F`, as in `not once not F`.
    """

    atoms: tuple[Atom, ...]
    left: Node
    right: Node


def ground_nodes(
    formulas: Iterable[Formula], store: NodeStore
) -> tuple[tuple[Atom, ...], list[Node]]:
    """Return the atom of each slot, and the nodes of ground formulas over these slots."""
    translator = Translator(store, {})
    nodes = [translator.node(each, {}) for each in formulas]
    return tuple(translator.slots), nodes


def past_operands(formula: PastFormula, store: NodeStore) -> PastOperands:
    """Return the operands of a ground past operator."""
    atoms, (*lefts, right) = ground_nodes(cast('tuple[Formula, ...]', parts(formula)), store)
    if is_dual(formula):
        right = store.negation(right)
    return PastOperands(atoms, lefts[0] if lefts else TRUE, right)


def ground(  # noqa: C901, PLR0911 - one for each kind
    node: Any, binding: Binding, domains: Domains
) -> Any:
    """Return a formula or a term without variables, quantifiers and aggregates.

    Raises:
        ReasoningError: for a sort without a domain; for an extreme of no objects.
    """

    def grounded(part: Any) -> Any:
        return ground(part, binding, domains)

    match node:
        case Object():  # A variable may have its name.
            return node
        case Variable(name):
            return Object(binding[name])
        case Feature(name, arguments):
            return Feature(name, tuple(map(grounded, arguments)))
        case Operation(operator, left, right):
            return type(node)(operator, grounded(left), grounded(right))
        case Function(name, operands):
            return Function(name, tuple(map(grounded, operands)))
        case Forall() | Exists():
            members = _members(node, binding, domains)
            return joined(members, And if isinstance(node, Forall) else Or)
        case Count(bound=bound, number=number):
            return CountOf(bound, number, tuple(_members(node, binding, domains)))
        case Aggregate():
            return _aggregated(with_objects(node, binding), _members(node, binding, domains))
        case Over():
            return ground(node.body, with_origin(node, binding), domains)
        case Spatial():
            others = {name: each for name, each in binding.items() if name != node.place}
            return spatial_formula(with_objects(node, others), binding, domains, ground)
        case _:
            return with_changed_parts(node, grounded)


def _members(node: Quantifier, binding: Binding, domains: Domains) -> list[Any]:
    """Return the body of a quantifier for each object."""
    names = objects_of(node.sort, domains)
    return [ground(node.body, {**binding, node.variable: name}, domains) for name in names]


def with_kept(node: Any, name: str, value: Term) -> Any:
    """Return a formula with a value for each use of a name that `let` gave to a term."""
    if isinstance(node, Kept):
        return value if node.name == name else node
    return with_changed_parts(node, lambda part: with_kept(part, name, value))


def _value_without_state(atom: Comparison) -> bool | None:
    """Return the truth of a comparison of constants; None if it needs a state.

    Raises:
        ReasoningError: if it has no value, such as `1 / 0 > 2`.
    """
    if contains(atom, Feature | FieldReference | Uncertain):
        return None
    try:
        return predicate(atom, {})({})
    except UnusableValueError as error:
        raise ReasoningError(error.message) from None  # The formula is at fault, not a state.


def _aggregated(aggregate: Aggregate, operands: Sequence[Any]) -> Term:
    if not operands and aggregate.function in {'min', 'max'}:
        raise ReasoningError(f"'{aggregate}' has no value, as '{aggregate.sort}' has no objects")
    if not operands:
        return Number(0)
    if len(operands) == 1 and aggregate.function != 'count':
        return cast('Term', operands[0])
    return Function(aggregate.function, tuple(operands), aggregate=aggregate)


def objects_of(sort: str, domains: Domains) -> list[str]:
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
