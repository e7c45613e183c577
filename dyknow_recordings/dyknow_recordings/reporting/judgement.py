"""Judgement of formulas at the end of a recording, exit codes, and the reasons for outcomes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum

from dyknow_common.executables import ERROR, FALSE, SUCCESS
from dyknow_recordings.evaluation.results import FormulaReport, Outcome, RecordingReport


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
    decisive = report.decisive
    if len(report.episodes) > 1:
        counts = dict.fromkeys(Outcome, 0)
        for episode in report.episodes:
            counts[episode.outcome] += 1
        listed = ', '.join(f'{count} {outcome}' for outcome, count in counts.items() if count)
        yield f'{len(report.episodes)} episodes: {listed}'
    if report.error is not None:
        yield report.error.message
    elif decisive is None:
        yield 'no episode has begun'
    elif decisive.error is not None:
        yield decisive.error.message
    elif report.outcome is Outcome.UNDECIDED:
        yield decisive.remainder
        if report.waits_for:
            yield report.waits_for
    else:
        yield decisive.explanation
    yield from report.events
