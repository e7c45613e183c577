"""Each line of a command in the documentation has options and files that exist.

The quick start, the tutorial and the pages of examples are followed to the letter by tests of their
own. Here, no block of commands of any page escapes: a line is of a program that is checked here, or
of one that this repository does not contain.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from dyknow_command import options_parser
from dyknow_command.verbs import VERBS

ROOT = Path(__file__).parent.parent
PAGES = [
    ROOT / 'README.md',
    *sorted((ROOT / 'docs').glob('*.md')),
    *sorted((ROOT / 'examples').rglob('*.md')),
    *sorted((ROOT / 'benchmarks').glob('*.md')),
]

OTHERS = (
    *(
        'curl',
        'source',
        'export',
        'cp',
        'sh docs/',
        'ssh',
        'pip',
        'make',
        'python3 -m',
        'colcon',
        'rosdep',
        'rqt_plot',
    ),
    *('ros2 topic', 'ros2 service', 'ros2 action', 'ros2 bag', 'ros2 run watch_cpp'),
)
"""Programs that are not of this repository, or need an installed ROS.

test_client_examples checks the calls of services and actions, and compiles watch_cpp.
"""

_BLOCK = re.compile(r'^```(?P<language>\w*)\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)
_ENDS = {'|', '>', '&&', ';', '&', '--ros-args'}
_REPORTS = ('streams', 'evaluations', 'semantics')
_OUTPUT = re.compile(r'(\$ |robot.yaml:\d|DyKnow runs in|error creating node)')


def command_lines() -> Iterator[object]:
    """Yield a parameter for each line of a block without a language, unless it is an output."""
    for page in PAGES:
        for block in _BLOCK.finditer(page.read_text(encoding='utf-8')):
            if block['language'] or _OUTPUT.match(block['text']):
                continue
            for line in block['text'].replace('\\\n', ' ').splitlines():
                if line:
                    yield pytest.param(line, id=f'{page.relative_to(ROOT)}: {line[:40]}')


def words(line: str) -> list[str]:
    """Return the first command of a line without its comment."""
    found = shlex.split(line, comments=True)
    return found[: next((index for index, each in enumerate(found) if each in _ENDS), None)]


@pytest.mark.parametrize('line', [*command_lines()])
def test_a_command_exists(line: str) -> None:
    check(line)


@pytest.mark.parametrize(
    'line',
    [
        'dyknow chek flight',
        'dyknow check flight --fromula p',
        'python3 examples/simulation.py',
        'ros2 launch dyknow_bringup dyknow.launch.xml',
        'ros2 launch dyknow_bringup dyknow.launch.py cnofig:=robot.yaml',
        'ros2 run dyknow_bringup formula_marker',
        'another program',
    ],
)
def test_a_wrong_command_would_be_noticed(line: str) -> None:
    with pytest.raises((AssertionError, OSError, pytest.fail.Exception)):
        check(line)


def check(line: str) -> None:
    """Check that a line is a command with options that exist."""
    match words(line):
        case ['dyknow', verb, *_] if verb in VERBS:
            check_options(words(line)[1:])
        case [report, *arguments] if report in _REPORTS:
            check_options([report, *arguments])
        case ['python' | 'python3', script, *_] if script != '-m':
            assert (ROOT / script).is_file()
        case ['ros2', 'launch', package, launch_file, *arguments]:
            assert (ROOT / package / 'launch' / launch_file).is_file()
            assert {each.partition(':=')[0] for each in arguments} <= launch_arguments()
        case ['ros2', 'run', package, executable, *_] if package != 'watch_cpp':
            assert is_executable(package, executable)
        case [path, *_] if path.startswith('install/'):
            _, package, _, _, executable = path.split('/')
            assert is_executable(package, executable)
        case _:
            assert line.startswith(OTHERS), line


def launch_arguments() -> set[str]:
    """Return the names of the arguments of all launch files."""
    package = ROOT / 'dyknow_bringup'
    paths = *package.glob('launch/*.py'), *package.glob('dyknow_bringup/processes/*.py')
    texts = [each.read_text(encoding='utf-8') for each in paths]
    return {name for text in texts for name in re.findall(r"'(\w+)'", text)}


def is_executable(package: str, name: str) -> bool:
    """Return True if a package installs an executable."""
    return f'{name} = ' in (ROOT / package / 'setup.py').read_text(encoding='utf-8')


def check_options(arguments: list[str]) -> None:
    """Check that the command accepts its arguments."""
    try:
        options_parser(arguments[0]).parse_args(arguments)
    except SystemExit:
        pytest.fail(f'refused: {arguments}')
