"""The margins of the formulas of a group."""

from __future__ import annotations

from dyknow_common import Margin
from dyknow_reasoning.margins.building import check_margin
from dyknow_reasoning.margins.formula_margin import BoundedMargins, FormulaMargin
from dyknow_reasoning.margins.standing_margin import StandingMargin
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import Domains
from dyknow_reasoning.progression.unknown_features import ALL_KNOWN, UnknownFeatures
from dyknow_reasoning.results import NamedFormula


class GroupMargins:
    """Computes the margins of the formulas for which they are requested.

    Args:
        limit: the limit of the operators of a formula.

    Attributes:
        running: the margins that change with the next state, by formula.
    """

    def __init__(self, limit: int) -> None:
        self.running: dict[int, BoundedMargins] = {}
        self._limit = limit
        self._domains: Domains | None = None
        self._unknown = ALL_KNOWN
        self._latest: int | None = None
        # The formulas whose objects are not known, and the margins that have not begun.
        self._requested: dict[int, NamedFormula] = {}
        self._ready: dict[int, BoundedMargins] = {}
        self._ended: dict[int, Margin] = {}

    def add(self, formula_id: int, formula: NamedFormula, *, looks_back: bool = False) -> None:
        """Request the margin of a formula; see `start`.

        Args:
            formula_id: the id of the formula.
            formula: the formula.
            looks_back: True if it looks back to earlier states; their margins are not known.

        Raises:
            ReasoningError: for a formula with a part that has no margin, or one that is too large.
        """
        check_margin(formula.formula)
        if looks_back:
            self._ended[formula_id] = Margin()
        elif self._domains is None:
            self._requested[formula_id] = formula
        else:
            self._ready[formula_id] = self._margin(formula, self._domains)

    def begin(self, domains: Domains, unknown: UnknownFeatures = ALL_KNOWN) -> None:
        """Set the objects of each sort, and the features that may be unknown.

        Raises:
            ReasoningError: for a formula that is too large.
        """
        self._unknown = unknown
        self._ready = {key: self._margin(each, domains) for key, each in self._requested.items()}
        self._domains = domains
        self._requested.clear()

    def start(self, formula_id: int) -> None:
        """Begin with the next state, if the margin of the formula was requested."""
        if found := self._ready.pop(formula_id, None):
            self.running[formula_id] = found

    def progress(self, valid_time: int, values: Values) -> None:
        """Process a state, unless it is not later than the one before."""
        if self._latest is None or valid_time > self._latest:
            self._latest = valid_time
            for each in self.running.values():
                each.step(valid_time, values)

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        for each in self.running.values():
            each.gap()

    def of(self, formula_id: int) -> Margin | None:
        """Return the margin of a formula at present, or at its end; None if not requested.

        For a formula that is asked at every state, it is the least one from any of them on.
        """
        if found := self.running.get(formula_id) or self._ready.get(formula_id):
            return found.at_present()
        return Margin() if formula_id in self._requested else self._ended.get(formula_id)

    def end(self, formula_id: int) -> Margin | None:
        """End with a formula, and return its margin; None if it was not requested."""
        found = self.of(formula_id)
        if found is not None:
            self.remove(formula_id)
            self._ended[formula_id] = found
        return found

    def forget(self, formula_id: int) -> None:
        """End the margin of a formula; it is unknown from now on."""
        if self.running.pop(formula_id, None):
            self._ended[formula_id] = Margin()

    def remove(self, formula_id: int) -> None:
        """Remove a formula."""
        for each in (self.running, self._requested, self._ready, self._ended):
            each.pop(formula_id, None)

    def standing(self, formula_id: int) -> StandingMargin | None:
        """Return the margins of a formula that is asked at every state; None if not requested."""
        found = self.running.get(formula_id)
        return found if isinstance(found, StandingMargin) else None

    def _margin(self, formula: NamedFormula, domains: Domains) -> BoundedMargins:
        kind = StandingMargin if formula.every_state else FormulaMargin
        return kind(formula.formula, formula.kinds, domains, self._limit, self._unknown)
