"""How the demonstration looks on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from dyknow_bringup.demonstration.expectations import MonitoredFormula
from dyknow_common import round_time

_STYLES = {'true': 'bold green', 'false': 'bold red', 'undecided': 'dim'}
_FAILED = 'bold magenta'


def formula_table(monitored: Sequence[MonitoredFormula], start: int, elapsed: int) -> Table:
    """Formula, verdict, since when and why.

    Args:
        monitored: a row for each.
        start: of the scenario, in nanoseconds.
        elapsed: nanoseconds since then.
    """
    table = Table(title=f'{round_time(elapsed)}', expand=True)
    table.add_column('formula', no_wrap=True)
    table.add_column('verdict', no_wrap=True)
    table.add_column('since', justify='right', no_wrap=True)
    table.add_column('why', ratio=1)
    for row in monitored:
        table.add_row(row.formula.name, _verdict(row), _since(row, start), _why(row))
    return table


def summary(scenario: str, problems: Mapping[str, str]) -> Panel:
    """Whether all went as the scenario says.

    Args:
        scenario: its name.
        problems: what is wrong, by the name of the formula.
    """
    if not problems:
        text = Text('every verdict is what the scenario says', 'green')
    else:
        lines = [f'{name}: {problem}' for name, problem in problems.items()]
        text = Text('\n'.join(lines), 'red')
    return Panel(text, title=scenario)


def _verdict(row: MonitoredFormula) -> Text:
    return Text(row.outcome, _STYLES.get(row.outcome, _FAILED))


def _since(row: MonitoredFormula, start: int) -> str:
    return '' if row.known_at is None else round_time(row.known_at - start)


def _why(row: MonitoredFormula) -> Text:
    if row.is_decided:
        return Text(row.explanation)
    return Text(row.formula.description, 'dim')
