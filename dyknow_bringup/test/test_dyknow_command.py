"""The command `dyknow`, where only the part without ROS is installed."""

from __future__ import annotations

import sys

import pytest

import dyknow_command


@pytest.mark.parametrize('verb', ['up', 'evaluate', 'policy'])
def test_a_verb_that_needs_the_workspace(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dyknow_command, 'find_spec', lambda _: None)
    monkeypatch.setattr(sys, 'argv', ['dyknow', verb, '--help'])
    assert dyknow_command.main() == 2
    assert f'dyknow: {verb} needs ROS 2 and the workspace of DyKnow' in capsys.readouterr().err


def test_checks_import_no_demonstration(monkeypatch: pytest.MonkeyPatch) -> None:
    imported: list[str] = []

    def import_module(name: str) -> object:
        imported.append(name)
        raise SystemExit

    monkeypatch.setattr(dyknow_command, 'import_module', import_module)
    monkeypatch.setattr(sys, 'argv', ['dyknow', 'check', 'flight'])
    with pytest.raises(SystemExit):
        dyknow_command.main()
    assert imported == ['dyknow_recordings.check']
