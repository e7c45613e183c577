"""The command `dyknow`: its verbs, its help, and what it says where something is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import pytest

import dyknow_command
from dyknow_command import verbs
from dyknow_command.verbs import VERBS

WITHOUT_ROS = [name for name, verb in VERBS.items() if not verb.needs_ros]


@pytest.mark.parametrize('verb', ['up', 'evaluate', 'streams', 'policy'])
def test_a_verb_that_needs_the_workspace(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(verbs, 'find_spec', lambda _: None)
    assert dyknow_command.main([verb, '--help']) == 2
    assert f'dyknow: {verb} needs ROS 2 and the workspace of DyKnow' in capsys.readouterr().err


def test_checks_import_no_demonstration(monkeypatch: pytest.MonkeyPatch) -> None:
    imported: list[str] = []

    def import_module(name: str) -> object:
        imported.append(name)
        raise SystemExit

    monkeypatch.setattr(dyknow_command, 'import_module', import_module)
    with pytest.raises(SystemExit):
        dyknow_command.main(['check', 'flight'])
    assert imported == ['dyknow_recordings.check']


@pytest.mark.parametrize(
    ('verb', 'hint'), [('lnt', "did you mean 'lint'?"), ('fly', 'use up, evaluate, monitor')]
)
def test_an_unknown_verb(verb: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        dyknow_command.main([verb, '--help'])
    assert ended.value.code == 2
    assert f"dyknow: error: unknown verb '{verb}'; {hint}" in capsys.readouterr().err


@pytest.mark.parametrize('verb', WITHOUT_ROS)
def test_every_help_has_examples(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        dyknow_command.main([verb, '--help'])
    shown = capsys.readouterr().out
    assert ended.value.code == 0
    assert f'Examples:\n  dyknow {verb}' in shown
    assert 'Exit code: ' in shown


def test_the_help_fits_a_terminal_of_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        dyknow_command.main(['--help'])
    shown = capsys.readouterr().out
    assert all(f'  {verb}' in shown for verb in VERBS)
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize('arguments', [['--version'], ['version']])
def test_the_version(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with suppress(SystemExit):  # Of argparse.
        assert dyknow_command.main(arguments) == 0
    assert capsys.readouterr().out.startswith('dyknow ')


@pytest.mark.parametrize(
    ('arguments', 'canonical'),
    [
        (['always p -> q'], 'always (p -> q)\n'),
        (
            ['--language', 'stream', 'select x as y from "/a" with max_delay = 100 ms'],
            'sink select x as y from "/a" with max_delay = 100 ms\n',
        ),
        (
            ['--language', 'annotation', 'stream "/a" contains P[u] = x;'],
            'stream "/a" contains P[u] = x;\n',
        ),
    ],
)
def test_texts_are_parsed(
    arguments: list[str], canonical: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert dyknow_command.main(['parse', *arguments]) == 0
    assert capsys.readouterr().out == canonical


def test_parse_warns_of_what_a_formula_may_not_mean(capsys: pytest.CaptureFixture[str]) -> None:
    assert dyknow_command.main(['parse', 'previous p -> q']) == 0
    out, error = capsys.readouterr()
    assert out == 'previous (p -> q)\n'
    assert error.startswith("warning: formula:1:1: previous reaches over the '->' that follows")


def test_an_incorrect_text_is_shown_with_the_place(capsys: pytest.CaptureFixture[str]) -> None:
    assert dyknow_command.main(['parse', 'always alway x']) == 2
    assert capsys.readouterr().err.startswith("dyknow: formula:1:14: did you mean 'always' ")


def test_an_unknown_option_shows_the_usage_of_the_verb(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        dyknow_command.main(['parse', 'p', '--depth', '5'])
    assert ended.value.code == 2
    shown = capsys.readouterr().err
    assert shown.startswith('usage: dyknow parse [-h] ')
    assert shown.endswith('dyknow parse: error: unrecognized arguments: --depth 5\n')


def test_completion_needs_nothing_that_is_missing() -> None:
    code = 'import dyknow_command, sys; sys.exit(dyknow_command.main([]))'
    done = subprocess.run(
        [sys.executable, '-c', code],
        env={
            '_ARGCOMPLETE': '1',
            'COMP_LINE': 'dyknow che',
            'COMP_POINT': '10',
            'PYTHONPATH': ':'.join(sys.path),
        },
        check=False,
        capture_output=True,
        text=True,
    )
    assert 'Traceback' not in done.stderr


@pytest.mark.parametrize(
    ('line', 'completions'),
    [('dyknow ev', ['evaluate', 'evaluations']), ('dyknow parse --l', ['--language'])],
)
def test_completions(tmp_path: Path, line: str, completions: list[str]) -> None:
    pytest.importorskip('argcomplete')
    subprocess.run(
        [sys.executable, '-c', 'import dyknow_command, sys; sys.exit(dyknow_command.main([]))'],
        env={
            **os.environ,
            '_ARGCOMPLETE': '1',
            '_ARGCOMPLETE_STDOUT_FILENAME': str(tmp_path / 'completions'),
            'COMP_LINE': line,
            'COMP_POINT': str(len(line)),
            'PYTHONPATH': ':'.join(sys.path),
        },
        check=False,
    )
    found = (tmp_path / 'completions').read_text(encoding='utf-8')
    assert [each.strip() for each in found.split('\x0b')] == completions
