"""Formulas and plans of the demonstration on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from dyknow_bringup.demonstration.expectations import HOLDS, VIOLATED, MonitoredFormula
from dyknow_common import round_time, with_readable_times
from dyknow_common.tables import Cell, figure, fixed, framed_table, named, wide
from dyknow_coordinator import PlanOutcome, PlanPhase, PlanVerdict

_PLAN = '(the plan)'
_STYLES = {'true': 'bold green', 'false': 'bold red', HOLDS: 'green', VIOLATED: 'bold red'}
_FAILED = 'bold magenta'


def formula_table(monitored: Sequence[MonitoredFormula], start: int, elapsed: int) -> Table:
    """Return a table of formulas with their outcomes.

    Args:
        monitored: the formulas.
        start: of the scenario, in nanoseconds.
        elapsed: nanoseconds since then.
    """
    columns = (named('formula'), fixed('verdict'), figure('since'), wide('why'))
    rows = (_formula_row(each, start) for each in monitored)
    return framed_table(columns, rows, title=round_time(elapsed), expand=True)


def summary(scenario: str, problems: Mapping[str, str]) -> Panel:
    """Return a panel that says if all outcomes were as expected.

    Args:
        scenario: its name.
        problems: the unexpected outcomes, by the names of the formulas.
    """
    if not problems:
        text = Text('every verdict is what the scenario says', 'green')
    else:
        lines = [f'{name}: {problem}' for name, problem in problems.items()]
        text = Text('\n'.join(lines), 'red')
    return Panel(text, title=scenario)


def verdict_line(verdict: PlanVerdict, start: int) -> Text:
    """Return a line about a formula of a plan.

    Args:
        verdict: of the formula.
        start: of the scenario, in nanoseconds.
    """
    since = '' if verdict.decided_at is None else f' at {round_time(verdict.decided_at - start)}'
    text = Text(f'  {verdict.position.action or _PLAN}: {verdict.position.formula} is ')
    text.append(_state(verdict))
    text.append(f'{since} {with_readable_times(_reason(verdict), start)}'.rstrip())
    return text


def plan_table(outcome: PlanOutcome) -> Table:
    """Return a table of the formulas of a plan with their outcomes."""
    columns = (named('action'), named('formula'), fixed('verdict'), wide('why'))
    rows: list[list[Cell]] = [
        [each.position.action or _PLAN, each.position.formula, _state(each), _reason(each)]
        for each in outcome.verdicts
    ]
    return framed_table(columns, rows, expand=True)


def _formula_row(monitored: MonitoredFormula, start: int) -> list[Cell]:
    since = '' if monitored.known_at is None else round_time(monitored.known_at - start)
    reason = Text(monitored.waits_for or monitored.formula.description, 'dim')
    style = 'dim'
    if monitored.is_decided:
        text = with_readable_times(monitored.explanation, start)
        reason = Text(text or monitored.formula.description)
        style = _STYLES.get(monitored.outcome, _FAILED)
    if monitored.margin is not None:
        reason.append(f'{"; " if reason.plain else ""}margin {monitored.margin}', 'dim')
    return [monitored.formula.name, Text(monitored.status, style), since, reason]


def _state(verdict: PlanVerdict) -> Text:
    style = _FAILED if verdict.phase is PlanPhase.FAILED else 'dim'
    return Text(verdict.outcome, _STYLES.get(verdict.outcome, style))


def _reason(verdict: PlanVerdict) -> str:
    return verdict.explanation if verdict.error is None else verdict.error.message
