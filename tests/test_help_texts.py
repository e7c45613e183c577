"""The help of each verb has examples, and fits a terminal of 80 columns."""

from __future__ import annotations

import pytest

from dyknow_command import options_parser
from dyknow_command.verbs import VERBS


@pytest.mark.parametrize('verb', VERBS)
def test_the_help_of_a_verb(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv('COLUMNS', '80')
    with pytest.raises(SystemExit) as ended:
        options_parser(verb).parse_args([verb, '--help'])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert f'Examples:\n  dyknow {verb}' in shown
    assert 'Exit code: ' in shown
    assert max(map(len, shown.splitlines())) <= 80
