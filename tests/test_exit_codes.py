"""Every executable ends with the exit code of what happened, and never with a traceback."""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import dyknow_command
from commands import EXECUTABLES, command, interruptible
from dyknow_command.verbs import VERBS
from dyknow_configuration import PACKAGES
from fork_server import ForkingPopen
from system import LIMIT, Client, private_environment

NODES = {
    *PACKAGES,
    'carrier_simulation',
    'dyknow_nodes',
    'formula_markers',
    'formula_monitor',
    'uav_simulation',
}


@pytest.fixture(scope='module')
def environment() -> dict[str, str]:
    return {**os.environ, **private_environment()}


def line(name: str, *arguments: str) -> list[str]:
    return interruptible(command(name, *arguments))


def ended(
    name: str, *arguments: str, environment: dict[str, str], stdout: int = subprocess.PIPE
) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        command(name, *arguments),
        env=environment,
        stdout=stdout,
        stderr=subprocess.PIPE,
        stdin=subprocess.DEVNULL,
        text=True,
        timeout=LIMIT,
        check=False,
    )
    assert 'Traceback' not in done.stderr, done.stderr
    return done


@pytest.mark.parametrize('name', EXECUTABLES)
def test_an_executable_outside_of_its_environment(name: str) -> None:
    done = ended(name, environment={'PATH': os.defpath})
    assert done.returncode == (1 if name in NODES else 2)
    assert done.stderr.startswith(f'{name}: cannot start: ')
    assert 'run first: source env.sh, or the setup.bash of the workspace' in done.stderr


@pytest.mark.parametrize('verb', VERBS)
def test_each_verb(
    verb: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The main function of the command, in this process: each start of one takes half a second."""
    monkeypatch.setenv('COLUMNS', '80')
    outcomes = []
    for option in ('--help', '--no-such-option'):
        with pytest.raises(SystemExit) as end:
            dyknow_command.main([verb, option])
        outcomes.append((end.value.code, *capsys.readouterr()))
    (code, shown, nothing), (wrong_code, nothing_shown, message) = outcomes
    assert (code, nothing) == (0, '')
    assert 0 < max(map(len, shown.splitlines())) <= 80
    assert f'Examples:\n  dyknow {verb}' in shown
    assert 'Exit code: ' in shown
    assert (wrong_code, nothing_shown) == (2, '')
    assert 'error: ' in message


@pytest.mark.parametrize('name', ['dyknow up', 'uav_demo', 'uav_plan', 'uav_simulation'])
def test_packages_that_are_not_found(name: str, environment: dict[str, str]) -> None:
    environment = {key: text for key, text in environment.items() if key != 'AMENT_PREFIX_PATH'}
    command, *arguments = name.split()
    # The executable itself is found by this process, which has the variable.
    done = ended(command, *arguments, environment=environment)
    assert done.returncode == (1 if command in NODES else 2)
    assert "'AMENT_PREFIX_PATH' is not set or empty; run first: source env.sh" in done.stderr


@pytest.fixture
def _forked() -> Iterator[None]:
    """Fork the processes of a test that is about what they do, and not about how they start."""
    ForkingPopen.is_enabled = True
    yield
    ForkingPopen.is_enabled = False


@pytest.mark.usefixtures('_forked')
@pytest.mark.parametrize(
    ('command', 'message'),
    [
        ('check p', 'the following arguments are required: --trace'),
        ('check p --trace /nowhere', 'cannot read the trace in /nowhere: No such file or'),
        ('dyknow', 'the following arguments are required: VERB'),
        ('dyknow up --store /dev/null/x', 'dyknow: /dev/null/x: Not a directory'),
        ('dyknow up --ontology /nowhere.owl', 'dyknow: ontologies: there is no file /nowhere.owl'),
        ('dyknow up --ontology /dev/zero', 'dyknow: ontologies: /dev/zero is no regular file'),
        ('dyknow up --streams nope.streams', 'streams: there is no file /'),
        ('dyknow up --namespace "a b"', 'must not contain characters'),
        ('dyknow up --params-file nope.yaml', 'params_file: there is no file /'),
        ('dyknow up --engines 33', '33 is no number of stream processing engines; '),
        ('dyknow dashboard --port 99999', "'99999' is no port; give a number up to 65535"),
        ('dyknow evaluate always', 'dyknow: formula:1:7: unexpected end of the formula'),
        ('dyknow evaluate p --coordinator a//b', 'dyknow: failed to resolve name: '),
        ('dyknow evaluate true', 'does DyKnow run, in this namespace and ROS domain? "dyknow up"'),
        ('dyknow evaluate p --ros-args -p x', 'dyknow: Failed to parse ROS arguments: '),
        ('evaluations --timeout 10ms', 'evaluations: no report of /stream_reasoning_coordinator'),
        ('generate_conversions a/msg/B', "'a/msg/B' is not installed"),
        ('generate_conversions std_msgs/msg/Bool --output /', ': /: Is a directory'),
        ('replay /', '/: not a recording: the folder has no metadata.yaml'),
        ('semantics --timeout 10ms', 'semantics: /ontology_manager has not answered'),
        ('streams --node a//b', 'streams: failed to resolve name: '),
        ('streams --timeout 10ms', 'streams: no report of /stream_manager within'),
        ('uav_demo --logs /dev/null/x', 'uav_demo: /dev/null/x: Not a directory'),
        ('replay /nowhere/at_all', '/nowhere/at_all: no such recording'),
        ('uav_demo --scenario picnic', 'windy_delivery, fleet or the path of a YAML file'),
        ('uav_demo --uavs 0', 'uav_demo: a fleet of 0 vehicles cannot fly'),
        ('uav_plan --plan picnic', "uav_plan: there is no plan 'picnic'"),
    ],
)
def test_errors_of_commands(command: str, message: str, environment: dict[str, str]) -> None:
    name, *arguments = shlex.split(command)
    done = ended(name, *arguments, environment=environment)
    assert done.returncode == 2
    assert message in done.stderr


def test_a_node_with_invalid_arguments(environment: dict[str, str]) -> None:
    done = ended('stream_manager', '--ros-args', '-p', 'x', environment=environment)
    assert done.returncode == 1
    assert "Couldn't parse parameter override rule: '-p x'" in done.stderr


@pytest.mark.parametrize(
    ('name', 'code'), [('streams', 2), ('dyknow up', 2), ('stream_manager', 1)]
)
def test_a_domain_that_dds_does_not_have(name: str, code: int, environment: dict[str, str]) -> None:
    """With 1, a command would say that a formula is false."""
    command, *arguments = name.split()
    done = ended(command, *arguments, environment={**environment, 'ROS_DOMAIN_ID': '233'})
    assert done.returncode == code
    assert 'ROS_DOMAIN_ID is 233; use 0 to 232' in done.stderr


@pytest.fixture
def trace(tmp_path: Path) -> str:
    path = tmp_path / 'trace.csv'
    path.write_text('time_s,p\n0,true\n1,false\n', encoding='utf-8')
    return str(path)


def test_a_trace_is_not_replayed(trace: str, environment: dict[str, str]) -> None:
    done = ended('replay', trace, environment=environment)
    assert (done.returncode, 'only recordings of rosbag2' in done.stderr) == (2, True)


@pytest.mark.parametrize(('formula', 'code'), [('p', 0), ('always p', 1), ('q', 2)])
def test_an_output_that_is_closed(
    formula: str, code: int, trace: str, environment: dict[str, str]
) -> None:
    check = ['bash', '-c', '"$@" >&-', '-', *line('check', formula, '--trace', trace)]
    done = subprocess.run(check, env=environment, capture_output=True, timeout=LIMIT, check=False)
    assert done.returncode == code
    assert b'Traceback' not in done.stderr


def test_an_output_that_nobody_reads(trace: str, environment: dict[str, str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = ended('check', 'always p', '--trace', trace, environment=environment, stdout=writing)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, '')


@pytest.mark.parametrize('name', ['check p --trace', 'generate_conversions std_msgs/msg/Bool'])
def test_an_output_that_is_full(name: str, trace: str, environment: dict[str, str]) -> None:
    command, *arguments = name.split()
    arguments += [trace] if command == 'check' else []
    with Path('/dev/full').open('w', encoding='utf-8') as full:
        done = ended(command, *arguments, environment=environment, stdout=full.fileno())
    assert (done.returncode, done.stderr) == (2, f'{command}: No space left on device\n')


def test_an_encoding_that_lacks_a_character(trace: str, environment: dict[str, str]) -> None:
    ascii_only = {**environment, 'PYTHONIOENCODING': 'ascii'}
    done = ended('check', 'p -> q = "\u00e5"', '--trace', trace, environment=ascii_only)
    assert done.returncode == 2
    assert 'internal error' not in done.stderr


def test_an_interrupted_check(tmp_path: Path, environment: dict[str, str]) -> None:
    fifo = tmp_path / 'fifo'
    os.mkfifo(fifo)
    check = line('check', 'p', '--trace', str(fifo))
    with (
        subprocess.Popen(check, env=environment, stderr=subprocess.PIPE, text=True) as running,
        # Opening a FIFO for writing waits for its reader.
        fifo.open('w', encoding='utf-8'),
    ):
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=LIMIT)
    assert (running.returncode, err) == (130, '')


def test_an_interrupted_evaluation(client: Client) -> None:
    with subprocess.Popen(
        line('dyknow', 'evaluate', 'p'), env=os.environ, stderr=subprocess.PIPE, text=True
    ) as running:
        client.spin_until(
            lambda: 'dyknow_evaluate' in client.node.get_node_names(), 'the command runs'
        )
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=LIMIT)
    assert (running.returncode, err) == (130, '')
