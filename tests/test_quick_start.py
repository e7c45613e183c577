"""The quick start, line by line."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from commands import command, dyknow_up, output_of, running
from system import private_environment

PAGE = Path(__file__).parent.parent / 'docs' / 'quickstart.md'

_BLOCK = re.compile(r'^```(\w*)\n(.*?)^```$', re.MULTILINE | re.DOTALL)
_RECORDING = 'dyknow_bringup/recordings/power_surge'


def blocks(language: str) -> list[str]:
    """The blocks of the page in one language."""
    return [
        text
        for found, text in _BLOCK.findall(PAGE.read_text(encoding='utf-8'))
        if found == language
    ]


def lines(verb: str) -> list[list[str]]:
    """The command lines of a verb, split as a shell does, with the recording of this workspace."""
    recording = str(PAGE.parent.parent / _RECORDING)
    return [
        shlex.split(line.replace(_RECORDING, recording))[1:]
        for block in blocks('')
        for line in block.splitlines()
        if line.startswith(f'dyknow {verb}')
    ]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the robot.yaml of the page."""
    (text,) = blocks('yaml')
    (tmp_path / 'robot.yaml').write_text(text, encoding='utf-8')
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_recording(folder: Path) -> None:
    listing, one, several = (output_of(command('dyknow', *line), {}) for line in lines('check'))
    assert (listing.returncode, one.returncode, several.returncode) == (0, 1, 1)
    assert '/uav1/battery' in listing.stdout
    assert 'is not > -12' in re.sub(r'[\s│]+', ' ', one.stdout)
    assert (folder / 'report.html').exists()


def test_a_running_robot(folder: Path) -> None:  # noqa: ARG001 - the monitor reads its file
    environment = private_environment()
    (up,), (replay,), (evaluate,), (monitor,) = map(lines, ('up', 'replay', 'evaluate', 'monitor'))
    with (
        dyknow_up(environment, *up[1:]),
        running(command('dyknow', *replay, '--delay', '10'), environment),
    ):
        answer = output_of(command('dyknow', *evaluate), environment)
        watched = output_of(command('dyknow', *monitor, '--duration', '3'), environment)
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert answer.stdout.startswith('true at ')
    assert watched.returncode in {0, 1}, watched.stderr
    assert 'battery' in watched.stdout
