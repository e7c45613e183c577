"""Aggregation of the verdicts on instances into the outcomes of formulas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution.automata.instance_states import FormulaInstance, InstanceVerdict
from dyknow_reasoning.progression.gaps import Gap, Half, unknowable

Outcome: TypeAlias = InstanceVerdict | ReasoningError
"""The verdict on the instance that decides a formula, or the error by which the formula fails."""

Outcomes: TypeAlias = Mapping[int, Outcome]
"""The outcomes of formulas by their ids."""


class VerdictAggregation:
    """The undecided instances of formulas, or their halves after a gap.

    A formula is false if an instance, or the optimistic half of one, is false. It is true once no
    instance is left. However, if the pessimistic half of an instance is false, the formula cannot
    become true, and fails once no instance is left.
    """

    def __init__(self) -> None:
        self._undecided: dict[int, set[FormulaInstance]] = {}
        # For each formula that cannot become true, the gap that prevents it.
        self._unprovable: dict[int, Gap] = {}

    def __bool__(self) -> bool:
        return bool(self._undecided)

    def __contains__(self, instance: FormulaInstance) -> bool:
        return instance in self._undecided.get(instance.formula_id, ())

    def add(self, instances: Iterable[FormulaInstance]) -> None:
        """Add undecided instances."""
        for instance in instances:
            self._undecided.setdefault(instance.formula_id, set()).add(instance)

    def count(self, formula_id: int) -> int:
        """Return the number of undecided instances of a formula; each half counts."""
        return len(self._undecided.get(formula_id, ()))

    def replace(self, instance: FormulaInstance, halves: Iterable[FormulaInstance]) -> None:
        """Replace an instance by its halves after a gap."""
        self._undecided[instance.formula_id].discard(instance)
        unprovable = instance.formula_id in self._unprovable
        self.add(half for half in halves if not (unprovable and half.half is Half.PESSIMISTIC))

    def apply(
        self, verdicts: Iterable[InstanceVerdict]
    ) -> tuple[dict[int, Outcome], Sequence[FormulaInstance]]:
        """Apply verdicts; return the outcomes, and all instances that have become irrelevant."""
        outcomes: dict[int, Outcome] = {}
        removed: list[FormulaInstance] = []
        # The pessimistic half of an instance comes last: only this half proves a formula.
        for verdict in sorted(verdicts, key=lambda v: (v.instance.order, v.instance.half.value)):
            instance, formula_id = verdict.instance, verdict.instance.formula_id
            if instance not in self:
                continue
            ended = {instance, *self._superseded(verdict)}
            undecided = self._undecided[formula_id]
            undecided -= ended
            removed += ended
            if formula_id in outcomes:
                continue
            if not verdict.holds and instance.half is not Half.PESSIMISTIC:
                outcomes[formula_id] = verdict
            elif not undecided:
                gap = self._unprovable.get(formula_id)
                outcomes[formula_id] = unknowable(gap) if gap else verdict
        self.forget(outcomes)
        return outcomes, removed

    def forget(self, formulas: Iterable[int]) -> None:
        """Remove formulas."""
        for formula_id in formulas:
            self._undecided.pop(formula_id, None)
            self._unprovable.pop(formula_id, None)

    def _superseded(self, verdict: InstanceVerdict) -> Iterable[FormulaInstance]:
        """Return the other pessimistic halves once one is false."""
        instance = verdict.instance
        if verdict.holds or instance.gap is None or instance.half is not Half.PESSIMISTIC:
            return ()
        self._unprovable[instance.formula_id] = instance.gap
        others = self._undecided[instance.formula_id]
        return [other for other in others if other.half is Half.PESSIMISTIC]
