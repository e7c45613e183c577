"""Checks of many recordings: processes that die, interruptions, and the order of the results."""

from __future__ import annotations

import errno
import os
import pty
import signal
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from contextlib import suppress
from pathlib import Path

import pytest
from running_checks import (
    CODE,
    FORMULAS,
    LIMIT_S,
    OPTIONS,
    EndlessRecording,
    checking,
    names,
    wait_for,
    workers_of,
)

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.executables import SIGNALLED
from dyknow_common.worker_pool import PROGRAM
from dyknow_recordings import MonitoringFiles, RequestedFormula
from dyknow_recordings.jobs import RecordingJob, run_here, run_in_processes

pytestmark = pytest.mark.long

TERMINAL = {'TERM': 'xterm', 'COLUMNS': '80', 'LINES': '24'}


def test_all_numbers_of_jobs_have_the_same_output(bags: list[str], tmp_path: Path) -> None:
    recordings = [*bags, str(tmp_path / 'missing'), bags[0]]
    outputs = set()
    for seed, jobs in enumerate((1, 2, 2, 4)):
        done = subprocess.run(
            [sys.executable, '-c', CODE, *recordings, *OPTIONS, '--json', '--jobs', str(jobs)],
            env={**os.environ, 'PYTHONHASHSEED': str(seed)},
            capture_output=True,
            check=False,
            text=True,
            timeout=LIMIT_S,
        )
        outputs.add((done.stdout, done.stderr, done.returncode))
    ((out, err, code),) = outputs
    expected = [(each, None) for each in bags]
    assert names(out) == [*expected, (recordings[4], 'NOT_FOUND'), expected[0]]
    assert (err, code) == (f'dyknow check: {recordings[4]}: no such recording\n', 2)


def test_a_process_that_dies_is_an_error_of_its_recording(
    bags: list[str], endless: EndlessRecording
) -> None:
    path = str(endless.path)
    with checking(path, *bags, '--json', '--jobs', '2') as process:
        os.kill(endless.reader(), signal.SIGKILL)
        out, err = process.communicate(timeout=LIMIT_S)
    assert names(out) == [(path, 'UNAVAILABLE'), *((each, None) for each in bags)]
    assert f'{path}: its process ended with signal SIGKILL; it may need too much memory' in err
    assert process.returncode == 2


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('jobs', ['1', '2'])
def test_an_interruption_prints_what_is_done(
    bags: list[str], endless: EndlessRecording, tmp_path: Path, jobs: str, number: signal.Signals
) -> None:
    recordings = [*bags[:2], str(endless.path), bags[2]]
    report = tmp_path / 'out.xml'
    options = ('--json', '--jobs', jobs, '--junit', str(report))
    with checking(*recordings, *options) as process:
        endless.wait_for_reader()
        assert process.stdout
        first = [process.stdout.readline() for _ in bags[:2]]
        process.send_signal(number)
        rest, err = process.communicate(timeout=LIMIT_S)
    done = [name for name, _ in names(''.join([*first, rest]))]
    # With several jobs, the last recording may have been checked.
    assert done in [bags[:2], bags[:3]]
    assert err == f'dyknow check: interrupted; not checked: {len(recordings) - len(done)}\n'
    assert process.returncode == SIGNALLED + number
    suites = ET.parse(report).getroot()  # noqa: S314 - our own file
    assert sorted(each.get('name', '') for each in suites) == sorted(recordings)
    assert 'not checked: the command was interrupted' in report.read_text()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_an_interruption_before_the_first_recording(
    bags: list[str], tmp_path: Path, number: signal.Signals
) -> None:
    code = (
        'import os, sys; from dyknow_recordings import check; '
        f'check.read_configuration = lambda *_: os.kill(os.getpid(), {number}); '
        'sys.exit(check.main(sys.argv[1:]))'
    )
    report = tmp_path / 'out.xml'
    command = [sys.executable, '-c', code, *bags, *OPTIONS, '--junit', str(report)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=LIMIT_S)
    assert done.returncode == SIGNALLED + number
    assert done.stderr == f'dyknow check: interrupted; not checked: {len(bags)}\n'
    assert f'errors="{len(bags)}"' in report.read_text()


def test_later_results_are_printed_after_an_interruption(
    bags: list[str], endless: EndlessRecording, tmp_path: Path
) -> None:
    second = EndlessRecording(tmp_path / 'second.mcap')
    recordings = [str(endless.path), bags[0], bags[1], str(second.path)]
    with checking(*recordings, '--json', '--jobs', '2') as process:
        second.wait_for_reader()
        time.sleep(0.5)  # The result of the last bag was sent before the pipe was opened.
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=LIMIT_S)
    assert names(out) == [(bags[0], None), (bags[1], None)]


def test_progress_is_shown_on_a_terminal(bags: list[str]) -> None:
    terminal, other_end = pty.openpty()
    command = [sys.executable, '-c', CODE, *bags[:2], *OPTIONS, '--json', '--jobs', '2']
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=other_end, text=True, env=os.environ | TERMINAL
    )
    os.close(other_end)
    shown = ''
    with suppress(OSError):  # The end of the terminal.
        while True:
            shown += os.read(terminal, 4096).decode()
    out, _ = process.communicate(timeout=LIMIT_S)
    os.close(terminal)
    assert names(out) == [(each, None) for each in bags[:2]]
    assert '0/2' in shown
    assert shown.endswith('\x1b[2K')  # The bar is removed.


def test_processes_end_with_a_killed_command(endless: EndlessRecording, bags: list[str]) -> None:
    with checking(str(endless.path), *bags, '--jobs', '2') as process:
        worker = endless.reader()
        process.kill()
        wait_for(lambda: not Path(f'/proc/{worker}/fd').exists(), 'end of the process')


def test_a_block_that_ends_leaves_no_process(bags: list[str], endless: EndlessRecording) -> None:
    paths = [endless.path, *map(Path, bags)]
    others = workers_of(os.getpid())
    with run_in_processes([job(path) for path in paths], 2) as results:
        assert next(results)[0] == 1
    assert workers_of(os.getpid()) == others


def test_results_are_the_same_in_another_process(bags: list[str]) -> None:
    jobs = [job(Path(each), 'forall u in UAV: x[u] = 1', 'always (', *FORMULAS) for each in bags]
    here = dict(run_here(jobs))
    with run_in_processes(jobs, 2) as results:
        elsewhere = dict(results)
    assert [repr(here[index]) for index in here] == [repr(elsewhere[index]) for index in here]


def test_processes_that_cannot_be_started(bags: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, 'executable', '/missing/python')
    monkeypatch.setattr(os, 'fork', no_memory)
    with run_in_processes([job(Path(each)) for each in bags], 2) as running:
        results = dict(running)
    assert len(results) == len(bags)
    for result in results.values():
        assert isinstance(result, DyKnowError)
        assert 'no process can be started: No such file or directory' in result.message


def test_faults_are_errors_of_their_recording(
    bags: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr('dyknow_recordings.jobs.evaluate_recording', fail)
    result = job(Path(bags[0])).run()
    assert isinstance(result, DyKnowError)
    assert result.code is ExitCode.INTERNAL_ERROR
    assert result.message.startswith(f'{bags[0]}: internal error: MemoryError')


def no_memory() -> int:
    raise OSError(errno.EAGAIN, 'Resource temporarily unavailable')


def test_a_fresh_process_takes_the_place_of_a_forked_one(
    bags: list[str], endless: EndlessRecording
) -> None:
    paths = [str(endless.path), *bags]
    with checking(*paths, '--json', '--jobs', '2') as process:
        first = endless.reader()
        assert command_of(first) == command_of(process.pid)
        for worker in workers_of(process.pid):
            with suppress(ProcessLookupError):  # One that has ended meanwhile.
                os.kill(worker, signal.SIGKILL)
        out, _ = process.communicate(timeout=LIMIT_S)
    found = names(out)
    assert [name for name, _ in found] == paths
    assert found[0][1] == 'UNAVAILABLE'


def test_a_process_with_threads_forks_none(bags: list[str]) -> None:
    jobs = [job(Path(each)) for each in bags]
    others = {*workers_of(os.getpid())}
    ended = threading.Event()
    thread = threading.Thread(target=ended.wait)
    thread.start()
    try:
        with run_in_processes(jobs, 2) as results:
            next(results)
            commands = {command_of(each) for each in {*workers_of(os.getpid())} - others}
    finally:
        ended.set()
        thread.join()
    assert len(commands) == 1
    assert PROGRAM in commands.pop()


def command_of(process: int) -> str:
    """The command line of a process, or of its parent if it was forked."""
    return Path(f'/proc/{process}/cmdline').read_text().replace('\0', ' ')


def job(path: Path, *formulas: str) -> RecordingJob:
    requested = tuple(map(RequestedFormula, formulas or FORMULAS))
    return RecordingJob(str(path), path, requested, MonitoringFiles())


def test_errors_are_those_of_the_job_where_dask_is_imported(bags: list[str]) -> None:
    """Dask pickles errors with their tracebacks, which may hold what cannot be pickled."""
    pytest.importorskip('distributed')
    with run_in_processes([job(Path(bags[0]), 'always (')], 1) as results:
        [(_, report)] = results
    assert 'unexpected end' in repr(report)
