"""The tutorial, followed to the letter: each command runs, and answers what the page shows."""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from nav_msgs.msg import Odometry

from commands import command, started
from dyknow_common.ros import time_to_nanoseconds
from system import Client, private_environment

ROOT = Path(__file__).parent.parent
TUTORIAL = ROOT / 'docs' / 'tutorial.md'
BLOCK = re.compile(r'^```(?P<language>\w*)\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)
ROW = re.compile(r'^│ (\w+) +│ (\w+) ', re.MULTILINE)
BACKGROUND = ('dyknow up', 'python3')


def steps() -> Iterator[tuple[str, str]]:
    """Yield each file and command of the tutorial, with the answer that the page shows."""
    blocks = [(each['language'], each['text']) for each in BLOCK.finditer(TUTORIAL.read_text())]
    for (language, text), (following, answer) in zip(blocks, [*blocks[1:], ('', '')], strict=True):
        if language != 'text':
            yield language or 'command', text.strip() + '\0' + answer * (following == 'text')


def comparable(answer: str) -> object:
    """Return the outcomes of a table, the verdict true, or else a text with # for each number.

    What makes a formula true depends on where the rover is. If the first state makes it false, the
    answer does not say since when it had to hold. A slow computer is told what it waits for, and
    may still know the publisher of the rover that was stopped.
    """
    answer = re.sub(r'^no state has come: .*\n', '', answer)
    if answer.startswith('true'):
        return 'true'
    text = re.sub(
        r' \(always must hold since .*\)|; /odom has 2 publishers: [^()]*(?= \()', '', answer
    )
    return ROW.findall(answer) or re.sub(r'\d+(\.\d+)?', '#', text).strip()


class Reader:
    """Someone who follows the tutorial with one terminal for each program.

    Args:
        folder: where the commands run.
    """

    def __init__(self, folder: Path) -> None:
        self.environment = private_environment()
        self._folder = folder
        self._terminals: dict[str, subprocess.Popen[str]] = {}

    def run(self, line: str) -> tuple[str, int]:
        """Run a command to its end, or start it in its terminal.

        Return what it prints and its exit code, 0 for one that has been started.
        """
        terminal = next((each for each in BACKGROUND if line.startswith(each)), None)
        if terminal is None:
            with self._start(line) as process:
                return process.communicate(timeout=300)[0], process.returncode
        self.stop(terminal)
        process = self._terminals[terminal] = self._start(line)
        if terminal == 'dyknow up':
            assert process.stdout is not None
            assert any('DyKnow runs' in each for each in process.stdout)
        elif 'dyknow up' in self._terminals:
            self._see_it_drive()
        return '', 0

    def _see_it_drive(self) -> None:
        """Wait until the pause in which the rover was started again is over for DyKnow, too."""
        client, stamps = Client(self.environment), []

        def note(message: Odometry) -> None:
            stamps.append(time_to_nanoseconds(message.header.stamp))

        client.node.create_subscription(Odometry, '/odom', note, 10)
        client.spin_until(lambda: bool(stamps) and stamps[-1] - stamps[0] > 2e9, 'the rover drives')
        client.close()

    def stop(self, terminal: str) -> None:
        """Press Ctrl-C."""
        if terminal in self._terminals:
            with self._terminals.pop(terminal) as process:
                process.send_signal(signal.SIGINT)
                process.communicate(timeout=40)

    def _start(self, command_line: str) -> Any:
        program, *arguments = shlex.split(command_line)
        known = {'dyknow': command('dyknow'), 'python3': [sys.executable]}
        line = [*known.get(program, [program]), *arguments]
        return started(line, self.environment, cwd=self._folder)


@contextmanager
def reader(folder: Path) -> Iterator[Reader]:
    (folder / 'examples').symlink_to(ROOT / 'examples')
    found = Reader(folder)
    try:
        yield found
    finally:
        for terminal in BACKGROUND:
            found.stop(terminal)


@pytest.mark.timeout(600)
def test_the_tutorial(tmp_path: Path) -> None:
    with reader(tmp_path) as following:
        for kind, step in steps():
            text, _, answer = step.partition('\0')
            if kind == 'yaml':
                (tmp_path / 'robot.yaml').write_text(text, encoding='utf-8')
            elif not text.startswith(('source', 'ros2')) or shutil.which(text.split()[0]):
                printed, code = following.run(text)
                is_expected = comparable(printed) == comparable(answer) if answer else code == 0
                assert is_expected, (text, printed)


def test_the_topics_are_those_of_the_rover(tmp_path: Path) -> None:
    (shown,) = (step.partition('\0')[2] for _, step in steps() if step.startswith('ros2 topic'))
    with reader(tmp_path) as following:
        following.run('python3 examples/simulate.py rover')
        client = Client(following.environment)
        expected = {*shown.split()}
        client.spin_until(
            lambda: {name for name, _ in client.node.get_topic_names_and_types()} == expected,
            f'the topics {expected}',
            instead=client.node.get_topic_names_and_types,
        )
        client.close()
