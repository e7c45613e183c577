"""Status and diagnosis of an evaluation, for operators."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from dyknow_common import (
    BlackBoxOptions,
    DyKnowError,
    ExitCode,
    Margin,
    ProbabilityInterval,
    StandingVerdicts,
    Verdict,
    date_time,
    round_duration,
    time_since,
    with_readable_times,
)
from dyknow_coordinator.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.feature_sources import SymbolGrounding

_MAX_TEXT: Final = 10_000
"""The most characters of a text in a status: reports are sent each second."""


def as_reported(text: str) -> str:
    """Return a text for reports: of a long text, only the begin."""
    return text if len(text) <= _MAX_TEXT else f'{text[:_MAX_TEXT]}...'


@dataclass(frozen=True, slots=True)
class EvaluationStatus:
    """Status of an evaluation that runs or ended recently.

    Fields as in the EvaluationStatus message. Times are in nanoseconds; None if unknown.
    """

    name: str
    formula: str
    phase: EvaluationPhase
    started: int
    plan: str = ''
    action: str = ''
    formula_group_id: int = 0
    state_stream: str = ''
    groundings: tuple[SymbolGrounding, ...] = ()
    topics: tuple[str, ...] = ()
    record: BlackBoxOptions | None = None
    events: tuple[str, ...] = ()
    states_progressed: int = 0
    latest_valid_time: int | None = None
    residual_formula: str = ''
    presumably_false: bool = False
    episodes: StandingVerdicts | None = None
    waits_for: str = ''
    margin: Margin | None = None
    probability: ProbabilityInterval | None = None
    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    explanation: str = ''
    error: DyKnowError | None = None
    formula_text: str = ''

    @property
    def text(self) -> str:
        """The formula for people."""
        return self.formula_text or self.formula


class Level(IntEnum):
    """Severity; numbers as in diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Severity of the status of an evaluation, with the reason in one line."""

    level: Level
    text: str


def diagnose(status: EvaluationStatus, now: int, silence_limit: int) -> Diagnosis:
    """Return the diagnosis of an evaluation.

    - ERROR: the formula is false, or cannot be evaluated; or it is asked at every state, and has
      been false since the latest episode began, also if no more states come.
    - WARN: the formula may become false or may never be decided: it is presumably false,
      interrupted, waiting, or without streams or states yet or for too long; or its timeout has
      passed.
    - OK: otherwise, also after a cancellation, which the client requested.

    Args:
        status: the status of the evaluation.
        now: the time, nanoseconds.
        silence_limit: the longest time between two states, nanoseconds.
    """
    latest = status.started if status.latest_valid_time is None else status.latest_valid_time
    waited, silence = now - status.started, now - latest
    if is_violated(status):
        return _diagnosis_of_violated(status)
    level = Level.WARN
    match status.phase:
        case EvaluationPhase.ENDED:
            return diagnosis_of_ended(status)
        case EvaluationPhase.INTERRUPTED:
            reason = status.events[-1] if status.events else 'other streams are being found'
            text = f'interrupted: {reason}'
        case EvaluationPhase.WAITING:
            text = f'waiting for states: {status.waits_for}'
        case EvaluationPhase.GROUNDING:
            within = f'have not been found within {round_duration(waited)}'
            text = f'its streams {within if waited > silence_limit else "are being found"}'
        case EvaluationPhase.RUNNING if silence > silence_limit:
            text = f'no state has come for {round_duration(silence)}'
        case EvaluationPhase.RUNNING if status.latest_valid_time is None:
            text = 'no state has come yet'
        case EvaluationPhase.RUNNING if status.presumably_false and status.episodes is None:
            text = 'presumably false: only a later state can make it true'
        case EvaluationPhase.RUNNING:
            level, text = Level.OK, 'undecided' if status.episodes is None else status.episodes.text
    return Diagnosis(level, text)


def is_violated(status: EvaluationStatus) -> bool:
    """Return True if a formula is asked at every state, and the latest episode has not ended."""
    return (
        status.phase is not EvaluationPhase.ENDED
        and status.episodes is not None
        and status.episodes.is_violated
    )


def _diagnosis_of_violated(status: EvaluationStatus) -> Diagnosis:
    latest = status.episodes.latest_episodes[-1:] if status.episodes is not None else ()
    reasons = ['violated', *(each.text for each in latest)]
    waits = f'; {status.waits_for}' if status.waits_for else ''
    return Diagnosis(Level.ERROR, f'{": ".join(reasons)}{waits}')


def outcome(status: EvaluationStatus) -> str:
    """Return the status in one or two words: `running`, `presumably false`, `true`, `timeout`."""
    if status.error is not None:
        return status.error.code.name.lower().replace('_', ' ')
    if status.phase is EvaluationPhase.ENDED:
        return status.verdict.name.lower()
    if is_violated(status):
        return 'violated'
    if status.phase is EvaluationPhase.RUNNING and status.episodes is not None:
        return 'running'
    if status.phase is EvaluationPhase.RUNNING and status.presumably_false:
        return 'presumably false'
    return status.phase.name.lower()


def details(status: EvaluationStatus) -> Iterator[tuple[str, str]]:
    """Yield names and texts of all that is known about an evaluation, without empty texts."""
    decided, latest = status.decided_at, status.latest_valid_time
    known = (
        ('formula', status.text),
        ('phase', status.phase.name.lower()),
        ('verdict', status.verdict.name.lower()),
        ('decided at', '' if decided is None else time_since(decided, status.started)),
        ('every state', '' if status.episodes is None else status.episodes.text),
        ('waits for', status.waits_for),
        ('margin', '' if status.margin is None else str(status.margin)),
        ('probability', '' if status.probability is None else str(status.probability)),
        ('explanation', status.explanation),
        ('error', '' if status.error is None else status.error.message),
        ('plan', status.plan),
        ('action', status.action),
        ('started', date_time(status.started)),
        ('states', str(status.states_progressed)),
        ('latest valid time', '' if latest is None else time_since(latest, status.started)),
        ('residual formula', status.residual_formula),
        ('state stream', status.state_stream),
        ('streams', '\n'.join(f'{each.symbol}: {each.stream}' for each in status.groundings)),
        (
            'stand-ins',
            '\n'.join(
                f'{each.symbol}: {stand_in}'
                for each in status.groundings
                for stand_in in each.stand_ins
            ),
        ),
        ('events', '\n'.join(status.events)),
    )
    return ((name, with_readable_times(text, status.started)) for name, text in known if text)


def alarm_level(status: EvaluationStatus, *, is_monitored: bool) -> Level:
    """Return the severity of the end of an evaluation in the log; OK: it is not logged.

    Args:
        status: the status of the evaluation, which has ended.
        is_monitored: True if the formula should hold: then false is an alarm, not an answer.
    """
    code = None if status.error is None else status.error.code
    if code in _FAULTS:
        return Level.ERROR
    is_wrong = status.verdict is Verdict.FALSE or code in _WRONG_REQUESTS
    return Level.WARN if is_monitored and is_wrong else Level.OK


_FAULTS = {ExitCode.CONSTRAINT_VIOLATION, ExitCode.UNAVAILABLE, ExitCode.INTERNAL_ERROR}
"""The ends for which a stream or a node is at fault."""

_WRONG_REQUESTS = {ExitCode.INVALID_ARGUMENT, ExitCode.NOT_FOUND}

_LEVELS = {ExitCode.CANCELLED: Level.OK, ExitCode.TIMEOUT: Level.WARN}
"""Severity of the ends without a verdict that are no fault of a node or a stream."""


def diagnosis_of_ended(status: EvaluationStatus) -> Diagnosis:
    """Return the diagnosis of an evaluation that has ended."""
    if status.error is not None:
        text = f'{outcome(status)}: {status.error.message}'
        return Diagnosis(_LEVELS.get(status.error.code, Level.ERROR), text)
    level = Level.ERROR if status.verdict is Verdict.FALSE else Level.OK
    reason = f': {status.explanation}' if status.explanation else ''
    return Diagnosis(level, f'{outcome(status)}{reason}')
