"""An evaluation: its request, its life cycle (only the first end counts) and its answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Final, Self

from dyknow_common import (
    NO_CONSTRAINTS,
    BlackBoxOptions,
    DyKnowError,
    ExitCode,
    Margin,
    ProbabilityInterval,
    StandingVerdicts,
    StreamConstraints,
    Verdict,
    without_generated_text,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import Grounding, SymbolGrounding

FOLLOWED: Final = 'followed'
"""The last part of the name of the logger of formulas whose clients report their outcomes."""


@dataclass(frozen=True, slots=True)
class EvaluationRequest:
    """Request to evaluate a formula from now on.

    Args:
        grounding: how its symbols find their streams.
        constraints: the constraints of the state stream.
        timeout_s: limit in seconds of the wall clock; None for no limit.
        name: the name that operators see; empty for the formula itself.
        plan: name of the plan that the formula belongs to, if any.
        action: name of the action of that plan.
        is_monitored: True if the formula should hold: then false is an alarm, not an answer.
        is_followed: True if its client receives feedback, and reports what becomes of it.
        restart_on_change: restart when a sort in the formula gains or loses objects.
        margin: compute the margin.
        every_state: ask it at every state, until the timeout or a cancellation.
        record: the black box that is recorded when it fails; None for none.
        since: the valid time in nanoseconds from which on states count; 0 for all.
        delay_s: the part of the timeout that had passed when the request was received, as the
            process was stopped.
    """

    formula: str
    grounding: Grounding = Grounding.AUTO
    constraints: StreamConstraints = NO_CONSTRAINTS
    timeout_s: float | None = None
    name: str = ''
    plan: str = ''
    action: str = ''
    is_monitored: bool = False
    is_followed: bool = False
    restart_on_change: bool = False
    margin: bool = False
    every_state: bool = False
    record: BlackBoxOptions | None = None
    since: int = 0
    delay_s: float = 0.0

    def repeats(self, other: EvaluationRequest) -> bool:
        """Return True if both requests are the same, whenever they begin and end."""
        times = {each: getattr(self, each) for each in ('timeout_s', 'since', 'delay_s')}
        return self == replace(other, **times)


@dataclass(frozen=True, slots=True)
class Answer:
    """Outcome of the evaluation of a formula.

    Args:
        verdict: UNDECIDED if there is an error; but FALSE for a formula that is asked at every
            state and was false from one.
        decided_at: valid time of the deciding state in nanoseconds; None without a verdict, or
            if the verdict needs no state.
        canonical_formula: fully bracketed; empty if the formula could not be parsed.
        explanation: the reason for the verdict, for people.
        groundings: the streams used.
        margin: the latest margin, if it was asked for.
        error: why there is no verdict, with the `code` of the exit status.
        episodes: for a formula that is asked at every state.
    """

    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    canonical_formula: str = ''
    explanation: str = ''
    groundings: tuple[SymbolGrounding, ...] = ()
    margin: Margin | None = None
    error: DyKnowError | None = None
    episodes: StandingVerdicts | None = None

    def check(self) -> Self:
        """Return this answer if it has a verdict.

        Raises:
            DyKnowError: why there is no verdict.
        """
        if self.error is not None:
            raise self.error
        return self


def is_superseded(former: Answer | None, later: Answer | None) -> bool:
    """Return True if the end of an evaluation is no longer reported, as its request was repeated.

    An error is superseded by the begin of the next evaluation, a verdict by the next verdict. So
    retries do not accumulate, and a verdict stays until there is another one.

    Args:
        former: its answer; None while it runs.
        later: the answer of an evaluation that has just ended; None if it has just begun.
    """
    if former is None:
        return False
    return former.error is not None or (later is not None and later.error is None)


@dataclass(frozen=True, slots=True)
class Progress:
    """Report on an evaluation in progress.

    Args:
        states_progressed: number of states so far.
        latest_valid_time: the valid time of the last state, in nanoseconds; 0 before the first.
        residual_formula: the formula that the remaining states must satisfy.
        presumably_false: True if the formula would be false without further states.
        streams: the specifications of the streams in use.
        events: what has happened since the last report.
        waits_for: why no state has come for 3 s, or why new objects are left out; else empty.
        margin: the margin, if it was asked for.
        probability: the probability of the latest state, if the formula asks for one.
        episodes: for a formula that is asked at every state.
    """

    states_progressed: int = 0
    latest_valid_time: int = 0
    residual_formula: str = ''
    presumably_false: bool = False
    streams: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    waits_for: str = ''
    margin: Margin | None = None
    probability: ProbabilityInterval | None = None
    episodes: StandingVerdicts | None = None

    def of_remainder(self) -> Progress:
        """Convert the progress of the rest that peers leave of a formula to the whole formula's.

        The rest is presumably false before peers report on their parts, whatever these are.
        """
        has_begun = self.states_progressed > 0
        return replace(self, presumably_false=has_begun and self.presumably_false)

    def with_episodes(self, episodes: StandingVerdicts | None) -> Progress:
        """Return the progress with the verdicts at every state; None: the formula is asked once.

        The engine reports on both in two messages. Without verdicts, no state is known yet; with
        verdicts, their states have been progressed, even if the report on the progress is older.
        """
        if episodes is None:
            return replace(self, episodes=None)
        if not episodes.states:
            return Progress(episodes=episodes)
        states = max(self.states_progressed, episodes.states)
        return replace(self, states_progressed=states, episodes=episodes)


MAX_EVENTS: Final = 20


class EvaluationPhase(IntEnum):
    """Phase of an evaluation; numbers as in EvaluationStatus."""

    GROUNDING = 0
    RUNNING = 1
    INTERRUPTED = 2
    ENDED = 3
    WAITING = 4


_ACTIVITIES = {
    EvaluationPhase.GROUNDING: 'being grounded',
    EvaluationPhase.RUNNING: 'being evaluated',
    EvaluationPhase.INTERRUPTED: 'waiting for other streams',
    EvaluationPhase.ENDED: 'no longer evaluated',
    EvaluationPhase.WAITING: 'waiting for states',
}


class Evaluation:
    """Evaluation of one formula, from its start to its answer.

    Args:
        on_end: called once, with the answer (without formula and groundings).
    """

    def __init__(self, on_end: Callable[[Answer], None]) -> None:
        self.phase = EvaluationPhase.GROUNDING
        self._on_end = on_end

    @property
    def has_ended(self) -> bool:
        """True if the answer is known."""
        return self.phase is EvaluationPhase.ENDED

    def set_phase(self, phase: EvaluationPhase) -> None:
        """Set the phase, unless the evaluation has ended."""
        if not self.has_ended:
            self.phase = phase

    def decide(self, verdict: Verdict, decided_at: int | None, explanation: str) -> None:
        """End with a verdict; `decided_at` is a valid time in ns, or None if it needs no state."""
        self._end(Answer(verdict, decided_at, explanation=explanation))

    def fail(self, error: DyKnowError) -> None:
        """End with an error."""
        plain = without_generated_text(error.message)
        if plain != error.message:
            error = CoordinationError(plain, error.code)
        self._end(Answer(error=error))

    def fail_unavailable(self, what: str) -> None:
        """End because something that the evaluation needs has died: `node x`."""
        text = f'{what} is gone; the formula was {_ACTIVITIES[self.phase]}'
        self.fail(CoordinationError(text, ExitCode.UNAVAILABLE))

    def expire(self, timeout_s: float) -> None:
        """End because the timeout of the client has passed."""
        reason = self.missing_states() or f'the formula was {_ACTIVITIES[self.phase]}'
        text = f'no verdict within {timeout_s:g} s ({reason})'
        self.fail(CoordinationError(text, ExitCode.TIMEOUT))

    def cancel(self, reason: str = 'cancelled by the caller') -> None:
        """End because the client needs no answer any more."""
        self.fail(CoordinationError(reason, ExitCode.CANCELLED))

    def missing_states(self) -> str:
        """Return that no state comes, and why; empty if states come or that is unknown."""
        return ''

    def _end(self, answer: Answer) -> None:
        if not self.has_ended:
            self.phase = EvaluationPhase.ENDED
            self._on_end(answer)


class History:
    """The latest MAX_EVENTS events."""

    def __init__(self) -> None:
        self._events: deque[str] = deque(maxlen=MAX_EVENTS)
        self._unread = 0

    @property
    def latest(self) -> tuple[str, ...]:
        """The latest events, the oldest first."""
        return tuple(self._events)

    def add(self, event: str) -> None:
        """Add an event."""
        self._events.append(event)
        self._unread = min(self._unread + 1, MAX_EVENTS)

    def read(self) -> tuple[str, ...]:
        """Return the events since the last call."""
        unread, self._unread = self._unread, 0
        return self.latest[len(self._events) - unread :]
