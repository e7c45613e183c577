"""Evaluations on a terminal and as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from dyknow_common import ExitCode, Verdict, round_duration, with_readable_times
from dyknow_common.tables import (
    Cell,
    ReportTable,
    details_table,
    figure,
    fixed,
    folded,
    json_document,
    named,
)
from dyknow_coordinator.evaluation import EvaluationPhase
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus, details, outcome

_VERDICTS = {Verdict.TRUE: 'green', Verdict.FALSE: 'bold red', Verdict.UNDECIDED: 'dim'}


def evaluation_table(statuses: Iterable[EvaluationStatus], now: int) -> ReportTable:
    """Return a table with a line for each evaluation; `now` is in nanoseconds."""
    rows: list[tuple[Cell, ...]] = [
        (
            status.name,
            _outcome(status),
            str(status.states_progressed),
            str(len({each.stream for each in status.groundings})),
            round_duration(max(0, now - status.started)),
            # An evaluation without a name of its own is named by its formula.
            '' if status.text == status.name else status.text,
            with_readable_times(_remark(status), status.started),
        )
        for status in statuses
    ]
    columns = (
        named('evaluation'),
        fixed('state'),
        *map(figure, ('states', 'streams', 'since')),
        folded('formula'),
        folded(),
    )
    caption = '' if rows else 'nothing is being evaluated'
    return ReportTable(columns, rows, texts=2, caption=caption)


def evaluation_details(statuses: Iterable[EvaluationStatus]) -> RenderableType:
    """Return everything that is known of some evaluations, one below the other."""
    return Group(*(_details(status) for status in statuses))


def as_json(status: EvaluationStatus) -> dict[str, Any]:
    """Return everything that is known of an evaluation; times in nanoseconds."""
    document = json_document(status, times=('started', 'latest_valid_time', 'decided_at'))
    error = document.pop('error')
    return {
        **document,
        'exit_status': (ExitCode.SUCCESS if error is None else error.code).name,
        'message': '' if error is None else error.message,
    }


def _details(status: EvaluationStatus) -> Table:
    table = details_table(
        [('evaluation', status.name), ('state', _outcome(status)), *details(status)]
    )
    table.add_row()
    return table


def _outcome(status: EvaluationStatus) -> Text:
    return Text(outcome(status), _style(status))


def _style(status: EvaluationStatus) -> str:
    if status.error is not None:
        return 'magenta'
    if status.phase is EvaluationPhase.ENDED:
        return _VERDICTS[status.verdict]
    if status.episodes is not None and status.episodes.is_violated:
        return _VERDICTS[Verdict.FALSE]
    if status.phase is EvaluationPhase.RUNNING and not status.presumably_false:
        return 'cyan'
    return 'yellow'


def _remark(status: EvaluationStatus) -> str:
    """Return why an evaluation is in its state, if that is known."""
    if status.error is not None:
        return status.error.message.partition('\n')[0]
    if status.phase is EvaluationPhase.INTERRUPTED and status.events:
        return status.events[-1]
    if status.phase is EvaluationPhase.WAITING:
        return status.waits_for
    if status.episodes is not None and status.phase is EvaluationPhase.RUNNING:
        return status.episodes.text
    return status.explanation
