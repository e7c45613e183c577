"""Outputs of commands that are no terminal."""

from __future__ import annotations

import io

import pytest
from rich.panel import Panel

from dyknow_common.tables import ReportTable, Terminal, fixed, framed_table, wide


@pytest.mark.parametrize('what', [Panel('text'), framed_table([wide('text')], [], expand=True)])
def test_nothing_fills_the_width_of_a_pipe(what: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('COLUMNS', raising=False)
    output = io.StringIO()
    Terminal(file=output).print(what)
    assert max(map(len, output.getvalue().splitlines())) < 20


def test_only_tables_with_lines_are_folded_in_a_pipe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('COLUMNS', raising=False)
    rows = [['power', 'a reason of many words ' * 9]]
    folded, whole = io.StringIO(), io.StringIO()
    Terminal(file=folded).print(framed_table([fixed('formula'), wide('why')], rows))
    assert max(map(len, folded.getvalue().splitlines())) == 80
    Terminal(file=whole).print(ReportTable([fixed('stream'), wide('why')], rows))
    assert len(whole.getvalue().splitlines()) == 2


def test_a_long_word_of_a_wide_column_is_shown_in_full() -> None:
    word = 'the_stream_of_a_robot_1700000013.600'
    output = io.StringIO()
    table = framed_table([fixed('verdict'), wide('why')], [['false', word]], expand=True)
    Terminal(file=output, width=30).print(table)
    shown = ''.join(line.split('│')[2].strip() for line in output.getvalue().splitlines()[3:-1])
    assert shown == word


def test_no_control_character_of_a_cell_is_printed() -> None:
    output = io.StringIO()
    rows = [['/a\x1b[31m\u202eb\u200b', 'two\nlines']]
    Terminal(file=output).print(ReportTable([fixed('topic'), wide('why')], rows))
    assert '/a\ufffd[31m\ufffdb\ufffd' in output.getvalue()
    assert len(output.getvalue().splitlines()) == 3
