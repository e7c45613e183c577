"""Judgement of formulas that are undecided at the end of a recording, and exit codes."""

from __future__ import annotations

from collections.abc import Iterable
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
