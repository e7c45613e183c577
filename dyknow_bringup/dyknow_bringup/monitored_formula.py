"""Formulas that are monitored, with their outcomes so far, and as a table on a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from rich.table import Table
from rich.text import Text

from dyknow_bringup.errors import BringupError
from dyknow_common import (
    ExitCode,
    Margin,
    ProbabilityInterval,
    Verdict,
    clock_time,
    one_line,
    round_time,
    with_readable_times,
)
from dyknow_common.tables import Cell, figure, fixed, framed_table, named, wide
from dyknow_configuration import RequestedFormula
from dyknow_coordinator import (
    EvaluationPhase,
    EvaluationStatus,
    StandingVerdicts,
    as_reported,
)

HOLDS: Final = 'holds'
"""The outcome of a formula that is asked at every state, outside of its episodes."""

VIOLATED: Final = 'violated'
"""Its outcome while an episode lasts."""

NOT_CONNECTED: Final = 'not connected'
"""The outcome of a formula until the coordinator accepts it."""

WAITING: Final = 'waiting'
"""Its outcome while no state comes, or while new objects are left out; not during an episode."""

UNDECIDED: Final = Verdict.UNDECIDED.name.lower()
"""Its outcome from its first state until the answer."""

_OPEN: Final = frozenset({NOT_CONNECTED, WAITING, UNDECIDED})

STYLES: Final = {'true': 'bold green', 'false': 'bold red', HOLDS: 'green', VIOLATED: 'bold red'}
"""The styles of outcomes."""

FAILED: Final = 'bold magenta'
"""The style of an error."""

Identity: TypeAlias = tuple[str, str, bool]
"""The name and the text of a formula, and whether it is asked at every state."""


@dataclass(slots=True)
class MonitoredFormula:
    """A formula and its outcome so far.

    Args:
        outcome: NOT_CONNECTED, WAITING, `undecided`, `true`, `false`, or the name of an exit
            status; also HOLDS or VIOLATED for a formula that is asked at every state.
        known_at: when the outcome was known, in nanoseconds; None while undecided.
        explanation: the reason, for people.
        waits_for: why no state comes, for people; empty while states come.
        presumably_false: True if it is undecided, and would be false if no further state came.
        has_states: True if it ever had a state, or a verdict.
        margin: the latest margin, if it is asked for.
        probability: the probability while it is undecided, if the formula asks for one.
        verdicts: the present evaluation's verdicts, for a formula that is asked at every state.
        has_failed: True if it was false once.
    """

    formula: RequestedFormula
    outcome: str = NOT_CONNECTED
    known_at: int | None = None
    explanation: str = ''
    waits_for: str = ''
    presumably_false: bool = False
    has_states: bool = False
    margin: Margin | None = None
    probability: ProbabilityInterval | None = None
    verdicts: StandingVerdicts = field(default_factory=StandingVerdicts)
    has_failed: bool = False

    @property
    def name(self) -> str:
        """The name of the formula."""
        return self.formula.name or self.formula.text

    @property
    def identity(self) -> Identity:
        """What its evaluations evaluate."""
        text = one_line(self.formula.closed_text)
        return as_reported(self.name), as_reported(text), self.formula.every_state

    @property
    def status(self) -> str:
        """The outcome, as tables show it."""
        holds_so_far = self.outcome == UNDECIDED and not self.presumably_false
        return 'holds so far' if holds_so_far else self.outcome

    @property
    def is_decided(self) -> bool:
        """True if there is a verdict or an error."""
        return self.outcome not in _OPEN


def identity(status: EvaluationStatus) -> Identity:
    """Return what an evaluation evaluates."""
    return status.name, status.formula_text, status.episodes is not None


def is_any_evaluated(
    formulas: Sequence[MonitoredFormula], statuses: Iterable[EvaluationStatus]
) -> bool:
    """Return True if an evaluation belongs to one of some formulas, and was not cancelled.

    A cancelled evaluation had another client, which has ended: no client will evaluate it again.

    Raises:
        BringupError: if one that goes on is of another formula of the same name.
    """
    evaluated = {identity(each): each for each in statuses if not _is_cancelled(each)}
    wanted = {each.identity for each in formulas}
    names = {name for name, _, _ in wanted}
    for other, status in evaluated.items():
        is_running = status.phase is not EvaluationPhase.ENDED
        if is_running and other not in wanted and status.name in names:
            asked = 'at every state' if status.episodes is not None else 'once'
            raise BringupError(
                f"'{status.name}': the system evaluates another formula of this name, "
                f'{status.text} ({asked}); start "dyknow up" anew with this file, or rename one'
            )
    return not evaluated.keys().isdisjoint(wanted)


def _is_cancelled(status: EvaluationStatus) -> bool:
    return status.error is not None and status.error.code is ExitCode.CANCELLED


def formula_table(monitored: Sequence[MonitoredFormula], start: int, elapsed: int) -> Table:
    """Return a table of formulas with their outcomes.

    Args:
        monitored: the formulas.
        start: the start of the monitoring, in nanoseconds.
        elapsed: nanoseconds since then.
    """
    columns = (named('formula'), fixed('verdict'), figure('since'), wide('why'))
    rows = (_formula_row(each, start) for each in monitored)
    title = f'{round_time(elapsed)} since {clock_time(start)}'
    return framed_table(columns, rows, title=title, expand=True)


def _formula_row(monitored: MonitoredFormula, start: int) -> list[Cell]:
    since = '' if monitored.known_at is None else round_time(monitored.known_at - start)
    reason = Text(monitored.waits_for or monitored.formula.description, 'dim')
    style = 'dim'
    if monitored.is_decided:
        # Without the line and the caret of an error, which a column would fold.
        text = with_readable_times(monitored.explanation.partition('\n  ')[0], start)
        reason = Text(text or monitored.formula.description)
        style = STYLES.get(monitored.outcome, FAILED)
    if monitored.margin is not None:
        reason.append(f'{"; " if reason.plain else ""}margin {monitored.margin}', 'dim')
    if (probability := monitored.probability) is not None:
        assumption = f'{probability.assumption}\n' if reason else probability.assumption
        shown = f'P {probability.bar} {probability.bounds}\n'
        reason = Text.assemble(shown, (assumption, 'dim'), reason)
    return [monitored.formula.name, Text(monitored.status, style), since, reason]
