"""The history of failures: what reports add to it, and what its file survives."""

from __future__ import annotations

import asyncio
import sqlite3
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Verdict
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, StandingVerdicts, ViolationEpisode
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model import history as history_module
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.history import (
    MAX_AGE_NS,
    MAX_WAITING,
    HistoryQuery,
    acknowledge,
    clear,
    failures,
    junit,
)

NOW = 1_790_000_000 * SECOND_NS
RUNNING = EvaluationStatus('power', 'always p', EvaluationPhase.RUNNING, started=NOW - SECOND_NS)
FAILED = replace(
    RUNNING,
    phase=EvaluationPhase.ENDED,
    verdict=Verdict.FALSE,
    decided_at=NOW,
    explanation='Power[uav2] = 170 is not < 150',
)
LOST_STREAM = replace(
    RUNNING,
    name='speed',
    phase=EvaluationPhase.ENDED,
    latest_valid_time=NOW,
    error=DyKnowError('/odom is silent', ExitCode.CONSTRAINT_VIOLATION),
)


class Clock:
    """The time of a board."""

    def __init__(self) -> None:
        self.now = NOW

    def __call__(self) -> int:
        return self.now


class Kept:
    """A board with a history, used from one thread."""

    def __init__(self, path: Path | None) -> None:
        self.clock = Clock()
        self.board = Board(self.clock, path)
        self.loop = asyncio.new_event_loop()

    def report(self, *statuses: EvaluationStatus) -> None:
        self.board.report(statuses, NOW)

    def do(self, work: Any) -> Any:
        return self.loop.run_until_complete(self.board.history.do(work))

    def rows(self, **query: Any) -> list[dict[str, Any]]:
        return list(self.do(lambda file: failures(file, HistoryQuery(**query))))

    def names(self, **query: Any) -> list[str]:
        return [each['name'] for each in self.rows(**query)]

    def close(self) -> None:
        self.loop.run_until_complete(self.board.history.close())
        self.loop.close()


@contextmanager
def kept(path: Path | None) -> Iterator[Kept]:
    with closing(Kept(path)) as found:
        yield found


def standing(*begins: int, count: int | None = None, ended: bool = True) -> EvaluationStatus:
    """A formula that is asked at every state, with episodes that begin at these seconds."""
    episodes = tuple(
        ViolationEpisode(
            NOW + at * SECOND_NS,
            NOW + at * SECOND_NS + 1,
            NOW + at * SECOND_NS,
            2,
            True,
            f'at {at}',
        )
        for at in begins
    )
    if not ended:
        episodes = (*episodes[:-1], replace(episodes[-1], has_ended=False))
    verdicts = StandingVerdicts(
        fails=2 * len(begins),
        is_violated=not ended,
        episode_count=len(begins) if count is None else count,
        latest_episodes=episodes,
    )
    return replace(RUNNING, name='standing', episodes=verdicts)


def test_a_failure_is_kept_over_restarts_and_once(tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'history.db'
    with kept(path) as first:
        first.report(RUNNING)
        assert first.rows() == []
        first.report(FAILED, LOST_STREAM)
        first.report(FAILED, LOST_STREAM)
        assert len(first.rows()) == 2
        assert first.board.counts['history', 'written'] == 2
        assert path.stat().st_mode & 0o777 == 0o600
    with kept(path) as second:
        second.report(FAILED, LOST_STREAM)
        speed, power = second.rows()
        assert second.board.counts['history', 'written'] == 0
        assert second.board.counts['history', 'known already'] == 2
        assert power == {
            'id': 1,
            'name': 'power',
            'formula': 'always p',
            'event': 'false',
            'verdict': 'false',
            'started': NOW - SECOND_NS,
            'valid_time': NOW,
            'known_at': NOW,
            'explanation': 'Power[uav2] = 170 is not < 150',
            'acknowledged_by': None,
            'acknowledged_at': None,
        }
        assert (speed['event'], speed['verdict']) == ('violation', 'constraint violation')
        assert (speed['valid_time'], speed['explanation']) == (NOW, '/odom is silent')
        second.report(RUNNING)
        second.report(FAILED)
        assert second.names() == ['power', 'speed', 'power'], 'it was seen to fail again'


@pytest.mark.parametrize(
    'status',
    [
        replace(FAILED, verdict=Verdict.TRUE),
        replace(LOST_STREAM, error=DyKnowError('', ExitCode.CANCELLED)),
        replace(LOST_STREAM, error=DyKnowError('', ExitCode.TIMEOUT)),
        replace(standing(), phase=EvaluationPhase.ENDED),
    ],
)
def test_ends_that_are_no_failures(tmp_path: Path, status: EvaluationStatus) -> None:
    with kept(tmp_path / 'a.db') as found:
        found.report(status)
        assert found.rows() == []


def test_each_episode_is_a_failure(tmp_path: Path) -> None:
    with kept(tmp_path / 'a.db') as found:
        events: list[Any] = []
        found.board.sinks.append(events.extend)
        found.report(standing(1, ended=False))
        found.report(standing(1))
        found.report(standing(1, 2, 3))
        found.report(replace(standing(1, 2, 3), phase=EvaluationPhase.ENDED))
        assert [each['explanation'] for each in found.rows()] == ['at 3', 'at 2', 'at 1']
        assert [each.event for each in events] == [
            'false', 'clear', 'false', 'clear', 'false', 'clear'
        ]  # fmt: skip
        found.report(standing(*range(20, 30), count=20), FAILED)
        assert found.board.counts['report', 'more episodes than it names'] == 7
    with kept(tmp_path / 'a.db') as again:
        again.report(standing(*range(20, 30), count=20))
        assert len(again.rows()) == 14


def test_an_evaluation_that_was_lost_has_failed(tmp_path: Path) -> None:
    unnamed = replace(RUNNING, name='p', formula='p', phase=EvaluationPhase.GROUNDING)
    with kept(tmp_path / 'a.db') as found:
        found.report(RUNNING, unnamed)
        found.report(replace(unnamed, formula='(p)'))
        (lost,) = found.rows()
        assert (lost['name'], lost['verdict']) == ('power', 'unavailable')
        assert 'the coordinator no longer reports it' in lost['explanation']


def attempt(number: int, states: int = 0, code: ExitCode | None = None) -> EvaluationStatus:
    """An evaluation of one formula, the later ones of which are retries."""
    started = RUNNING.started + number * SECOND_NS
    status = replace(LOST_STREAM, started=started, states_progressed=states)
    if code is None:
        return replace(status, phase=EvaluationPhase.RUNNING, error=None)
    return replace(status, error=DyKnowError(f'attempt {number}', code))


def test_a_retry_that_fails_at_its_first_state_is_no_new_failure(tmp_path: Path) -> None:
    violation = ExitCode.CONSTRAINT_VIOLATION
    with kept(tmp_path / 'history.db') as found:
        found.report(attempt(0, 5, violation))
        for number in range(1, 90):
            # The coordinator reports an error until the formula is evaluated again.
            found.report(attempt(number))
            code = violation if number % 7 else ExitCode.UNAVAILABLE
            found.report(attempt(number, number % 2, code))
        (row,) = found.rows()
        assert row['explanation'] == 'attempt 0'


@pytest.mark.parametrize(
    'between',
    [
        [attempt(1, 1)],
        [attempt(1, 2, ExitCode.CONSTRAINT_VIOLATION)],
        [attempt(1, 0, ExitCode.CANCELLED)],
    ],
)
def test_a_failure_after_a_state_is_a_new_one(
    tmp_path: Path, between: list[EvaluationStatus]
) -> None:
    with kept(tmp_path / 'history.db') as found:
        found.report(attempt(0, 5, ExitCode.CONSTRAINT_VIOLATION))
        found.report(*between)
        found.report(attempt(1, 1, ExitCode.CONSTRAINT_VIOLATION))
        found.report(attempt(2, 0, ExitCode.CONSTRAINT_VIOLATION))
        assert len(found.rows()) == 2


def test_old_failures_are_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(history_module, 'MAX_FAILURES', 3)
    with kept(tmp_path / 'a.db') as found:
        found.report(*(replace(FAILED, name=str(number)) for number in range(5)))
        assert found.names() == ['4', '3', '2']
        found.clock.now += MAX_AGE_NS + 1
        assert found.names() == []
        assert found.board.counts['history', 'removed, as too old or too many'] == 5
        found.report(LOST_STREAM)
        assert [each['id'] for each in found.rows()] == [6], 'ids are not used again'


def test_failures_are_acknowledged_then_cleared(tmp_path: Path) -> None:
    with kept(tmp_path / 'a.db') as found:
        found.report(FAILED, LOST_STREAM)
        assert len(found.rows()) == 2
        assert found.do(lambda file: acknowledge(file, [1, 9], 'Ada', NOW + 1)) == 1
        with pytest.raises(DashboardError, match=r"failure 2 of 'speed' is not .*; acknowledge it"):
            found.do(lambda file: clear(file, [1, 2]))
        assert found.do(lambda file: acknowledge(file, [1], 'Bob', NOW + 2)) == 0
        state = found.board.history.state
        assert (state.count, state.unacknowledged, state.fault) == (2, 1, '')
        seen = found.rows()[1]
        assert (seen['acknowledged_by'], seen['acknowledged_at']) == ('Ada', NOW + 1)
        assert found.do(lambda file: clear(file, [1, 9])) == 1
        assert found.names() == ['speed']
        assert found.board.history.state.version > state.version


NAMES = st.text('aÄß%_', max_size=3)


@given(
    st.lists(st.tuples(NAMES, st.integers(0, 5)), max_size=12),
    st.integers(0, 5),
    st.integers(0, 6),
    NAMES,
    st.integers(1, 13),
    st.integers(0, 13),
)
def test_the_filter_is_that_of_lists(
    tmp_path_factory: pytest.TempPathFactory,
    events: list[tuple[str, int]],
    since: int,
    until: int,
    name: str,
    before: int,
    limit: int,
) -> None:
    with kept(tmp_path_factory.mktemp('history') / 'a.db') as found:
        for number, (text, at) in enumerate(events):
            found.clock.now = NOW + at
            found.report(replace(FAILED, name=text, started=number))
            found.rows()
        expected = [
            (number + 1, text)
            for number, (text, at) in enumerate(events)
            if since <= at < until and name.casefold() in text.casefold() and number + 1 < before
        ]
        rows = found.rows(
            since=NOW + since, until=NOW + until, name=name, before_id=before, limit=limit
        )
        assert [(each['id'], each['name']) for each in rows] == expected[::-1][:limit]


@pytest.mark.parametrize(
    ('content', 'message'),
    [(b'no database' * 100, 'it is damaged or of another kind'), (None, 'it is no regular file')],
)
def test_a_damaged_file(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / 'history.db'
    if content is None:
        path.symlink_to('/dev/null')
    else:
        path.write_bytes(content)
    with kept(path) as found:
        found.report(FAILED)
        with pytest.raises(DashboardError, match=f"history of failures '{path}': .*{message}"):
            found.rows()
        state = found.board.history.state
        assert message in state.fault
        path.unlink()
        assert found.names() == ['power'], 'it has waited'
        assert found.board.history.state.fault == ''
        assert found.board.history.state.version > state.version


def test_a_locked_file(tmp_path: Path) -> None:
    path = tmp_path / 'history.db'
    with kept(path) as owner, kept(path) as found:
        assert owner.rows() == []
        found.report(FAILED)
        with pytest.raises(DashboardError, match=r'another .* with --history FILE') as caught:
            found.rows()
        assert caught.value.code is ExitCode.UNAVAILABLE
        owner.close()
        owner.__init__(None)  # type: ignore[misc]
        assert found.names() == ['power']


def test_a_file_of_another_program(tmp_path: Path) -> None:
    path = tmp_path / 'other.db'
    with closing(sqlite3.connect(path)) as other:
        other.execute('CREATE TABLE letter (text)')
    content = path.read_bytes()
    with kept(path) as found, pytest.raises(DashboardError, match='it has the tables letter'):
        found.rows()
    assert path.read_bytes() == content


def test_too_many_failures_wait(tmp_path: Path) -> None:
    with kept(tmp_path) as found:
        found.report(*(replace(FAILED, name=str(number)) for number in range(MAX_WAITING + 3)))
        assert found.board.counts['history', 'too many wait'] == 3
        with pytest.raises(DashboardError):
            found.rows()


def test_no_history() -> None:
    with kept(None) as found:
        found.report(FAILED)
        with pytest.raises(DashboardError, match='--history none'):
            found.rows()


def test_junit_of_the_history(tmp_path: Path) -> None:
    with kept(tmp_path / 'a.db') as found:
        empty = ET.fromstring(found.do(lambda file: junit(file, HistoryQuery())))  # noqa: S314
        assert (empty.get('tests'), empty.get('failures')) == ('0', '0')
        found.report(FAILED, LOST_STREAM)
        found.rows()
        found.do(lambda file: acknowledge(file, [1], 'Ada', NOW))
        document = ET.fromstring(found.do(lambda file: junit(file, HistoryQuery())))  # noqa: S314
        (suite,) = document
        assert (suite.get('tests'), suite.get('failures'), suite.get('errors')) == ('2', '1', '1')
        power, speed = suite.iter('testcase')
        failure = power.find('failure')
        assert (power.get('name') or '').startswith('power at 20')
        assert failure is not None
        assert (failure.text or '').splitlines()[0] == FAILED.explanation
        assert 'acknowledged by Ada at ' in (failure.text or '')
        error = speed.find('error')
        assert error is not None
        assert (error.get('type'), error.get('message')) == (
            'CONSTRAINT_VIOLATION',
            '/odom is silent',
        )
