"""The episodes of a formula that begin at every state."""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_common import DyKnowError, Value, Verdict, round_time
from dyknow_reasoning import FailureEpisode, FormulaGroup, start_verdicts
from dyknow_recordings.evaluation.results import Episode


class StandingEpisodes:
    """The episodes of one formula, one for each state, by one standing monitor.

    Args:
        text: of the formula.
        domains: the objects of each sort.
    """

    def __init__(self, text: str, domains: Mapping[str, tuple[str, ...]]) -> None:
        self._group = FormulaGroup()
        formula_id = self._group.add_formula(text, text, every_state=True)
        self._group.begin(domains)
        self._formula = self._group.standing.formulas[formula_id]
        self._log = self._formula.monitor.keep_all()
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
        for time, each in zip(states, start_verdicts(monitor, self._log, states), strict=True):
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
                )
            )
        found += [Episode(time, error=error) for time in self._times[monitor.states :]]
        return found


def _explanation(verdict: Verdict, latest: FailureEpisode | None, *, is_first: bool) -> str:
    """Return the reason for a verdict: in full for the first of consecutive false ones."""
    if verdict is not Verdict.FALSE or latest is None:
        return ''
    return latest.explanation if is_first else f'as from {round_time(latest.begin)} on'
