"""Instances of formulas, and what those of one shape share.

Instances that differ in nothing but their fields and constants have one shape, whichever formulas
they are from.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf

from dyknow_reasoning.execution.automata.atom_forms import form
from dyknow_reasoning.execution.automata.automaton import (
    Automaton,
    Location,
    Move,
    Sides,
    Times,
    nested_without_end,
)
from dyknow_reasoning.execution.automata.configurations import Configurations
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.gaps import Gap, Half
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.nodes import Constant, Node

_MOST_SLOTS_IN_A_BATCH = 6


@dataclass(frozen=True, slots=True, eq=False)
class FormulaInstance:
    """An instance of a formula of a group, or a half of one after a gap.

    Args:
        formula_id: the formula.
        order: which of its instances.
        instance: over which objects.
        kinds: of the features of the formula.
        kin: equal for those of one shape; a tuple if those with an equal one can make a batch.
        half: what it stands for.
        gap: where states are missing that matter to it.
    """

    formula_id: int
    order: int
    instance: Instance
    kinds: Kinds
    kin: Hashable
    half: Half = Half.WHOLE
    gap: Gap | None = None


def formula_instances(
    formula_id: int, instances: Sequence[Instance], kinds: Kinds
) -> Iterator[FormulaInstance]:
    """The instances of a formula that need states."""
    for order, instance in enumerate(instances):
        if type(instance.node) is not Constant:
            yield FormulaInstance(formula_id, order, instance, kinds, _kin(instance, kinds))


def _kin(instance: Instance, kinds: Kinds) -> Hashable:
    node = instance.node
    forms = tuple(form(atom, kinds) for atom in instance.atoms)
    narrow = 0 < node.mask.bit_length() <= _MOST_SLOTS_IN_A_BATCH and None not in forms
    return (node, forms) if narrow else node


@dataclass(frozen=True, slots=True)
class DecidingMoment:
    """What is known of an instance at the state that decides it.

    Args:
        shape: of the instance.
        location: what remained before this state.
        symbol: the truth of the atoms at this state.
        times: those that the bounds of the location count from, and that of this state.
        opened: the valid time from which each window without an end has been open.
    """

    shape: Template
    location: Location
    symbol: int
    times: Times
    opened: Mapping[Sides, int]


@dataclass(frozen=True, slots=True)
class InstanceVerdict:
    """The end of an instance.

    Args:
        member: the instance.
        verdict: whether it is true.
        moment: what is known of the deciding state; None if a gap before it decided.
    """

    member: FormulaInstance
    verdict: bool
    moment: DecidingMoment | None


class Template:
    """What the instances of one shape share.

    Args:
        formula: which they are instances of.
    """

    def __init__(self, formula: Node) -> None:
        self.automaton = Automaton(formula)
        self.configurations = Configurations(self.automaton)
        self.opens_later = nested_without_end(formula)
        # The largest number of nodes that an instance may have before the sizes are to be added up.
        self.harmless: float = inf
        self._tabulates = True

    @property
    def tabulates(self) -> bool:
        """Whether configurations pay: until there are too many."""
        return self._tabulates

    @property
    def is_full(self) -> bool:
        """Whether so much is remembered that it is time to `forget`."""
        return self.automaton.is_full or self.configurations.is_full

    @property
    def is_large(self) -> bool:
        """Whether an instance may be larger than is harmless."""
        return self.automaton.largest > self.harmless

    def forget(self, locations: Iterable[Location]) -> None:
        """Drops what was found, but for some locations, and all configurations."""
        self._tabulates = self._tabulates and not self.configurations.are_too_many
        self.configurations.forget()
        if self.automaton.is_full:
            self.automaton.forget(locations)


@dataclass(frozen=True, slots=True)
class InstanceState:
    """Where an undecided instance is.

    Args:
        member: the instance.
        shape: its shape.
        location: what remains of it.
        times: those that the bounds of the location count from.
        opened: the valid time from which each window without an end has been open.
    """

    member: FormulaInstance
    shape: Template
    location: Location
    times: Times
    opened: Mapping[Sides, int]

    @property
    def is_fresh(self) -> bool:
        """Whether it has not seen a state yet."""
        return self.location is self.shape.automaton.initial

    def across(self, gap: Gap, halves: tuple[Move, Move]) -> Sequence[InstanceState]:
        """What becomes of it in a gap: itself where that is harmless, one half, or two.

        Args:
            gap: in which states are missing.
            halves: to the optimistic and to the pessimistic half of what remains.
        """
        optimistic, pessimistic = halves
        if optimistic.target is pessimistic.target is self.location:
            return [self]
        match self.member.half:
            case Half.OPTIMISTIC:
                return [self._moved(optimistic, Half.OPTIMISTIC, gap)]
            case Half.PESSIMISTIC:
                return [self._moved(pessimistic, Half.PESSIMISTIC, gap)]
            case Half.WHOLE if optimistic.target is pessimistic.target:
                return [self._moved(optimistic, Half.WHOLE, gap)]
        return [
            self._moved(optimistic, Half.OPTIMISTIC, gap),
            self._moved(pessimistic, Half.PESSIMISTIC, gap),
        ]

    def _moved(self, move: Move, half: Half, gap: Gap) -> InstanceState:
        joined = self.member.gap.until(gap) if self.member.gap else gap
        member = replace(self.member, half=half, gap=joined)
        location, times = move.target, move.select(self.times)
        opened = {sides: self.opened[sides] for sides in location.unbounded}
        return InstanceState(member, self.shape, location, times, opened)
