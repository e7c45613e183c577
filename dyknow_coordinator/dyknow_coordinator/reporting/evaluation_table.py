"""How evaluations look on a terminal and as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from dyknow_common import ExitCode, Verdict, round_duration
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus, details, outcome

_VERDICTS = {Verdict.TRUE: 'green', Verdict.FALSE: 'bold red', Verdict.UNDECIDED: 'dim'}


def evaluation_table(statuses: Iterable[EvaluationStatus], now: int) -> Table:
    """A line for each evaluation.

    Args:
        statuses: of the evaluations.
        now: the time, nanoseconds.
    """
    table = Table(box=None, pad_edge=False)
    table.add_column('evaluation', overflow='fold')
    table.add_column('state', no_wrap=True)
    for header in ('states', 'streams', 'since'):
        table.add_column(header, justify='right', no_wrap=True)
    table.add_column('formula', overflow='fold')
    table.add_column('', overflow='fold')
    for status in statuses:
        table.add_row(
            Text(status.name),
            _outcome(status),
            str(status.states_progressed),
            str(len({each.stream for each in status.groundings})),
            round_duration(max(0, now - status.started)),
            # It is called by its formula where the caller gave it no name.
            Text('' if status.formula == status.name else status.formula),
            Text(_remark(status)),
        )
    if not table.row_count:
        table.caption = 'nothing is being evaluated'
    return table


def evaluation_details(statuses: Iterable[EvaluationStatus]) -> RenderableType:
    """Everything that is known of some evaluations, one below the other."""
    return Group(*(_details(status) for status in statuses))


def as_json(status: EvaluationStatus) -> dict[str, Any]:
    """Everything that is known of an evaluation; times in nanoseconds."""
    document = asdict(status)
    error = document.pop('error')
    groundings = [{**asdict(each), 'grounding': each.grounding.name} for each in status.groundings]
    times = {f'{name}_ns': document.pop(name) for name in _TIMES}
    return {
        **document,
        **times,
        'phase': status.phase.name,
        'verdict': status.verdict.name,
        'groundings': groundings,
        'exit_status': (ExitCode.SUCCESS if error is None else error.code).name,
        'message': '' if error is None else error.message,
    }


_TIMES = ('started', 'latest_valid_time', 'decided_at')


def _details(status: EvaluationStatus) -> Table:
    table = Table(box=None, show_header=False, pad_edge=False)
    table.add_column(style='dim', no_wrap=True)
    table.add_column(overflow='fold')
    table.add_row('evaluation', Text(status.name))
    table.add_row('state', _outcome(status))
    for what, text in details(status):
        table.add_row(what, Text(text))
    table.add_row()
    return table


def _outcome(status: EvaluationStatus) -> Text:
    return Text(outcome(status), _style(status))


def _style(status: EvaluationStatus) -> str:
    if status.error is not None:
        return 'magenta'
    if status.phase is EvaluationPhase.ENDED:
        return _VERDICTS[status.verdict]
    if status.phase is EvaluationPhase.RUNNING and not status.presumably_false:
        return 'cyan'
    return 'yellow'


def _remark(status: EvaluationStatus) -> str:
    """Why it is as it is, where that is not all."""
    if status.error is not None:
        return status.error.message.partition('\n')[0]
    if status.phase is EvaluationPhase.INTERRUPTED and status.events:
        return status.events[-1]
    return status.explanation
