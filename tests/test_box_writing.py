"""Boxes that are being written, or wait, when the recorder stops."""

from __future__ import annotations

from pathlib import Path
from threading import Event

from rclpy.task import Future

from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_reactions.black_box.failures import FormulaFailure, OpenBox
from dyknow_reactions.ros.black_box.box_writing import BoxWriting
from system import Client


def box_of(name: str) -> OpenBox:
    status = EvaluationStatus(name, 'a.b < 1', EvaluationPhase.RUNNING, 0)
    return OpenBox((name, 0), FormulaFailure('false', 0), status, 0, 1, 1)


def ended() -> Future:
    search: Future = Future()
    search.set_result(None)
    return search


def test_a_stop_waits_for_the_box_that_is_being_written(client: Client) -> None:
    """Another write would remove its draft; those that wait are returned."""
    has_begun, go_on = Event(), Event()
    written: list[str] = []

    def write(name: str) -> Path:
        has_begun.set()
        go_on.wait()
        written.append(name)
        return Path(name)

    writing = BoxWriting(client.node)
    client.executor.create_task(writing.write, box_of('first'), ended(), lambda: write('first'))
    client.spin_until(has_begun.is_set, 'the begin')
    client.executor.create_task(writing.write, box_of('second'), ended(), lambda: write('second'))
    client.executor.spin_once(timeout_sec=0.0)
    assert writing.stop(0.0) is None
    go_on.set()
    waiting = writing.stop(10.0)
    assert written == ['first']
    assert waiting is not None
    assert [each.key[0] for each in waiting] == ['second']


def test_boxes_are_written(client: Client) -> None:
    written: list[Path] = []
    writing = BoxWriting(client.node)

    async def write(name: str) -> None:
        written.append(await writing.write(box_of(name), ended(), lambda: Path(name)))

    for name in ('a', 'b'):
        client.executor.create_task(write, name)
    client.spin_until(lambda: len(written) == 2, 'both boxes')
    assert sorted(written) == [Path('a'), Path('b')]
    assert writing.stop(10.0) == {}


def test_a_stop_returns_the_box_whose_search_has_not_ended(client: Client) -> None:
    """It would be lost without a word: the recorder has forgotten the formula by then."""
    writing, box, search = BoxWriting(client.node), box_of('a'), Future()
    client.executor.create_task(writing.write, box, search, lambda: Path('a'))
    client.executor.spin_once(timeout_sec=0.0)
    assert list(writing.stop(10.0) or ()) == [box]
