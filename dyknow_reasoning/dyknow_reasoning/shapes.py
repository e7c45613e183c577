"""Instances of formulas, and what those of one shape share.

Instances that differ in nothing but their fields and constants have one shape, whichever formulas
they are from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dyknow_reasoning.automaton import Automaton, nested_without_end
from dyknow_reasoning.configurations import Configurations

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from dyknow_reasoning.automaton import Location, Sides, Times
    from dyknow_reasoning.grounding import Instance
    from dyknow_reasoning.nodes import Node
    from dyknow_reasoning.type_checking import Kinds


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """An instance of a formula of a group.

    Args:
        formula_id: the formula.
        order: which of its instances.
        instance: over which objects.
        kinds: of the features of the formula.
    """

    formula_id: int
    order: int
    instance: Instance
    kinds: Kinds


@dataclass(frozen=True, slots=True)
class Moment:
    """What is known of an instance at the state that decides it.

    Args:
        shape: of the instance.
        location: what remained before this state.
        symbol: the truth of the atoms at this state.
        times: those that the bounds of the location count from, and that of this state.
        opened: the valid time from which each window without an end has been open.
    """

    shape: Shape
    location: Location
    symbol: int
    times: Times
    opened: Mapping[Sides, int]


@dataclass(frozen=True, slots=True)
class Finish:
    """The end of an instance.

    Args:
        member: the instance.
        verdict: whether it is true.
        moment: what is known of the deciding state.
    """

    member: Member
    verdict: bool
    moment: Moment


class Shape:
    """What the instances of one shape share.

    Args:
        formula: which they are instances of.
    """

    def __init__(self, formula: Node) -> None:
        self.automaton = Automaton(formula)
        self.configurations = Configurations(self.automaton)
        self.opens_later = nested_without_end(formula)
        # The largest number of nodes that an instance may have before the sizes are to be added up.
        self.harmless = 0
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
