"""An evaluation: its request, its life cycle (only the first end counts) and its answer."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Self

from dyknow_common import (
    NO_CONSTRAINTS,
    BlackBoxOptions,
    DyKnowError,
    ExitCode,
    Margin,
    ProbabilityInterval,
    StreamConstraints,
    Verdict,
    round_time,
    without_generated_text,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.feature_sources import Grounding, SymbolGrounding


@dataclass(frozen=True, slots=True)
class ViolationEpisode:
    """Consecutive start states: a formula is false from each of them.

    Args:
        begin: valid time of the first of these states, in nanoseconds.
        end: valid time of the last one so far.
        decided_at: valid time of the state that decided the formula of the first one.
        states: how many there are.
        has_ended: True if the formula holds again after the last one.
        explanation: the reason for the verdict on the first one, for people.
        worst: the least margin from one of these states; None if margins were not asked for.
    """

    begin: int
    end: int
    decided_at: int
    states: int
    has_ended: bool
    explanation: str
    worst: Margin | None = None

    @property
    def text(self) -> str:
        """The reason and the worst margin, for people."""
        return f'{self.explanation}{f"; at worst {self.worst}" if self.worst else ""}'

    @property
    def past_text(self) -> str:
        """The times of an episode that has ended, and its reason, for people."""
        begin, end = round_time(self.begin), round_time(self.end)
        return f'it was violated from {begin} to {end}: {self.text}'


@dataclass(frozen=True, slots=True)
class StandingVerdicts:
    """Verdicts on a formula that is asked at every state.

    Args:
        holds: the number of states from which it is true.
        fails: from which it is false.
        undecided: from which it is undecided yet.
        unknown: from which no state decides it any more: states are missing, or values are unknown.
        is_violated: True if an episode has not ended.
        episode_count: the number of episodes.
        latest_episodes: the last ten, the latest last.
    """

    holds: int = 0
    fails: int = 0
    undecided: int = 0
    unknown: int = 0
    is_violated: bool = False
    episode_count: int = 0
    latest_episodes: tuple[ViolationEpisode, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """FALSE if it is false from a state, TRUE if it is true from all states."""
        if self.fails:
            return Verdict.FALSE
        is_known = self.holds and not (self.undecided or self.unknown)
        return Verdict.TRUE if is_known else Verdict.UNDECIDED

    @property
    def text(self) -> str:
        """The verdicts in one line, for people."""
        states = self.holds + self.fails + self.undecided + self.unknown
        episodes = f' in {_plural(self.episode_count, "episode")}'
        others = (
            f', fails from {self.fails}{episodes}' if self.fails else '',
            f', undecided from {self.undecided}' if self.undecided else '',
            f', unknown from {self.unknown}' if self.unknown else '',
        )
        return f'holds from {self.holds} of {_plural(states, "state")}{"".join(others)}'

    def change(self, before: StandingVerdicts) -> str:
        """Return what has happened since earlier verdicts, for people; empty if nothing has."""
        more = self.episode_count - before.episode_count
        latest = self.latest_episodes[-1] if self.latest_episodes else None
        if latest is None or (more <= 0 and self.is_violated == before.is_violated):
            return ''
        others = f' ({more} episodes since the last report)' if more > 1 else ''
        if self.is_violated:
            return f'violated from {round_time(latest.begin)} on{others}: {latest.text}'
        since = f'{round_time(latest.begin)} to {round_time(latest.end)}'
        return f'holds again, after it was false from {since}{others}: {latest.text}'

    def changes(self, before: StandingVerdicts) -> Iterator[tuple[ViolationEpisode, bool]]:
        """Yield the episodes that have begun or ended since earlier verdicts, in their order.

        An episode comes with False for its begin, and with True for its end. Of more than ten
        episodes since then, the last ten are known.
        """
        # A formula that restarts with other objects counts its episodes from 0.
        known = before.episode_count if before.episode_count <= self.episode_count else 0
        first = self.episode_count - len(self.latest_episodes) + 1
        for number, each in enumerate(self.latest_episodes, start=first):
            if number > known:
                yield each, False
            if each.has_ended and (number > known or (number == known and before.is_violated)):
                yield each, True


def _plural(count: int, noun: str) -> str:
    return f'{count} {noun}' if count == 1 else f'{count} {noun}s'


FOLLOWED: Final = 'followed'
"""The last part of the name of the logger of formulas whose clients report their outcomes."""


@dataclass(frozen=True, slots=True)
class EvaluationRequest:
    """Request to evaluate a formula from now on.

    Args:
        grounding: how its symbols find their streams.
        constraints: of the state stream.
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
    delay_s: float = 0.0


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
        margin: if it was asked for: the latest.
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


@dataclass(frozen=True, slots=True)
class Progress:
    """Report on an evaluation in progress.

    Args:
        states_progressed: number of states so far.
        latest_valid_time: of the last state, in nanoseconds; 0 before the first.
        residual_formula: the formula that the remaining states must satisfy.
        presumably_false: True if the formula would be false without further states.
        streams: the specifications of the streams in use.
        events: what has happened since the last report.
        waits_for: why no state has come for 3 s; empty while states come.
        margin: if it was asked for.
        probability: of the latest state, if the formula asks for one.
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
