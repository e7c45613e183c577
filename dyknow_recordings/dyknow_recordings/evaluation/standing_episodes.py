"""The episodes of a formula that begin at every state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dyknow_common import DyKnowError, Margin, Value, Verdict, round_time
from dyknow_coordinator import with_unit
from dyknow_reasoning import FailureEpisode, FormulaGroup, UnknownFeatures, start_verdicts
from dyknow_recordings.evaluation.results import Episode


class StandingEpisodes:
    """The episodes of one formula, one for each state, by one standing monitor.

    Args:
        text: of the formula.
        domains: the objects of each sort.
        unknown: the features that may be unknown at a state.
        units: of its features, if margins are asked for; else None.
    """

    def __init__(
        self,
        text: str,
        domains: Mapping[str, tuple[str, ...]],
        unknown: UnknownFeatures,
        units: Mapping[str, str] | None = None,
    ) -> None:
        self._group = FormulaGroup()
        self._units = units or {}
        formula_id = self._group.add_formula(text, text, margin=units is not None, every_state=True)
        self._group.begin(domains, unknown)
        self._formula = self._group.standing.formulas[formula_id]
        self._log = self._formula.monitor.keep_all()
        self._margins = self._formula.margins
        if self._margins is not None:
            self._margins.keep_all()
        self._times: list[int] = []

    def progress(self, valid_time: int, values: Mapping[str, Value]) -> DyKnowError | None:
        """Begin an episode and progress all; return the error by which the formula fails."""
        results = self._group.progress(valid_time, values)
        self._times.append(valid_time)
        return results[0].error if results else None

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        self._group.gap()

    def episodes(self, error: DyKnowError | None = None) -> list[Episode]:
        """Return the episodes; those that are undecided have the error, if there is one."""
        monitor = self._formula.monitor
        states = self._times[: monitor.states]
        failures = {each.begin: each for each in self._formula.episodes(len(states))}
        found: list[Episode] = []
        latest: FailureEpisode | None = None
        verdicts = start_verdicts(monitor, self._log, states)
        for time, each, margin in zip(states, verdicts, self._margins_of(states), strict=True):
            latest = failures.get(time, latest)
            is_undecided = each.verdict is Verdict.UNDECIDED
            is_first = each.verdict is Verdict.FALSE and time in failures
            found.append(
                Episode(
                    time,
                    each.verdict,
                    each.decided_at,
                    _explanation(each.verdict, latest, is_first=is_first),
                    each.error or (error if is_undecided else None),
                    residual_formula=each.residual_formula,
                    presumably_false=each.presumably_false,
                    objects=latest.objects if latest and is_first else '',
                    margin=margin,
                    wants=tuple(each.wants.items()),
                )
            )
        found += [Episode(time, error=error) for time in self._times[monitor.states :]]
        return found

    def _margins_of(self, states: Sequence[int]) -> list[Margin | None]:
        if self._margins is None:
            return [None] * len(states)
        found = self._margins.of_each()[: len(states)]
        return [with_unit(each, self._units) for each in found]


def _explanation(verdict: Verdict, latest: FailureEpisode | None, *, is_first: bool) -> str:
    """Return the reason for a verdict: in full for the first of consecutive false ones."""
    if verdict is not Verdict.FALSE or latest is None:
        return ''
    return latest.explanation if is_first else f'as from {round_time(latest.begin)} on'
