"""Results of formulas over a recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import chain
from typing import Final

from dyknow_common import (
    DyKnowError,
    Margin,
    ProbabilityInterval,
    Verdict,
    round_time,
    shortened,
)
from dyknow_coordinator import SymbolGrounding
from dyknow_recordings.evaluation.observation import StateSignals
from dyknow_recordings.evaluation.recorded_map import RecordedMap
from dyknow_recordings.health import BrokenExpectation
from dyknow_stream_processing import Violation

MAX_REMAINDER: Final = 300
"""The most characters that people are shown of what remains of a formula; JSON has all of it."""


class Outcome(StrEnum):
    """The outcome of a formula, or of all; of several episodes the worst counts.

    A formula without an episode is undecided if it has had a state, as its trigger never held.
    """

    ERROR = 'error'
    FALSE = 'false'
    UNDECIDED = 'undecided'
    TRUE = 'true'


@dataclass(frozen=True, slots=True)
class Episode:
    """The evaluation of a formula from one state on.

    Args:
        begin: the valid time of the first state in nanoseconds; None if it needs no state.
        verdict: undecided if it has failed, or at the end of the recording.
        decided_at: the valid time of the deciding state in nanoseconds; None without a verdict, or
            if the verdict needs no state.
        explanation: the reason for the verdict, for people.
        error: why it has failed.
        residual_formula: what is left of an undecided formula: what further states must satisfy.
        presumably_false: True if an undecided formula would be false without further states: an
            obligation that was not met. False for an invariant that was not broken.
        objects: the objects that decide the formula, `u = uav1`; empty if there is no choice.
        windows: the intervals of the obligations that the explanation names, in nanoseconds.
        margin: the margin at its end, if margins were asked for.
        wants: the unknown features for want of which an undecided formula has no verdict, with the
            time since when, in nanoseconds.
    """

    begin: int | None
    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    explanation: str = ''
    error: DyKnowError | None = None
    residual_formula: str = ''
    presumably_false: bool = False
    objects: str = ''
    windows: tuple[tuple[int, int], ...] = ()
    margin: Margin | None = None
    wants: tuple[tuple[str, int], ...] = ()

    @property
    def outcome(self) -> Outcome:
        """The outcome."""
        return Outcome.ERROR if self.error is not None else Outcome(self.verdict.name.lower())

    @property
    def reason(self) -> str:
        """Why it has its outcome, for people."""
        if self.error is not None:
            return self.error.message
        return self.remainder if self.outcome is Outcome.UNDECIDED else self.explanation

    @property
    def remainder(self) -> str:
        """How an undecided formula has ended, and the ends of what remains of it, for people."""
        end = 'nothing broke it'
        if self.presumably_false:
            end = 'it may be false' if self.wants else 'an obligation was not met'
        return f'{end}; what remains: {shortened(self.residual_formula, MAX_REMAINDER)}'


@dataclass(frozen=True, slots=True)
class StateGap:
    """A time in which states may be missing, between the valid times of two states.

    Args:
        after: the valid time of the last state before the gap, in nanoseconds.
        before: the valid time of the first state after the gap; None if no state came.
    """

    after: int
    before: int | None


@dataclass(frozen=True, slots=True)
class FormulaReport:
    """All that is known of a formula after a recording.

    Args:
        name: for people.
        formula: its canonical text; the requested text if that is not a formula.
        episodes: in the order of their begins.
        error: why the formula could not be evaluated, or no longer.
        states: the number of states that it was progressed over.
        groundings: the streams of its ground features.
        violations: the violations of the constraints of these streams.
        gaps: the gaps between its states.
        events: the changes of its streams, for people.
        waits_for: why no more states came, if that is known.
        signals: the signals of the states, if they were to be kept.
        first_state: the valid time of its first state in nanoseconds, which may be before the first
            episode.
        last_state: the valid time of its last state in nanoseconds, if neither the episodes nor the
            signals tell it.
        probability: the formula's probability from the first state on, for any further states; None
            if nobody asked for it, or if nothing in the formula is uncertain.
        probability_so_far: the same, assuming that no further state comes.
        units: the units of its features, by their names, as far as they are known.
        asked_probability: the canonical text that asks for them.
        attempts: the evaluations of a formula that was evaluated again after an error, in order;
            empty if it was evaluated once.
    """

    name: str
    formula: str
    episodes: tuple[Episode, ...] = ()
    error: DyKnowError | None = None
    states: int = 0
    groundings: tuple[SymbolGrounding, ...] = ()
    violations: tuple[Violation, ...] = ()
    gaps: tuple[StateGap, ...] = ()
    events: tuple[str, ...] = ()
    waits_for: str = ''
    signals: StateSignals | None = None
    first_state: int | None = None
    last_state: int | None = None
    probability: ProbabilityInterval | None = None
    probability_so_far: ProbabilityInterval | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    asked_probability: str = ''
    attempts: tuple[Attempt, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """The worst outcome of its episodes."""
        found = {each.outcome for each in self.episodes}
        if self.error is not None or self.attempts:
            found.add(Outcome.ERROR)
        return next((each for each in Outcome if each in found), Outcome.UNDECIDED)

    @property
    def decisive(self) -> Episode | None:
        """The first episode with the outcome of the formula.

        Among undecided episodes, an episode with an unmet obligation is preferred: it may be a
        failure. A false episode is preferred to errors after which the formula was evaluated again.
        """
        outcome = self.outcome
        if self.attempts and any(each.outcome is Outcome.FALSE for each in self.episodes):
            outcome = Outcome.FALSE
        found = [each for each in self.episodes if each.outcome is outcome]
        return next((each for each in found if each.presumably_false), found[0] if found else None)

    @property
    def reason(self) -> str:
        """Why it has its outcome, for people."""
        if self.attempts:
            return '; '.join(self.reasons_of_attempts())
        if self.error is not None:
            return self.error.message
        decisive = self.decisive
        return 'no episode has begun' if decisive is None else decisive.reason

    @property
    def failure(self) -> Episode | None:
        """Its first false episode; None if it has none, or an error that was not retried."""
        decisive = self.decisive
        return decisive if decisive and decisive.outcome is Outcome.FALSE else None

    @property
    def outcome_text(self) -> str:
        """Its outcome, for people; a false evaluation is not hidden by the error of another."""
        is_hidden = self.outcome is Outcome.ERROR and self.failure is not None
        return f'{Outcome.ERROR}, {Outcome.FALSE}' if is_hidden else self.outcome

    def without_verdict(self, error: DyKnowError) -> FormulaReport:
        """Return the report with an error in place of all episodes."""
        return replace(self, episodes=(), error=error, attempts=())

    @property
    def first_error(self) -> DyKnowError | None:
        """The error of its first evaluation with one, or of its first episode with one."""
        reports = [*(each.report for each in self.attempts), self]
        errors = chain.from_iterable((r.error, *(e.error for e in r.episodes)) for r in reports)
        return next(filter(None, errors), None)

    def reasons_of_attempts(self) -> Iterator[str]:
        """Yield how its evaluations have ended, for people: a false one first."""
        failure = self.failure
        if failure is not None:
            at = '' if failure.decided_at is None else f' at {round_time(failure.decided_at)}'
            yield f'false{at}: {failure.explanation}'
        first, *others = [each for each in self.attempts if each.failed_at is not None]
        yield f'error at {round_time(first.failed_at or 0)}: {first.report.reason}'
        if others:
            number = f'{len(others)} more error{"s" * (len(others) > 1)}'
            yield f'{number} until {round_time(others[-1].failed_at or 0)}'
        last = self.attempts[-1]
        if last.failed_at is None:
            is_error = last.report.outcome is Outcome.ERROR
            why = f' ({last.report.reason})' if is_error else ''
            yield f'evaluated again from {round_time(last.begin)} on: {last.report.outcome}{why}'

    @property
    def margin(self) -> Margin | None:
        """The worst margin of its episodes; None if margins were not asked for."""
        found = [each.margin for each in self.episodes if each.margin is not None]
        return min(found, key=lambda margin: (margin.upper, margin.lower), default=None)

    @property
    def presumably_false(self) -> bool:
        """True if one of its episodes is undecided, and false without further states."""
        return any(each.presumably_false for each in self.episodes)


@dataclass(frozen=True, slots=True)
class Attempt:
    """One of several evaluations of a formula, each but the first after an error.

    Args:
        begin: the log time from which on the formula was evaluated, in nanoseconds.
        failed_at: the log time of its error; None if it has none.
        report: its results.
    """

    begin: int
    failed_at: int | None
    report: FormulaReport


def report_of_attempts(attempts: Sequence[Attempt]) -> FormulaReport:
    """Return the results of all evaluations of a formula; there is one at least."""
    reports = [each.report for each in attempts]
    last = reports[-1]
    if len(attempts) == 1:
        return last
    return replace(
        last,
        episodes=tuple(chain.from_iterable(each.episodes for each in reports)),
        states=sum(each.states for each in reports),
        first_state=next((it.first_state for it in reports if it.first_state is not None), None),
        groundings=next((each.groundings for each in reversed(reports) if each.groundings), ()),
        violations=tuple(dict.fromkeys(chain.from_iterable(each.violations for each in reports))),
        gaps=tuple(chain.from_iterable(each.gaps for each in reports)),
        events=tuple(chain.from_iterable(each.events for each in reports)),
        attempts=tuple(attempts),
    )


@dataclass(frozen=True, slots=True)
class RecordingReport:
    """The results of formulas over one recording.

    Args:
        recording: its name.
        start_time: the log time of its first message, in nanoseconds.
        end_time: the log time of its last message.
        formulas: in the order of the requests.
        notes: faults of the recording and of the configuration that are no errors.
        broken: the expectations about topics that the recording breaks.
        topics: the topics that the formulas read.
        map: the map of the regions of the robot, if it was to be kept.
        ends_early: True if a formula has ended with an error after which it can be evaluated again.
    """

    recording: str
    start_time: int
    end_time: int
    formulas: tuple[FormulaReport, ...]
    notes: tuple[str, ...] = ()
    broken: tuple[BrokenExpectation, ...] = ()
    topics: tuple[str, ...] = ()
    map: RecordedMap | None = None
    ends_early: bool = False
