"""Log lines of nodes on the terminal."""

import tempfile
from contextlib import suppress
from pathlib import Path

import pytest

from dyknow_bringup.processes.logs import (
    MAX_RECORDS,
    PERIOD_NS,
    LogReader,
    LogRecord,
    LogThrottle,
    last_lines,
    log_folder,
)
from dyknow_common import DyKnowError


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return tmp_path / 'node.log'


def write(log: Path, text: str) -> None:
    with log.open('a', encoding='utf-8') as file:
        file.write(text)


def test_warnings_and_errors_are_read_with_all_their_lines(log: Path) -> None:
    reader = LogReader(log)
    assert reader.read() == ()
    write(
        log,
        '[INFO] [1.5] [a]: started\n  with details\n'
        '[WARN] [1.6] [robot1.a]: late\n'
        '[ERROR] [1.7] [a]: unknown unit:\n  x\n  ^\n'
        '[INFO] [1.8] [a]: more\n',
    )
    assert reader.read() == (
        LogRecord('WARN', 'late', 'robot1.a'),
        LogRecord('ERROR', 'unknown unit:\n  x\n  ^', 'a'),
    )
    assert reader.read() == ()


def test_incomplete_lines_wait(log: Path) -> None:
    reader = LogReader(log)
    write(log, '[ERROR] [1.7] [a]: bro')
    assert reader.read() == ()
    write(log, 'ken\n')
    assert reader.read() == (LogRecord('ERROR', 'broken', 'a'),)
    write(log, '  really\n')
    assert reader.read() == (LogRecord('ERROR', 'really', 'a'),)


def test_faults_of_python_are_errors(log: Path) -> None:
    reader = LogReader(log)
    write(log, '[INFO] [1.5] [a]: started\nTraceback (most recent call last):\n  f\nKeyError\n')
    assert reader.read() == (
        LogRecord('ERROR', 'Traceback (most recent call last):\n  f\nKeyError'),
    )


def test_tracebacks_of_all_threads_are_one_error(log: Path) -> None:
    reader = LogReader(log)
    tracebacks = 'Thread 0x1 (most recent call first):\n  f\nCurrent thread 0x2 (most recent):\n  g'
    write(log, f'[INFO] [1.5] [a]: started\n{tracebacks}\n')
    assert reader.read() == (LogRecord('ERROR', tracebacks),)


def test_what_a_log_contains_already_is_skipped(log: Path) -> None:
    write(log, '[ERROR] [1.5] [a]: old\n')
    assert LogReader(log).read() == ()


def test_a_flood_is_limited_and_counted() -> None:
    throttle = LogThrottle()
    shown = [throttle.admit('a', LogRecord('WARN', str(n)), n) for n in range(MAX_RECORDS + 7)]
    assert shown.count(True) == MAX_RECORDS
    assert throttle.admit('b', LogRecord('WARN', 'another node'), 50)
    assert list(throttle.left_out(50)) == []
    assert list(throttle.left_out(PERIOD_NS)) == [('a', 7)]
    assert list(throttle.left_out(PERIOD_NS)) == []
    assert throttle.admit('a', LogRecord('WARN', 'later'), PERIOD_NS)


def test_a_record_is_shown_once_in_a_period() -> None:
    throttle, record = LogThrottle(), LogRecord('WARN', 'late')
    assert [throttle.admit('a', record, now) for now in range(3)] == [True, False, False]
    assert list(throttle.left_out(PERIOD_NS)) == [('a', 2)]
    assert throttle.admit('a', record, PERIOD_NS)


def test_the_last_lines_are_what_a_node_printed_beside_its_records(log: Path) -> None:
    write(log, '[INFO] [1.5] [a]: started\nno such unit\n  ^\n')
    assert last_lines(log.read_text()) == 'no such unit\n  ^'
    write(log, '[INFO] [1.6] [a]: ended\n')
    assert last_lines(log.read_text()).endswith('[a]: ended')


@pytest.mark.parametrize(
    ('end', 'is_left'),
    [(None, False), (KeyboardInterrupt(), False), (DyKnowError('a node has ended'), True)],
)
def test_only_an_error_leaves_temporary_logs(
    end: BaseException | None, *, is_left: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path))
    with suppress(KeyboardInterrupt, DyKnowError), log_folder(None) as folder:
        assert folder.parent == tmp_path
        if end is not None:
            raise end
    assert folder.exists() == is_left
