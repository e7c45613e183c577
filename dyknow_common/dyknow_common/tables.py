"""Reports as tables on a terminal and as JSON documents.

Cells are plain texts, not rich's markup: in markup, `Power[uav1]` would lose its brackets.
`dyknow_common` itself does not import this module, as rich is slow to import.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import asdict
from enum import Enum
from typing import Any

from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

Cell = str | Text


class Terminal(Console):
    """The standard output of a command."""

    def on_broken_pipe(self) -> None:
        """Let the command end as `run_main` says; rich would end it with 1, which means false."""
        raise BrokenPipeError


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
    return Column(header, ratio=1)


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
        table.add_row(*(cell if isinstance(cell, Text) else Text(cell) for cell in row))
    return table


def report_table(
    columns: Iterable[Column], rows: Iterable[Iterable[Cell]], **options: Any
) -> Table:
    """Return a table without lines, given the same as for a framed one."""
    return framed_table(columns, rows, box=None, pad_edge=False, **options)


def details_table(details: Iterable[tuple[str, Cell]]) -> Table:
    """Return a table of names and values, without the empty values."""
    columns = (Column(style='dim', no_wrap=True), folded())
    return report_table(columns, (row for row in details if row[1]), show_header=False)


def json_document(report: Any, times: Collection[str]) -> dict[str, Any]:
    """Return a dataclass as a JSON document, with the names of enumeration members.

    Args:
        report: the dataclass.
        times: fields in nanoseconds, also of nested dataclasses; `_ns` is added to their names.
    """

    def document(fields: list[tuple[str, Any]]) -> dict[str, Any]:
        plain = ((name, value.name if isinstance(value, Enum) else value) for name, value in fields)
        return {f'{name}_ns' if name in times else name: value for name, value in plain}

    return asdict(report, dict_factory=document)
