"""Evaluations that run, as the reports that pictures are drawn from.

A check and the page draw the same pictures: both are made of a `FormulaReport`. A
formula that is asked at every state has the last ten times in which it was false; it holds between
them:

    asked at 0 s, false from the states of 3 s to 4 s    ->  true 0 s to 3 s, false 3 s to 4 s,
                                                             true from 4 s on
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from dyknow_common import SECOND_NS, ExitCode, Verdict
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, StandingVerdicts
from dyknow_recordings import Episode, FormulaReport
from dyknow_recordings.evaluation.observation import StateSignals
from dyknow_recordings.reporting.pictures.timeline import Span, segments

WINDOW_NS: Final = 120 * SECOND_NS
"""The time for which signals and tracks are kept and shown."""

_OBJECTS: Final = 'for '
"""The beginning of an explanation that names the objects which decide a formula."""

ENDS: Final = frozenset({ExitCode.CANCELLED, ExitCode.TIMEOUT})
"""The ends of a formula without a verdict that are no errors."""


def live_report(status: EvaluationStatus, signals: StateSignals | None = None) -> FormulaReport:
    """Return the report of an evaluation as it stands, with the signals of its states if known."""
    if status.episodes is None:
        episodes = [_only_episode(status)]
    else:
        episodes = list(_standing_episodes(status, status.episodes))
    error = status.error
    return FormulaReport(
        status.name,
        status.formula,
        tuple(episodes),
        None if error is not None and error.code in ENDS else error,
        status.states_progressed,
        status.groundings,
        events=status.events,
        waits_for=status.waits_for,
        signals=signals,
        last_state=status.latest_valid_time,
    )


def strip(status: EvaluationStatus, whole: Span) -> list[list[Any]]:
    """Return the outcomes of an evaluation in a span of time: start and end (0 to 1), outcome."""
    found = []
    for each in segments(live_report(status), whole):
        start, end = max(each.span.start, whole.start), min(each.span.end, whole.end)
        if start < end:
            places = round(whole.place(start), 4), round(whole.place(end), 4)
            found.append([*places, str(each.outcome)])
    return found


def _only_episode(status: EvaluationStatus) -> Episode:
    return Episode(
        status.started,
        status.verdict,
        status.decided_at,
        status.explanation,
        residual_formula='' if status.phase is EvaluationPhase.ENDED else status.residual_formula,
        presumably_false=status.presumably_false,
        objects=_deciding_objects(status.explanation),
    )


def _standing_episodes(status: EvaluationStatus, verdicts: StandingVerdicts) -> Iterator[Episode]:
    begin: int | None = status.started
    if verdicts.episode_count > len(verdicts.latest_episodes):
        begin = None  # Nothing is known of the time before the oldest one.
    for each in verdicts.latest_episodes:
        if begin is not None and begin < each.begin:
            yield Episode(begin, Verdict.TRUE)
        yield Episode(
            each.begin,
            Verdict.FALSE,
            each.decided_at,
            each.text,
            objects=_deciding_objects(each.explanation),
        )
        begin = each.end + 1 if each.has_ended else None
    if begin is not None:
        is_known = verdicts.holds or verdicts.latest_episodes
        yield Episode(
            begin,
            Verdict.TRUE if is_known else Verdict.UNDECIDED,
            residual_formula=status.residual_formula,
        )


def _deciding_objects(explanation: str) -> str:
    if not explanation.startswith(_OBJECTS):
        return ''
    return explanation.removeprefix(_OBJECTS).partition(': ')[0]
