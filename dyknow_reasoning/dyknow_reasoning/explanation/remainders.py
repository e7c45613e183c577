"""What remains of undecided formulas, for those who ask between two states."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce

from dyknow_reasoning.execution.automata.templates import InstanceState
from dyknow_reasoning.execution.instance_monitor import InstanceMonitor
from dyknow_reasoning.explanation.residual import holds_at_the_end, remaining_text
from dyknow_reasoning.progression.gaps import Half


class Remainders:
    """Where the instances of each formula are, found once after a state for all formulas.

    Of two halves after a gap, the optimistic one counts: it is what the rest of the states must
    satisfy for the formula not to be false.

    Args:
        ensemble: the instances.
    """

    def __init__(self, ensemble: InstanceMonitor) -> None:
        self._ensemble = ensemble
        self._seats: dict[int, list[InstanceState]] = {}
        self._found_at: int | None = None

    def text(self, formula_id: int, latest: int) -> str | None:
        """What remains; None if the formula has seen no state.

        Args:
            formula_id: an undecided formula.
            latest: the valid time of the latest state.
        """
        seats = self._of(formula_id, latest)
        if any(seat.is_fresh for seat in seats):
            return None
        texts = [
            remaining_text(seat.location.node, seat.times, latest, seat.member.instance.atoms)
            for seat in seats
        ]
        return reduce(lambda left, right: f'({left}) and ({right})', texts)

    def holds_at_the_end(self, formula_id: int, latest: int) -> bool:
        """Whether what remains holds if no further state comes."""
        seats = self._of(formula_id, latest)
        return all(holds_at_the_end(seat.location.node) for seat in seats)

    def _of(self, formula_id: int, latest: int) -> Sequence[InstanceState]:
        if self._found_at != latest or formula_id not in self._seats:
            self._seats = self._found(latest)
            self._found_at = latest
        return self._seats[formula_id]

    def _found(self, latest: int) -> dict[int, list[InstanceState]]:
        by_formula: dict[int, dict[int, InstanceState]] = {}
        for seat in self._ensemble.seats(latest):
            by_order = by_formula.setdefault(seat.member.formula_id, {})
            order = seat.member.order
            if order not in by_order or seat.member.half is Half.OPTIMISTIC:
                by_order[order] = seat
        return {
            formula_id: [by_order[order] for order in sorted(by_order)]
            for formula_id, by_order in by_formula.items()
        }
