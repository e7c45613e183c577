"""Reasons for outcomes, for people."""

from __future__ import annotations

from collections.abc import Iterator

from dyknow_recordings.evaluation.results import Episode, FormulaReport, Outcome


def decisive_episode(report: FormulaReport) -> Episode | None:
    """Return the first episode with the outcome of the formula.

    Of undecided ones, an obligation that was not met comes first: it may be a failure.
    """
    found = [each for each in report.episodes if each.outcome is report.outcome]
    return next((each for each in found if each.presumably_false), found[0] if found else None)


def reasons(report: FormulaReport, decisive: Episode | None) -> Iterator[str]:
    """Yield the lines that say why a formula has its outcome.

    Args:
        report: of the formula.
        decisive: its decisive episode.
    """
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
