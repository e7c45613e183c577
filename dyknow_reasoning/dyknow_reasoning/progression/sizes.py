"""The size of a formula for given objects, counted before the work of grounding is done.

The counts are products of the numbers of objects. They are upper bounds: simplification, which
happens during the work, may leave less.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from typing import TypeAlias, cast

from dyknow_common import MAX_FORMULA_PARTS, amount
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    Comparison,
    Count,
    CountBound,
    CountOf,
    Exists,
    Forall,
    Formula,
    is_about_one_state,
    outermost_foralls,
    parts,
)
from dyknow_reasoning.language.spatial import Over, Spatial
from dyknow_reasoning.language.terms import (
    Aggregate,
    Arithmetic,
    Feature,
    Function,
    PastTerm,
    StateCount,
    Term,
)

Counts: TypeAlias = Mapping[str, int]
"""The number of objects of each sort; a sort without an entry counts as one object."""


@dataclass(frozen=True, slots=True)
class FormulaLimits:
    """Limits of formula groups; each error names the field, a parameter of the node.

    Args:
        object_limit: the sorts and objects of a group, together.
        instance_limit: the instances of a formula, one for each choice of objects.
        instance_part_limit: the parts of one instance, whose memory grows with their square.
        part_limit: the parts of all instances of a group.
        node_limit: the nodes that a formula may grow to by progression.
        possibility_limit: what may remain of a formula after a state with unknown values.
    """

    object_limit: int = MAX_FORMULA_PARTS
    instance_limit: int = MAX_FORMULA_PARTS
    instance_part_limit: int = MAX_FORMULA_PARTS
    part_limit: int = MAX_FORMULA_PARTS
    node_limit: int = 100_000
    possibility_limit: int = 1000


@dataclass(frozen=True, slots=True)
class FormulaSize:
    """The size of a formula for given objects.

    Args:
        instances: the number of instances.
        instance_parts: the parts of an instance.
    """

    instances: int
    instance_parts: int

    @property
    def parts(self) -> int:
        """The parts of all instances."""
        return self.instances * (1 + self.instance_parts)


def formula_size(formula: Formula, counts: Counts) -> FormulaSize:
    """Return the size of a formula.

    Args:
        formula: the formula.
        counts: the number of objects of each sort.
    """
    every, body = outermost_foralls(formula)
    instances = prod(counts.get(each.sort, 1) for each in every)
    return FormulaSize(instances, _parts(body, counts))


def check_size(size: FormulaSize, limits: FormulaLimits, *, others: int = 0) -> None:
    """Check the size of a formula, before its instances are made.

    Args:
        size: the size.
        limits: the limits.
        others: the parts of the other formulas of the group.

    Raises:
        ReasoningError: names the limit that the formula exceeds.
    """
    found = {
        'instance_limit': (size.instances, 'instances'),
        'instance_part_limit': (size.instance_parts, 'parts for each choice'),
        'part_limit': (size.parts, 'parts'),
    }
    for name, (count, what) in found.items():
        limit = getattr(limits, name)
        if count > limit:
            raise ReasoningError(
                f'the formula has {amount(count)} {what} for these objects, more than {limit} '
                f"(the limit '{name}'); quantify over fewer variables or objects"
            )
    if others + size.parts > limits.part_limit:
        raise ReasoningError(
            f'the formulas of the group have {amount(others + size.parts)} parts for these objects '
            f"together, more than {limits.part_limit} (the limit 'part_limit'); use another group"
        )


def object_counts(domains: Mapping[str, Sequence[str]], limits: FormulaLimits) -> Counts:
    """Return the number of objects of each sort; an object that is given twice counts once.

    Raises:
        ReasoningError: for too many objects.
    """
    count = len(domains) + sum(map(len, domains.values()))
    if count > limits.object_limit:
        raise ReasoningError(
            f'there are {count} sorts and objects, more than {limits.object_limit} (the limit '
            "'object_limit'); evaluate the formula for fewer objects"
        )
    return {sort: len(set(objects)) for sort, objects in domains.items()}


def _parts(  # noqa: PLR0911 - one for each kind
    formula: Formula, counts: Counts
) -> int:
    match formula:
        case Comparison(_, left, right):
            return 1 + _operations(left, counts) + _operations(right, counts)
        case Feature():
            return 1
        case Forall(_, sort, body) | Exists(_, sort, body):
            return 1 + counts.get(sort, 1) * _parts(body, counts)
        case Count(_, sort, body, bound):
            return _sides(bound) * (1 + counts.get(sort, 1) * _parts(body, counts))
        case Spatial(right=right, links=links) if not is_about_one_state(right):
            return 1 + counts.get(links.sort, 1) * (2 + _parts(right, counts))
        case Spatial():
            return 1
        case Over(body=body):
            return _parts(body, counts)
        case CountOf(bound, _, members):
            return _sides(bound) * (1 + sum(_parts(each, counts) for each in members))
        case _:
            return 1 + sum(_parts(cast('Formula', part), counts) for part in parts(formula))


def _operations(term: Formula | Term, counts: Counts) -> int:
    if isinstance(term, StateCount):
        return 1 + _parts(term.body, counts)
    inner = sum(_operations(each, counts) for each in parts(term))
    if isinstance(term, Aggregate):
        return 1 + counts.get(term.sort, 1) * (1 + inner)
    return inner + isinstance(term, Arithmetic | Function | PastTerm)


def _sides(bound: CountBound) -> int:
    """Return the number of counts that one is made of: exactly is at least and at most."""
    return 2 if bound is CountBound.EXACTLY else 1
