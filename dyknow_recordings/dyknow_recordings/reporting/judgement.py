"""Judgement of formulas at the end of a recording, exit codes, and the reasons for outcomes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from enum import StrEnum

from dyknow_common.executables import ERROR, FALSE, SUCCESS
from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome, RecordingReport


class Judgement(StrEnum):
    """Decides which formulas pass that are undecided at the end.

    AUTO: invariants that were not broken pass, obligations that were not met fail.
    """

    AUTO = 'auto'
    PASS = 'pass'  # noqa: S105 - no password
    FAIL = 'fail'

    def passes(self, report: FormulaReport) -> bool:
        """Return True if a formula has the outcome that it should have."""
        if report.outcome is not Outcome.UNDECIDED:
            return report.outcome is Outcome.TRUE
        if self is Judgement.AUTO:
            return not report.presumably_false
        return self is Judgement.PASS

    def exit_code(self, reports: Iterable[RecordingReport]) -> int:
        """Return the exit code of a command that has checked some recordings."""
        reports = tuple(reports)
        formulas = [formula for report in reports for formula in report.formulas]
        if any(each.outcome is Outcome.ERROR for each in formulas):
            return ERROR
        is_well = all(map(self.passes, formulas)) and not any(each.broken for each in reports)
        return SUCCESS if is_well else FALSE


def reasons(report: FormulaReport) -> Iterator[str]:
    """Yield the lines that say why a formula has its outcome."""
    if len(report.episodes) > 1:
        yield episode_counts(report)
    yield from report.reasons_of_attempts() if report.attempts else (report.reason,)
    if report.outcome is Outcome.UNDECIDED and report.episodes and report.waits_for:
        yield report.waits_for
    yield from report.events


def episode_counts(report: FormulaReport) -> str:
    """Return the numbers of the episodes of a formula, all and by outcome."""
    return f'{len(report.episodes)} episodes: {outcome_counts(report.episodes)}'


def outcome_counts(found: Sequence[Episode | FormulaReport]) -> str:
    """Return how many have each outcome, the worst first."""
    counts = Counter(each.outcome for each in found)
    return ', '.join(f'{counts[each]} {each}' for each in Outcome if counts[each])
