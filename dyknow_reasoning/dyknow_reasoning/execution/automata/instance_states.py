"""Data on the undecided instances of formulas, and on their verdicts."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

from dyknow_reasoning.execution.automata.automaton import Location, Move, Times
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.language.formula import Freeze
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.gaps import Gap, Half, apart, bounded_atoms, whole_past_atoms
from dyknow_reasoning.progression.instances import Instance
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology, Node, Sides
from dyknow_reasoning.progression.progression import NONE_KEPT


@dataclass(frozen=True, slots=True, eq=False)
class FormulaInstance(Instance):
    """An instance of a formula of a group, or one half of it after a gap.

    Args:
        formula_id: the formula.
        order: the index of the instance in the formula.
        kinds: the kinds of the features of the formula.
        batch_key: equal for instances that can share a batch; None if no batch can hold it.
        half: the half that it stands for.
        gap: the gap that its verdict depends on.
    """

    formula_id: int
    order: int
    kinds: Kinds
    batch_key: Hashable
    half: Half = Half.WHOLE
    gap: Gap | None = None

    def __post_init__(self) -> None:
        if self.keeps_values or any(isinstance(each, Freeze) for each in self.atoms):
            # Kept values change the atoms of an instance: each needs a list of its own.
            object.__setattr__(self, 'atoms', list(self.atoms))

    @classmethod
    def of(
        cls, instance: Instance, formula_id: int, order: int, kinds: Kinds, *, batch_key: Hashable
    ) -> FormulaInstance:
        """Return an instance as one of a formula."""
        shared = instance.binding, instance.atoms, instance.node
        return cls(*shared, formula_id, order, kinds, batch_key, source=instance.source)


@dataclass(frozen=True, slots=True)
class InstanceState:
    """The state of an undecided instance between two states of the stream.

    Args:
        instance: the instance.
        template: its template.
        location: its location in the automaton.
        times: the clocks: the times of the states that bounds of the location count from, in ns.
        window_origins: the valid time since which each open window without an end is open.
    """

    instance: FormulaInstance
    template: Template
    location: Location
    times: Times
    window_origins: Mapping[Sides, int]

    @property
    def node(self) -> Node:
        """The remaining formula."""
        return self.location.node

    @property
    def is_fresh(self) -> bool:
        """True if the instance has seen no state."""
        return self.location.is_fresh

    def after_gap(self, gap: Gap, halves: tuple[Move, Move]) -> Sequence[InstanceState]:
        """Return the state itself if the gap has no effect, else one half or both.

        Args:
            gap: the gap.
            halves: the moves to the optimistic and the pessimistic half of the location.
        """
        looks_back = whole_past_atoms(self.instance.atoms, self.node.mask) != 0
        half, location = self.instance.half, self.location
        moves = halves_to_follow(half, location, halves, looks_back=looks_back)
        return [self._moved(move, half, gap) for half, move in moves.items()] or [self]

    def _moved(self, move: Move, half: Half, gap: Gap) -> InstanceState:
        joined = self.instance.gap.join(gap) if self.instance.gap else gap
        instance = replace(self.instance, half=half, gap=joined)
        before = self.window_origins
        if past := whole_past_atoms(instance.atoms, self.node.mask):
            automaton, most = self.template.automaton, half is Half.OPTIMISTIC
            atoms = bounded_atoms(instance.atoms, automaton.slots, most=most)
            node = automaton.apart(instance.node, past)
            instance = replace(instance, atoms=atoms, node=node, batch_key=None)
            before = {
                (universal, automaton.apart(left, past), automaton.apart(right, past)): origin
                for (universal, left, right), origin in before.items()
            }
        location, times = move.target, move.select(self.times)
        origins = {sides: before[sides] for sides in location.unbounded}
        return InstanceState(instance, self.template, location, times, origins)


@dataclass(frozen=True, slots=True)
class DecidingMoment:
    """The state of the stream that decides an instance.

    Args:
        before: the instance before this state.
        symbol: the truth of the atoms at this state, as bits.
        valid_time: the valid time of this state, in nanoseconds.
        previous: the valid time of the state before; unused if the instance is fresh.
        kept: the formulas that slots stand for at this state, because of kept values.
    """

    before: InstanceState
    symbol: int
    valid_time: int
    previous: int
    kept: Mapping[int, Node] = field(default_factory=lambda: NONE_KEPT)

    @classmethod
    def of(
        cls, before: InstanceState, symbol: int, valid_time: int, previous: int
    ) -> DecidingMoment:
        """Return a moment, also if the atoms of the instance come and go."""
        if before.instance.keeps_values:
            before = replace(before, instance=replace(before.instance))
        kept = before.template.automaton.kept(symbol)
        return cls(before, symbol, valid_time, previous, kept)


@dataclass(frozen=True, slots=True)
class InstanceVerdict:
    """The verdict on an instance.

    Args:
        instance: the instance.
        holds: the verdict.
        moment: the deciding state; None if a gap before it decided the instance.
    """

    instance: FormulaInstance
    holds: bool
    moment: DecidingMoment | None


def halves_to_follow(
    half: Half, before: Location, halves: tuple[Move, Move], *, looks_back: bool = False
) -> dict[Half, Move]:
    """Return the moves after a gap, to one half or to both; empty if the gap has no effect.

    Args:
        half: the part of the truth that the location before stands for.
        before: the location.
        halves: the moves to its optimistic and its pessimistic half.
        looks_back: True if its atoms depend on the missing states, too.
    """
    optimistic, pessimistic = halves
    if optimistic.target is pessimistic.target and not looks_back:
        if optimistic.target is before:
            return {}
        if half is Half.WHOLE:
            return {half: optimistic}
    moves = {Half.OPTIMISTIC: optimistic, Half.PESSIMISTIC: pessimistic}
    return moves if half is Half.WHOLE else {half: moves[half]}


def bounded_halves(instance: FormulaInstance, gap: Gap) -> list[FormulaInstance]:
    """Return the halves of an instance that begins after a gap in what it looks back to."""
    offset = instance.node.mask.bit_length()
    past = whole_past_atoms(instance.atoms, instance.node.mask)
    node = _fresh_apart(instance.node, past)
    return [
        replace(
            instance,
            node=node,
            atoms=bounded_atoms(instance.atoms, offset, most=half is Half.OPTIMISTIC),
            batch_key=None,
            half=half,
            gap=gap,
        )
        for half in (Half.OPTIMISTIC, Half.PESSIMISTIC)
    ]


@lru_cache(256)
def _fresh_apart(node: Node, past: int) -> Node:
    """Return a formula that has seen no state with some atoms `apart`, the same each time."""
    store = NodeStore(Chronology(), [node])
    return apart(node, past, node.mask.bit_length(), store)
