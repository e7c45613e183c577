"""The results of the formulas of a group: when each of them ends, and why."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import cast

from dyknow_common import SymbolKind, Verdict, round_time
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.execution import Histories, Outcomes
from dyknow_reasoning.explanation.explanation import VerdictReasons, explain
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.symbols import symbols_of
from dyknow_reasoning.margins.group_margins import GroupMargins
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.sizes import Counts
from dyknow_reasoning.results import FormulaResult, NamedFormula
from dyknow_reasoning.standing import StandingFormulas


class GroupResults:
    """The formulas of a group that have no result yet, and the results of the others.

    Args:
        formulas: of the group, by their ids.
        counts: the number of objects of each sort.
        margins: of these formulas.
        standing: those that are asked at every state.
    """

    def __init__(
        self,
        formulas: Mapping[int, NamedFormula],
        counts: Counts,
        margins: GroupMargins,
        standing: StandingFormulas,
    ) -> None:
        self.undecided: set[int] = set()
        """The formulas without a result."""
        self.known: dict[int, Verdict] = {}
        """The verdicts of formulas that need no state, until they are reported."""
        self.ends: dict[int, str] = {}
        """The residual texts of formulas that have a result."""
        self.histories: Histories | None = None
        """The states that past operators look back to; formulas with a result need none."""
        self._formulas = formulas
        self._counts = counts
        self._margins = margins
        self._standing = standing

    def remove(self, formula_id: int) -> None:
        """Forget a formula."""
        self._end(formula_id)
        self._margins.remove(formula_id)
        self._standing.remove(formula_id)
        self.known.pop(formula_id, None)
        self.ends.pop(formula_id, None)

    def of_known(self) -> list[FormulaResult]:
        """Return the results of formulas that need no state, and forget that they were known."""
        known, self.known = self.known, {}
        return [
            self._decided(
                formula_id, verdict, None, _reason(self._formulas[formula_id].formula, verdict)
            )
            for formula_id, verdict in known.items()
            if formula_id in self.undecided
        ]

    def of(self, outcomes: Outcomes, valid_time: int, values: Values) -> list[FormulaResult]:
        """Return the results of the formulas that a state decides, or that fail with it."""
        results = []
        histories = cast('Histories', self.histories)
        for formula_id, outcome in outcomes.items():
            if isinstance(outcome, ReasoningError):
                results.append(self._failed(formula_id, outcome, valid_time))
            else:
                verdict = Verdict.TRUE if outcome.holds else Verdict.FALSE
                formula = self._formulas[formula_id].formula
                why = explain(formula, self._counts, outcome, values, histories)
                results.append(self._decided(formula_id, verdict, valid_time, why))
        return results

    def _end(self, formula_id: int) -> None:
        self.undecided.discard(formula_id)
        if self.histories is not None:
            self.histories.release([formula_id])

    def _decided(
        self, formula_id: int, verdict: Verdict, valid_time: int | None, why: VerdictReasons
    ) -> FormulaResult:
        self._end(formula_id)
        self.ends[formula_id] = verdict.name.lower()
        return FormulaResult(
            formula_id,
            self._formulas[formula_id].name,
            verdict,
            valid_time,
            why.text,
            objects=why.objects,
            windows=why.windows,
            ended_at=valid_time,
            margin=self._margins.end(formula_id),
        )

    def _failed(self, formula_id: int, error: ReasoningError, valid_time: int) -> FormulaResult:
        self._end(formula_id)
        self._standing.remove(formula_id)
        formula = self._formulas[formula_id]
        self.ends[formula_id] = str(formula)
        located = ReasoningError(f'at {round_time(valid_time)}: {error}', error.code)
        verdict = Verdict.UNDECIDED
        end, margin = valid_time, self._margins.end(formula_id)
        return FormulaResult(
            formula_id, formula.name, verdict, None, '', located, ended_at=end, margin=margin
        )


def _reason(formula: Formula, verdict: Verdict) -> VerdictReasons:
    """Return the reason of a verdict that needs no state."""
    symbols = symbols_of(formula)
    sorts = dict.fromkeys(each.name for each in symbols if each.kind is SymbolKind.SORT)
    objects = f' for the objects of {" and ".join(sorts)}' if sorts else ''
    return VerdictReasons(f'it is {verdict.name.lower()}{objects}, whatever the states are')


def merged(
    some: Iterable[tuple[int, Outcomes]], others: Mapping[int, Outcomes]
) -> Iterator[tuple[int, Outcomes]]:
    """Return outcomes in the order of the indices of their states."""
    pending = dict(others)
    for index, outcomes in some:
        yield from ((each, pending.pop(each)) for each in sorted(pending) if each < index)
        yield index, {**outcomes, **pending.pop(index, {})}
    yield from sorted(pending.items())
