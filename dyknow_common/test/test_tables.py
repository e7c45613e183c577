"""Outputs of commands that are no terminal."""

from __future__ import annotations

import io

import pytest
from rich.panel import Panel

from dyknow_common.tables import Terminal, framed_table, wide


@pytest.mark.parametrize('what', [Panel('text'), framed_table([wide('text')], [], expand=True)])
def test_nothing_fills_the_width_of_a_pipe(what: object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv('COLUMNS', raising=False)
    output = io.StringIO()
    Terminal(file=output).print(what)
    assert max(map(len, output.getvalue().splitlines())) < 20
