"""What is known of formulas, from what is known of their instances."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.templates import FormulaInstance, InstanceVerdict
from dyknow_reasoning.progression.gaps import Gap, Half, unknowable


@dataclass(frozen=True, slots=True)
class StateOutcome:
    """What a state brings.

    Args:
        decisions: for each formula that it decides, the instance that made the difference.
        failures: for each formula that it fails, why.
    """

    decisions: Mapping[int, InstanceVerdict] = field(default_factory=dict)
    failures: Mapping[int, ReasoningError] = field(default_factory=dict)


class VerdictAggregation:
    """Keeps which instances, or halves of them, are undecided.

    A formula is false if an instance is, or the optimistic half of one. It is true once no instance
    is left, unless the pessimistic half of one was false: then nothing can be known.
    """

    def __init__(self) -> None:
        self._undecided: dict[int, set[FormulaInstance]] = {}
        # Where states are missing that keep a formula from being found true.
        self._unprovable: dict[int, Gap] = {}

    def __bool__(self) -> bool:
        return bool(self._undecided)

    def __contains__(self, member: FormulaInstance) -> bool:
        return member in self._undecided.get(member.formula_id, ())

    def add(self, members: Iterable[FormulaInstance]) -> None:
        """Takes on instances."""
        for member in members:
            self._undecided.setdefault(member.formula_id, set()).add(member)

    def count(self, formula_id: int) -> int:
        """How many instances of a formula are undecided, halves for themselves."""
        return len(self._undecided[formula_id])

    def replace(self, member: FormulaInstance, halves: Iterable[FormulaInstance]) -> None:
        """Goes on with what became of an instance in a gap."""
        self._undecided[member.formula_id].discard(member)
        unprovable = member.formula_id in self._unprovable
        self.add(half for half in halves if not (unprovable and half.half is Half.PESSIMISTIC))

    def take(
        self, finishes: Iterable[InstanceVerdict]
    ) -> tuple[StateOutcome, Sequence[FormulaInstance]]:
        """What the ends of instances come to, and with whom not to go on; drops the formulas."""
        decisions: dict[int, InstanceVerdict] = {}
        failures: dict[int, ReasoningError] = {}
        gone: list[FormulaInstance] = []
        for finish in sorted(finishes, key=_order):
            member, formula_id = finish.member, finish.member.formula_id
            if member not in self:
                continue
            ended = {member, *self._superseded(finish)}
            undecided = self._undecided[formula_id]
            undecided -= ended
            gone += ended
            if formula_id in decisions:
                continue
            if not finish.verdict and member.half is not Half.PESSIMISTIC:
                decisions[formula_id] = finish
            elif not undecided and formula_id in self._unprovable:
                failures[formula_id] = unknowable(self._unprovable[formula_id])
            elif not undecided:
                decisions[formula_id] = finish
        self.forget([*decisions, *failures])
        return StateOutcome(decisions, failures), gone

    def forget(self, formulas: Iterable[int]) -> None:
        """Goes on without some formulas."""
        for formula_id in formulas:
            self._undecided.pop(formula_id, None)
            self._unprovable.pop(formula_id, None)

    def _superseded(self, finish: InstanceVerdict) -> Iterable[FormulaInstance]:
        """The other pessimistic halves once one is false: the formula cannot be found true."""
        member = finish.member
        if finish.verdict or member.gap is None or member.half is not Half.PESSIMISTIC:
            return ()
        self._unprovable[member.formula_id] = member.gap
        others = self._undecided[member.formula_id]
        return [other for other in others if other.half is Half.PESSIMISTIC]


def _order(finish: InstanceVerdict) -> tuple[int, str]:
    """By instance; the pessimistic half last, for it is the one that proves a formula."""
    return finish.member.order, finish.member.half.value
