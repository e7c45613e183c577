"""How the monitoring of a plan looks on a terminal."""

from __future__ import annotations

from rich.table import Table
from rich.text import Text

from dyknow_common import Verdict, round_time
from dyknow_coordinator import PlanOutcome, PlanPhase, PlanVerdict

_PLAN = '(the plan)'
_STYLES = {'true': 'bold green', 'false': 'bold red', 'failed': 'bold magenta'}


def verdict_line(verdict: PlanVerdict, start: int) -> Text:
    """What is new of a formula, in a line.

    Args:
        verdict: the news.
        start: of the plan, in nanoseconds.
    """
    text = Text(f'  {verdict.place.action or _PLAN}: {verdict.place.formula} is ')
    text.append(_state(verdict))
    text.append(f'{_since(verdict, start)} {_why(verdict)}'.rstrip())
    return text


def plan_table(outcome: PlanOutcome) -> Table:
    """All formulas with the actions that they belong to, and what became of them."""
    table = Table(expand=True)
    for name in ('action', 'formula', 'verdict'):
        table.add_column(name, no_wrap=True)
    table.add_column('why', ratio=1)
    for verdict in outcome.verdicts:
        action = verdict.place.action or _PLAN
        row = (action, verdict.place.formula, _state(verdict), Text(_why(verdict)))
        table.add_row(*row)
    return table


def _state(verdict: PlanVerdict) -> Text:
    if verdict.verdict is not Verdict.UNDECIDED:
        name = verdict.verdict.name.lower()
    else:
        name = verdict.phase.name.lower()
    return Text(name, _STYLES.get(name, 'dim'))


def _since(verdict: PlanVerdict, start: int) -> str:
    return '' if verdict.decided_at is None else f' at {round_time(verdict.decided_at - start)}'


def _why(verdict: PlanVerdict) -> str:
    if verdict.error is not None:
        return verdict.error.message
    if verdict.phase is PlanPhase.WITHDRAWN and verdict.presumably_false:
        return 'it would have been false then'
    return verdict.explanation
