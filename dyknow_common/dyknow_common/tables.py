"""Reports as tables on a terminal and as JSON documents.

Cells are plain texts, not rich's markup: in markup, `Power[uav1]` would lose its brackets.
`dyknow_common` itself does not import this module, as rich is slow to import.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Sequence
from dataclasses import asdict, replace
from enum import Enum
from functools import partial
from math import isinf
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderResult
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Column, Table
from rich.text import Text

from dyknow_common.errors import visible

Cell = str | Text

_MIN_NAME = 8
"""The least width of a column of names."""

_MIN_TEXT = 24
"""The least width of a column of long texts; where it is less, they are below the rows."""

_GAP = 2
"""The space between two columns."""

_TIGHT_GAP = 1
"""The same where names would fold: rich's padding, collapsed."""


_PIPE_WIDTH = 10_000
"""The columns of an output that is no terminal: lines for other programs are not folded."""

_LOG_WIDTH = 80
"""The same for tables with lines and for panels, which people read: in logs of a CI, in files."""


class Terminal(Console):
    """The standard output of a command.

    Args:
        options: of rich's consoles.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self._is_free = not (self.is_terminal or os.environ.get('COLUMNS') or 'width' in options)
        if self._is_free:
            self.width = _PIPE_WIDTH

    def render(self, renderable: Any, options: Any = None) -> Iterable[Any]:
        """Render something; only on a terminal, tables and panels fill the width.

        No control character of a name or a message, as of a hostile recording, reaches a terminal.
        """
        if isinstance(renderable, Table | Panel):
            renderable.expand = renderable.expand and self.is_terminal
            if self._is_free and renderable.box:
                options = (options or self.options).update(width=_LOG_WIDTH)
        for each in super().render(renderable, options):
            yield each if each.control else each._replace(text=visible(each.text))

    def on_broken_pipe(self) -> None:
        """Let the command end as `run_main` says; rich would end it with 1, which means false."""
        raise BrokenPipeError


def named(header: str) -> Column:
    """Return a column of names, which fold where the terminal is narrow."""
    return Column(header, overflow='fold', min_width=_MIN_NAME)


def fixed(header: str) -> Column:
    """Return a column of short texts that never wrap."""
    return Column(header, no_wrap=True)


def figure(header: str) -> Column:
    """Return a column of numbers."""
    return Column(header, justify='right', no_wrap=True)


def folded(header: str = '') -> Column:
    """Return a column of long texts that fold anywhere."""
    return Column(header, overflow='fold')


def wide(header: str) -> Column:
    """Return a column that fills the terminal."""
    return Column(header, ratio=1, overflow='fold')


def framed_table(
    columns: Iterable[Column], rows: Iterable[Iterable[Cell]], **options: Any
) -> Table:
    """Return a table with lines between its columns.

    Args:
        columns: the columns, with their headers.
        rows: a cell for each column.
        options: other options of rich's tables.
    """
    table = Table(*columns, **options)
    for row in rows:
        table.add_row(*(cell if isinstance(cell, Text) else Text(visible(cell)) for cell in row))
    return table


def report_table(
    columns: Iterable[Column], rows: Iterable[Iterable[Cell]], **options: Any
) -> Table:
    """Return a table without lines, given the same as for a framed one."""
    return framed_table(columns, rows, box=None, pad_edge=False, **options)


class ReportTable:
    """A table without lines; where it is too narrow, long texts are below each row.

    Example, on a terminal with 40 columns:

        stream  state    samples
        power   flowing      120
        late    waiting
          nobody publishes /rover1/odom

    Args:
        columns: the columns; the first one has names.
        rows: a cell for each column.
        texts: the number of columns at the end that have long texts.
        caption: a line below the table.
    """

    def __init__(
        self,
        columns: Sequence[Column],
        rows: Iterable[Sequence[Cell]],
        *,
        texts: int = 1,
        caption: str = '',
    ) -> None:
        self._columns = columns
        self._rows = list(rows)
        self._texts = texts
        self._caption = caption

    def __rich_console__(self, _: Console, options: ConsoleOptions) -> RenderResult:
        """Render the table for the width of a console."""
        lines = [[each.header for each in self._columns], *self._rows]
        widths = [max(map(_width, cells)) for cells in zip(*lines, strict=True)]
        short = len(self._columns) - self._texts
        needed = sum(widths[:short]) + sum(min(each, _MIN_TEXT) for each in widths[short:])
        if needed + _GAP * (len(widths) - 1) <= options.max_width:
            caption = self._caption or None
            yield report_table(map(_copied, self._columns), self._rows, caption=caption)
            return
        columns, widths = self._columns[:short], widths[:short]
        is_tight = sum(widths) + _GAP * (short - 1) > options.max_width
        others = sum(widths[1:]) + (_TIGHT_GAP if is_tight else _GAP) * (short - 1)
        widths[0] = max(_MIN_NAME, min(widths[0], options.max_width - others))
        table = partial(report_table, collapse_padding=is_tight)
        yield table(map(_copied, columns, widths), [])
        for row in self._rows:
            yield table(map(_copied, columns, widths), [row[:short]], show_header=False)
            for text in filter(_width, row[short:]):
                yield Padding(Text(str(text), overflow='fold'), (0, 0, 0, _GAP))
        if self._caption:
            yield Text(self._caption)


def _copied(column: Column, width: int | None = None) -> Column:
    """Return a column for another table: rich keeps the cells of a table in its columns."""
    return replace(column, _cells=[], width=width)


def _width(cell: Any) -> int:
    return cell.cell_len if isinstance(cell, Text) else cell_len(cell)


def details_table(details: Iterable[tuple[str, Cell]]) -> Table:
    """Return a table of names and values, without the empty values."""
    columns = (Column(style='dim', no_wrap=True), folded())
    return report_table(columns, (row for row in details if row[1]), show_header=False)


def json_document(report: Any, times: Collection[str]) -> dict[str, Any]:
    """Return a dataclass as a JSON document: members of enumerations are names, infinities texts.

    Args:
        report: the dataclass.
        times: fields in nanoseconds, also of nested dataclasses; `_ns` is added to their names.
    """

    def document(fields: list[tuple[str, Any]]) -> dict[str, Any]:
        return {f'{name}_ns' if name in times else name: _plain(value) for name, value in fields}

    return asdict(report, dict_factory=document)


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.name
    return str(value) if isinstance(value, float) and isinf(value) else value
