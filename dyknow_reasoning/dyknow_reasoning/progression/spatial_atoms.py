"""Spatial operators about given objects, as atoms of each state.

An operator whose operands are about one state is one atom; `execution.past` computes its truth for
all objects together. If an operand is about other states, the formula joins the operand at each
object that the operator may reach:

    somewhere[0, 100 m] eventually p    (r to r1 is in [0, 100 m] and eventually p at r1) or
                                        (r to r2 is in [0, 100 m] and eventually p at r2) or ...
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.language.formula import (
    And,
    Formula,
    Not,
    Or,
    PastAtom,
    is_about_one_state,
    joined,
)
from dyknow_reasoning.language.spatial import LinkEnd, Spatial, SpatialAtom
from dyknow_reasoning.language.terms import Term, Truth

MAX_PLACES: Final = 500
"""The most objects between which there may be links; their pairs are as many as its square."""

_KEPT: Final = 16
"""The most operators whose operands are kept for all objects: every object needs them."""

Domains: TypeAlias = Mapping[str, Sequence[str]]
_Sorts: TypeAlias = tuple[tuple[str, tuple[str, ...]], ...]

Ground: TypeAlias = Callable[[Any, Mapping[str, str], Domains], Any]
"""A function that returns a formula without variables, given their objects."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundLinks:
    """The links between some objects.

    Args:
        pairs: the indices of the objects of each link.
        conditions: a formula for each link, which holds if the link exists.
        lengths: the length of each link; empty if links have no length.
        places: x of each object, then y, if only Delaunay neighbours are linked.
    """

    pairs: tuple[tuple[int, int], ...]
    conditions: tuple[Formula, ...]
    lengths: tuple[Term, ...]
    places: tuple[Term, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The operands of a spatial operator at each object.

    Args:
        objects: the objects.
        links: between them.
        lefts: the left operand at each object; empty without one.
        rights: the right operand at each object.
    """

    objects: tuple[str, ...]
    links: GroundLinks
    lefts: tuple[Formula, ...]
    rights: tuple[Formula, ...]

    def __iter__(self) -> Iterator[Formula | Term]:
        """Return all formulas and terms."""
        yield from (*self.links.conditions, *self.links.lengths, *self.links.places)
        yield from (*self.lefts, *self.rights)

    def changed(self, change: Callable[[Any], Any]) -> Places:
        """Return the same with other operands; the links have no spatial operators."""
        lefts, rights = (tuple(map(change, each)) for each in (self.lefts, self.rights))
        return replace(self, lefts=lefts, rights=rights)


def spatial_formula(
    formula: Spatial, binding: Mapping[str, str], domains: Domains, ground: Ground
) -> Formula:
    """Return a spatial operator for given objects, as a formula about atoms.

    Args:
        formula: the operator; it has no variables besides the ones of `binding` and its own.
        binding: the object of each variable; for the operator's variable, where it begins.
        domains: the objects of each sort.
        ground: returns a formula without variables.

    Raises:
        ReasoningError: for an object that the links do not join, or too many objects.
    """
    place, origin = formula.place, binding[formula.place]
    objects = linked_objects(formula, origin, domains)
    sorts = tuple((sort, tuple(names)) for sort, names in domains.items())
    if is_about_one_state(formula.right):
        places = _places(formula, objects, sorts, ground)
        return PastAtom(SpatialAtom(formula, origin, '', places))
    reached = replace(formula, operator='reach', right=Truth(True))
    places = _places(reached, objects, sorts, ground)
    is_all = formula.operator == 'everywhere'
    members: list[Formula] = []
    for name in objects:
        atom = PastAtom(SpatialAtom(reached, origin, name, places))
        right = ground(formula.right, {**binding, place: name}, domains)
        members.append(Or(Not(atom), right) if is_all else And(atom, right))
    return joined(members, And if is_all else Or)


def linked_objects(formula: Spatial, origin: str, domains: Domains) -> tuple[str, ...]:
    """Return the objects that the links of a spatial operator join.

    Raises:
        ReasoningError: if the origin is not one of them, or they are too many.
    """
    sort = formula.links.sort
    objects = tuple(dict.fromkeys(domains.get(sort, ())))
    if origin not in objects:
        raise ReasoningError(
            f"'{origin}' is no object of the sort '{sort}', which the links of "
            f"'{formula.operator}' join; write a sort that contains it after 'in'"
        )
    if len(objects) > MAX_PLACES:
        raise ReasoningError(
            f"the links of '{formula.operator}' join {len(objects)} objects of the sort '{sort}', "
            f'more than {MAX_PLACES}; take a sort with fewer'
        )
    return objects


def linked_places(
    formula: Spatial, objects: Sequence[str], domains: Domains, ground: Ground
) -> Places:
    """Return the links of a spatial operator between some objects, and no operands."""
    linked = replace(formula, operator='reach', left=None, right=Truth(True))
    sorts = tuple((sort, tuple(names)) for sort, names in domains.items())
    return _places(linked, tuple(objects), sorts, ground)


@lru_cache(_KEPT)
def _places(formula: Spatial, objects: tuple[str, ...], sorts: _Sorts, ground: Ground) -> Places:
    domains, place = dict(sorts), formula.place
    links = _ground_links(
        formula.links, objects, sorts, ground, measured=not formula.distances.hops
    )
    lefts, rights = (
        tuple(ground(operand, {place: name}, domains) for name in objects if operand is not None)
        for operand in (formula.left, formula.right)
    )
    return Places(objects, links, lefts, rights)


@lru_cache(_KEPT)
def _ground_links(
    links: LinkEnd, objects: tuple[str, ...], sorts: _Sorts, ground: Ground, *, measured: bool
) -> GroundLinks:
    domains, link = dict(sorts), links.link
    first, second = links.variable, links.body.variable
    count = range(len(objects))
    pairs = tuple((start, end) for start in count for end in count if start != end)
    bindings = [{first: objects[start], second: objects[end]} for start, end in pairs]
    conditions, lengths = (
        tuple(ground(each, binding, domains) for binding in bindings if each is not None)
        for each in (link.condition, link.weight if measured else None)
    )
    places = tuple(ground(each, {first: name}, domains) for each in link.place for name in objects)
    return GroundLinks(pairs, conditions, lengths, places)
