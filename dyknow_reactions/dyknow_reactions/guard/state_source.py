"""The evaluation of the coordinator whose states a guard reads.

Two evaluations may have the name of a formula of a guard: its own evaluation, and for a while the
evaluation of a killed process of the guard. The states of both are equally good, as long as the
coordinator vouches for them:

    time     `~/evaluations`                                the guard reads
    0.0 s    1: RUNNING with states_1                       states_1, of a former process
    0.3 s    1: RUNNING with states_1, 2: GROUNDING         states_1
    0.4 s    1: ENDED, constraint violation; 2: GROUNDING   nothing: closed
    0.6 s    1: ENDED, 2: RUNNING with states_2             states_2

An evaluation that begins again with other objects does so in another group of the reasoning engine:
the states of the former group are about the former objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from dyknow_coordinator import EvaluationPhase, EvaluationStatus

_PHASES: Final = (EvaluationPhase.RUNNING, EvaluationPhase.WAITING)


class StateSource(NamedTuple):
    """An evaluation of the coordinator, with the stream of its states.

    Args:
        started: when the evaluation was requested, in nanoseconds of the coordinator's clock.
        group: the group of the reasoning engine.
        stream: the topic of the states.
        formula: its canonical text.
    """

    started: int
    group: int
    stream: str
    formula: str

    def is_same_group(self, other: StateSource) -> bool:
        """Return True if the states of another source are of the same evaluation and objects."""
        return (self.started, self.group) == (other.started, other.group)


def latest_source(evaluations: Iterable[EvaluationStatus]) -> StateSource | None:
    """Return the source of the latest evaluation that has states; None if none has."""
    return max(
        (
            StateSource(each.started, each.formula_group_id, each.state_stream, each.formula)
            for each in evaluations
            if each.phase in _PHASES and each.state_stream
        ),
        default=None,
    )


def why_unusable(source: StateSource, evaluations: Sequence[EvaluationStatus]) -> str:
    """Return why the states of a source must not be used any more; empty if they may be.

    The violation of a stream is a message on a topic of its own, which goes with the stream: a
    guard that was stopped may never receive it. The coordinator's report does not get lost.

    Args:
        source: whose states are used.
        evaluations: all that the coordinator reports of the formula.
    """
    own = [each for each in evaluations if each.started == source.started]
    # Simulated time may stand still, so several evaluations may have begun at one time.
    status = min(own, key=lambda each: each.formula_group_id != source.group, default=None)
    if status is None:
        return 'the coordinator evaluates it no more'
    if status.phase is EvaluationPhase.INTERRUPTED:
        return 'its streams have failed, and the coordinator looks for others'
    if status.phase is EvaluationPhase.ENDED:
        reason = status.explanation if status.error is None else status.error.message
        return f'its evaluation has ended: {reason}'
    return '' if status.formula_group_id == source.group else 'its objects have changed'
