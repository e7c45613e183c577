"""Boxes in their folder: complete, bounded, and nothing else is touched."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, StreamConstraints
from dyknow_coordinator import EvaluationPhase, EvaluationStatus, KnownStream, KnownStreams
from dyknow_reactions.black_box import box_folder
from dyknow_reactions.black_box.box_content import (
    FormulaOrigin,
    RecordedStateNumber,
    StateOrigin,
    content_of,
    first_state,
    lack_of_messages,
    objects_fault,
    state_origin,
    stream_text,
)
from dyknow_reactions.black_box.box_folder import BoxFolder, TopicOffer
from dyknow_reactions.black_box.failures import FormulaFailure, OpenBox
from dyknow_reactions.black_box.message_ring import SerialisedMessage
from dyknow_recordings import Bag, BlackBoxContent, horizon, read_black_box
from dyknow_stream_processing import parse_specification, specifications_by_sink

S = SECOND_NS
CONTENT = BlackBoxContent('too fast', 'a.b < 1')
TOPICS = {'/a': TopicOffer('std_msgs/msg/Bool', ((True, False, 10),))}
MESSAGES = [SerialisedMessage(number, '/a', b'\x00\x01\x00\x00\x01') for number in (5, 7)]


def test_a_box_is_a_bag(tmp_path: Path) -> None:
    folder = BoxFolder(tmp_path / 'new' / 'boxes', '/robot/recorder', 10**9, 5)
    path = folder.write(CONTENT, 1_000_000_000 * S, MESSAGES, TOPICS)
    assert path == tmp_path / 'new' / 'boxes' / '2001-09-09T01-46-40_too_fast'
    assert folder.write(CONTENT, 1_000_000_000 * S, MESSAGES, TOPICS).name == f'{path.name}_2'
    assert read_black_box(path) == read_black_box(path / f'{path.name}.mcap')
    with Bag(path) as bag:
        assert [(each.log_time, each.data) for each in bag.messages()] == [
            (each.time, each.data) for each in MESSAGES
        ]
        assert bag.contents['/a'].publishers == 1
        assert bag.faults == ()
    assert {each.name for each in path.parent.iterdir()} == {path.name, f'{path.name}_2'}


def test_the_oldest_boxes_make_room_and_other_files_stay(tmp_path: Path) -> None:
    (tmp_path / 'mine').mkdir()
    (tmp_path / 'mine' / 'mine.mcap').write_bytes(b'x')
    (tmp_path / 'mine' / 'metadata.yaml').write_text('other')
    folder = BoxFolder(tmp_path, 'a', 10**9, 2)
    paths = [folder.write(CONTENT, number * S, MESSAGES, TOPICS) for number in range(4)]
    assert [path.exists() for path in paths] == [False, False, True, True]
    assert folder.removed == 2
    assert (tmp_path / 'mine' / 'mine.mcap').exists()


def test_the_bytes_of_a_folder_are_bounded(tmp_path: Path) -> None:
    folder = BoxFolder(tmp_path, 'a', 120_000, 50)
    paths = [folder.write(CONTENT, number * S, MESSAGES, TOPICS) for number in range(10)]
    size = sum(each.stat().st_size for each in tmp_path.rglob('*') if each.is_file())
    assert size <= 120_000
    assert folder.removed == sum(not path.exists() for path in paths) > 0


def test_what_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    assert not BoxFolder(tmp_path / 'new' / 'boxes', 'a', 10**9, 5).fault
    (tmp_path / 'file').write_text('')
    folder = BoxFolder(tmp_path / 'file' / 'boxes', 'a', 10**9, 5)
    assert folder.fault == f'no black box can be written: {tmp_path}/file is no writable folder'
    with pytest.raises(
        DyKnowError, match=r'cannot write to .*file/boxes: Not a directory'
    ) as error:
        folder.write(CONTENT, 0, MESSAGES, TOPICS)
    assert error.value.code is ExitCode.UNAVAILABLE
    with pytest.raises(DyKnowError, match=r"the limit 'folder_bytes'"):
        BoxFolder(tmp_path, 'a', 10, 5).write(CONTENT, 0, MESSAGES, TOPICS)


def test_a_full_disk_is_an_error_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(Writer, 'write', full)
    with pytest.raises(DyKnowError, match=r'cannot write to .*: No space left on device'):
        BoxFolder(tmp_path, 'a', 10**9, 5).write(CONTENT, 0, MESSAGES, TOPICS)
    assert list(tmp_path.iterdir()) == []


def test_a_type_without_a_definition_is_an_error(tmp_path: Path) -> None:
    topics = {'/a': TopicOffer('no_such/msg/Type', ())}
    with pytest.raises(DyKnowError, match='no_such/msg/Type is not defined; install its package'):
        BoxFolder(tmp_path, 'a', 10**9, 5).write(CONTENT, 0, MESSAGES, topics)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('progressed', 'latest', 'expected'),
    [
        (3, 30, (10, True)),
        (2, 30, (20, True)),
        (5, 30, (10, False)),
        (3, 99, (20, False)),
        (0, None, (20, False)),
    ],
)
def test_the_first_recorded_state(
    progressed: int, latest: int | None, expected: tuple[int, bool]
) -> None:
    states = [RecordedStateNumber(7, number, (number - 3) * 10) for number in (4, 5, 6, 7)]
    assert first_state(states, progressed, latest, 15) == expected


def test_no_recorded_state() -> None:
    assert first_state([], 3, 30, 0) == (None, False)


@pytest.mark.parametrize(
    'specification',
    [
        'stream s = select x as y from "/a";\nsink s',
        'select x as y from "b"',
        'stream t = select x as y from "/a";\nstream s = t with max_gap = 2 s;\nsink s',
        'sink sync("/a", u)',
    ],
)
def test_the_text_of_a_stream_has_it_for_its_sink(specification: str) -> None:
    added = StreamConstraints(max_delay=S)
    text = stream_text(KnownStream('s', specification, constraints=added), '/robot')
    (name,) = specifications_by_sink(parse_specification(text))
    assert name == 's'
    assert 'max_delay = 1 s' in text
    assert '"b"' not in text


def test_what_states_are_made_of() -> None:
    known = KnownStreams(
        [
            KnownStream('states', 'stream f = select p as F from a;\nsink sync(f)'),
            KnownStream('a', 'stream a = select x as p from b;\nsink a'),
            KnownStream('b', topic='/other/topic'),
            KnownStream('c', 'select x from "/c"'),
        ],
        lambda _: True,
    )
    found = state_origin('/dyknow/streams/states', known, '/')
    assert found is not None
    assert found.streams == (
        'stream a = select x as p from b;\nsink a',
        'stream b = "/other/topic";\nsink b',
    )
    assert objects_fault('F[o] < 1', {}, found.states) != ''
    assert objects_fault('F < 1', {}, found.states) == ''
    assert state_origin('/dyknow/streams/none', known, '/') is None


@pytest.mark.parametrize(
    ('formula', 'expected'),
    [
        ('always a.b < 1', 0),
        ('forall u in UAV: always (P[u] -> eventually[0 s, 5 s] Q[u])', 5),
        ('always (P -> (Q until[0 s, 5 s] always[0 s, 3 s] Q))', 8),
        ('always (P -> once[0 s, 2 s] Q)', 2),
        ('always (P -> eventually Q)', 0),
    ],
)
def test_the_horizon_of_a_formula(formula: str, expected: int) -> None:
    assert horizon(formula) == expected * S


def test_a_box_says_that_its_objects_are_unknown() -> None:
    """It is written nevertheless: the messages may be all that is left of a failure."""
    status = EvaluationStatus(
        'low', 'forall u in UAV: (always (Power[u] < 1))', EvaluationPhase.RUNNING, S
    )
    box = OpenBox(('low', S), FormulaFailure('false', 9 * S), status, 5 * S, 9 * S, 9 * S)
    origin = FormulaOrigin(status, origin=StateOrigin('select x as "Power[a]" from "/a"'))
    origin.objects_fault = 'the ontology manager does not answer'
    content = content_of(box, origin, [], {}, {})
    assert (content.domains, list(content.faults)) == ({}, [origin.objects_fault])


def test_the_box_of_a_formula_is_found(tmp_path: Path) -> None:
    folder = BoxFolder(tmp_path / 'boxes', 'a', 10**9, 5)
    assert not folder.has_box(CONTENT.name, 0)
    path = folder.write(CONTENT, 0, [], {})
    written = path.stat().st_mtime_ns
    assert folder.has_box(CONTENT.name, written)
    assert not folder.has_box(CONTENT.name, written + 1)
    assert not folder.has_box(f'{CONTENT.name} 2', 0)


@pytest.mark.parametrize(
    ('formula', 'decided_at', 'first', 'is_told'),
    [
        # Recorded from 20 s on.
        ('always a.b < 1', 19 * S, None, True),
        ('always a.b < 1', 21 * S, None, False),
        ('always (P -> eventually[0 s, 2 s] Q)', 21 * S, None, True),
        ('always (P -> eventually[0 s, 2 s] Q)', 21 * S, 19 * S, True),
        ('always (P -> eventually[0 s, 2 s] Q)', 21 * S, 20 * S, False),
        ('a text that is too long for a rep...', 19 * S, None, True),
        ('always a.b < 1', None, None, False),
    ],
)
def test_a_failure_from_before_the_recording_is_told(
    formula: str, decided_at: int | None, first: int | None, *, is_told: bool
) -> None:
    failure = FormulaFailure('false', 22 * S, decided_at)
    text = lack_of_messages(formula, failure, first, 20 * S)
    assert text.startswith('the topics of the formula are recorded from 20.000 s on') == is_told


def test_a_limit_of_the_file_system_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    """As a full disk is, but of the kernel: also the end of the bag cannot be written."""
    # Random bytes cannot be compressed.
    noise = [SerialisedMessage(number, '/a', os.urandom(1000)) for number in range(300)]
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
    try:
        with pytest.raises(DyKnowError, match=r'cannot write to .*: File too large'):
            BoxFolder(tmp_path, 'a', 10**9, 5).write(CONTENT, 0, noise, TOPICS)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert list(tmp_path.iterdir()) == []


def test_other_readers_see_all_topics_with_their_qualities(tmp_path: Path) -> None:
    topics = {
        '/a': TopicOffer('std_msgs/msg/Bool', ((True, True, 1), (False, False, 10))),
        '/b': TopicOffer('nav_msgs/msg/Odometry', ((False, False, 5),)),
        # Without a message in the time of the box.
        '/c': TopicOffer('sensor_msgs/msg/Image', ((True, False, 0),)),
    }
    path = BoxFolder(tmp_path, 'a', 10**9, 5).write(CONTENT, S, MESSAGES, topics)
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        found = {each.topic: each for each in reader.connections}
        assert {name: each.msgtype for name, each in found.items()} == {
            name: each.message_type for name, each in topics.items()
        }
        assert [reader.deserialize(data, each.msgtype).data for each, _, data in reader.messages()]
    profiles = {
        name: [
            (
                each.reliability is QosReliability.RELIABLE,
                each.durability is QosDurability.TRANSIENT_LOCAL,
                each.depth,
            )
            for each in connection.ext.offered_qos_profiles
        ]
        for name, connection in found.items()
    }
    assert profiles == {name: list(each.offers) for name, each in topics.items()}


def test_two_recorders_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both write a box of one name in one second; the other one is faster."""
    write, paths = Writer.write, list[Path]()

    def write_and_be_overtaken(*arguments: Any) -> None:
        if not paths:
            monkeypatch.undo()
            other = BoxFolder(tmp_path, '/robot2/recorder', 10**9, 5)
            paths.append(other.write(CONTENT, 0, MESSAGES, TOPICS))
        write(*arguments)

    monkeypatch.setattr(Writer, 'write', write_and_be_overtaken)
    folder = BoxFolder(tmp_path, '/robot1/recorder', 10**9, 5)
    paths.append(folder.write(CONTENT, 0, MESSAGES, TOPICS))
    assert set(tmp_path.iterdir()) == set(paths)
    for path in paths:
        with Bag(path) as bag:
            assert len(list(bag.messages())) == len(MESSAGES)


def test_a_box_that_another_recorder_removes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = BoxFolder(tmp_path, 'a', 10**9, 1)
    folder.write(CONTENT, 0, MESSAGES, TOPICS)
    is_removed: list[bool] = []

    def remove_twice(path: Path, **options: Any) -> None:
        rmtree(path, **options)
        if not path.name.startswith('.'):
            is_removed.append(True)
            rmtree(path, **options)

    rmtree = shutil.rmtree
    monkeypatch.setattr(box_folder.shutil, 'rmtree', remove_twice)
    path = folder.write(CONTENT, 1, MESSAGES, TOPICS)
    assert is_removed
    assert list(tmp_path.iterdir()) == [path]
