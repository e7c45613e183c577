"""What an operator sees of an evaluation, and whether it is a reason to worry."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum

from dyknow_common import DyKnowError, ExitCode, Verdict, round_duration, round_time
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.ground import SymbolGrounding


@dataclass(frozen=True, slots=True)
class EvaluationStatus:
    """A formula that is evaluated, or was a little while ago; times are in nanoseconds.

    Args:
        name: what the caller calls it.
        formula: its canonical text; as it was asked for, until that is known.
        started: when it was asked for.
        plan: the plan that it belongs to; empty where there is none.
        action: the action of the plan that it belongs to.
        formula_group_id: of its formula group at the reasoning engine.
        state_stream: the topic of its states.
        groundings: of its ground features.
        events: what has happened to it, the latest last.
        states_progressed: how many states it was progressed over.
        latest_valid_time: of the state progressed last; None before the first.
        residual_formula: what the rest of the states must satisfy.
        presumably_false: it would be false if no further state came.
        decided_at: valid time of the deciding state; None without a verdict.
        error: why there is no verdict.
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
    events: tuple[str, ...] = ()
    states_progressed: int = 0
    latest_valid_time: int | None = None
    residual_formula: str = ''
    presumably_false: bool = False
    verdict: Verdict = Verdict.UNDECIDED
    decided_at: int | None = None
    explanation: str = ''
    error: DyKnowError | None = None


class Level(IntEnum):
    """How bad something is; the numbers are those of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """Whether an evaluation is a reason to worry, and why, in a line."""

    level: Level
    text: str


def diagnose(status: EvaluationStatus, now: int, silence_limit: int) -> Diagnosis:
    """How an evaluation is.

    - ERROR: the formula is false, or something failed and it cannot be evaluated.
    - WARN: it may become false or may never be decided: it is presumably false, interrupted, or
      without a new state or without streams for too long; or the caller's time ran out first.
    - OK: all else, also what the caller has cancelled, who knows why.

    Args:
        status: of the evaluation.
        now: the time, nanoseconds.
        silence_limit: how long it may take until the next state comes, nanoseconds.
    """
    match status.phase:
        case EvaluationPhase.ENDED:
            return _diagnosis_of_ended(status)
        case EvaluationPhase.INTERRUPTED:
            why = status.events[-1] if status.events else 'other streams are being found'
            return Diagnosis(Level.WARN, f'interrupted: {why}')
        case EvaluationPhase.GROUNDING:
            return _diagnosis_of_waiting(status, now, silence_limit)
        case EvaluationPhase.RUNNING:
            return _diagnosis_of_running(status, now, silence_limit)


def outcome(status: EvaluationStatus) -> str:
    """What is known, in a word or two: `running`, `presumably false`, `true`, `timeout`."""
    if status.error is not None:
        return status.error.code.name.lower().replace('_', ' ')
    if status.phase is EvaluationPhase.ENDED:
        return status.verdict.name.lower()
    if status.phase is EvaluationPhase.RUNNING and status.presumably_false:
        return 'presumably false'
    return status.phase.name.lower()


def details(status: EvaluationStatus) -> Iterator[tuple[str, str]]:
    """All that is known of an evaluation, as pairs of what it is and a text; nothing is empty."""
    decided, latest = status.decided_at, status.latest_valid_time
    known = (
        ('formula', status.formula),
        ('phase', status.phase.name.lower()),
        ('verdict', status.verdict.name.lower()),
        ('decided at', '' if decided is None else round_time(decided)),
        ('explanation', status.explanation),
        ('error', '' if status.error is None else status.error.message),
        ('plan', status.plan),
        ('action', status.action),
        ('started', round_time(status.started)),
        ('states', str(status.states_progressed)),
        ('latest valid time', '' if latest is None else round_time(latest)),
        ('residual formula', status.residual_formula),
        ('state stream', status.state_stream),
        ('streams', '\n'.join(f'{each.symbol}: {each.stream}' for each in status.groundings)),
        ('stand-ins', '\n'.join(_stand_ins(status))),
        ('events', '\n'.join(status.events)),
    )
    return ((what, text) for what, text in known if text)


def _stand_ins(status: EvaluationStatus) -> Iterator[str]:
    for each in status.groundings:
        yield from (f'{each.symbol}: {stand_in}' for stand_in in each.stand_ins)


def _diagnosis_of_ended(status: EvaluationStatus) -> Diagnosis:
    if status.error is not None:
        text = f'{outcome(status)}: {status.error.message}'
        return Diagnosis(_LEVELS.get(status.error.code, Level.ERROR), text)
    level = Level.ERROR if status.verdict is Verdict.FALSE else Level.OK
    why = f': {status.explanation}' if status.explanation else ''
    return Diagnosis(level, f'{outcome(status)}{why}')


_LEVELS = {ExitCode.CANCELLED: Level.OK, ExitCode.TIMEOUT: Level.WARN}
"""What is no fault of anything, among the ends without a verdict."""


def _diagnosis_of_waiting(status: EvaluationStatus, now: int, silence_limit: int) -> Diagnosis:
    waited = now - status.started
    if waited > silence_limit:
        text = f'its streams have not been found within {round_duration(waited)}'
        return Diagnosis(Level.WARN, text)
    return Diagnosis(Level.OK, 'its streams are being found')


def _diagnosis_of_running(status: EvaluationStatus, now: int, silence_limit: int) -> Diagnosis:
    latest = status.latest_valid_time
    silence = now - (status.started if latest is None else latest)
    if silence > silence_limit:
        return Diagnosis(Level.WARN, f'no state has come for {round_duration(silence)}')
    if status.presumably_false:
        text = 'presumably false: it is, unless a later state makes it true'
        return Diagnosis(Level.WARN, text)
    return Diagnosis(Level.OK, 'undecided')
