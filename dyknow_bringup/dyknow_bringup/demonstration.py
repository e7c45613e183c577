"""The demonstration: outcomes compared with the expected ones, and plans as tables."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from dyknow_bringup.monitored_formula import FAILED, STYLES, MonitoredFormula
from dyknow_bringup.simulation.scenario import Expectation
from dyknow_common import round_time, with_readable_times
from dyknow_common.tables import Cell, fixed, framed_table, named, wide
from dyknow_coordinator import PlanOutcome, PlanPhase, PlanVerdict

_PLAN: Final = '(the plan)'


def unexpected(
    formulas: Iterable[MonitoredFormula], expected: Mapping[str, Expectation], start: int
) -> dict[str, str]:
    """Return how outcomes differ from the expected ones, by the names of the formulas.

    Args:
        formulas: those that were monitored, with their outcomes.
        expected: of the scenario; it may expect nothing of some formulas.
        start: of the scenario, in nanoseconds.
    """
    monitored = {each.formula.name: each for each in formulas}
    problems = {
        name: _difference(monitored[name], expectation, start)
        if name in monitored
        else f'no such formula instead of {expectation.outcome}'
        for name, expectation in expected.items()
    }
    return {name: problem for name, problem in problems.items() if problem}


def _difference(monitored: MonitoredFormula, expectation: Expectation, start: int) -> str:
    if monitored.outcome != expectation.outcome:
        return f'{monitored.outcome} instead of {expectation.outcome}'
    if expectation.decided_between is None or monitored.known_at is None:
        return ''
    earliest, latest = expectation.decided_between
    elapsed = monitored.known_at - start
    if earliest <= elapsed <= latest:
        return ''
    return (
        f'{monitored.outcome} at {round_time(elapsed)} instead of between '
        f'{round_time(earliest)} and {round_time(latest)}'
    )


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
        verdict: the verdict of the formula.
        start: the start of the scenario, in nanoseconds.
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


def _state(verdict: PlanVerdict) -> Text:
    style = FAILED if verdict.phase is PlanPhase.FAILED else 'dim'
    return Text(verdict.outcome, STYLES.get(verdict.outcome, style))


def _reason(verdict: PlanVerdict) -> str:
    return verdict.explanation if verdict.error is None else verdict.error.message
