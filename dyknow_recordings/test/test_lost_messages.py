"""Recordings with known damage: no verdict depends on messages that are lost."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from backports import zstd
from hypothesis import given
from hypothesis import strategies as st
from running_checks import run_check
from small_bags import (
    START,
    channel,
    chunk,
    database,
    indexed_mcap,
    mcap,
    schema,
    stored,
)

from dyknow_common import NANOSECONDS
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.bags.bag import Bag
from dyknow_recordings.reading.recording import MISSING

pytestmark = pytest.mark.long

STEP = 100 * NANOSECONDS['ms']
DEFINITION = 'int32 x\n'
NUMBER = schema(1, 'made_up/msg/Number', DEFINITION) + channel(1, 1, '/x')
COUNT, PER_CHUNK = 40, 10
EARLY, LOST, LATE = 4, 17, 33
"""The numbers of the messages with the values 2, 9 and 3; the others have the value 1."""

VALUES = {EARLY: 2, LOST: 9, LATE: 3}
DEPENDS = 'the verdict depends on messages that are lost'
Records = list[bytes]


def payload(number: int) -> bytes:
    return b'\0\1\0\0' + struct.pack('<i', VALUES.get(number, 1))


def messages(*, with_sequence: bool = False) -> Records:
    return [
        stored(1, START + number * STEP, payload(number), number + 1 if with_sequence else 0)
        for number in range(COUNT)
    ]


def file_of(
    records: Records,
    compression: str = '',
    *,
    checksum: bool = True,
    change: Callable[[bytes], bytes] = bytes,
) -> bytes:
    """A file of chunks; the second one is changed, and `change` keeps its length."""
    chunks = []
    for first in range(0, COUNT, PER_CHUNK):
        part = records[first : first + PER_CHUNK]
        times = START + first * STEP, START + (first + PER_CHUNK - 1) * STEP
        content = chunk([NUMBER, *part], times, compression, checksum=checksum)
        if first == PER_CHUNK:
            content = change(content)
        chunks.append((content, times, {1: sum(map(bool, part))}))
    return indexed_mcap(NUMBER, chunks)


def with_byte(at: int, value: int = 0xFF) -> Callable[[bytes], bytes]:
    """Return a change of one byte."""

    def change(data: bytes) -> bytes:
        changed = bytearray(data)
        changed[at] ^= value
        return bytes(changed)

    return change


def with_fewer_bytes(data: bytes) -> bytes:
    """State half of the size that a chunk has without compression."""
    (size,) = struct.unpack_from('<Q', data, 25)
    return data[:25] + struct.pack('<Q', size // 2) + data[33:]


def swallowing(data: bytes) -> bytes:
    """Let the record before the violation end with the chunk."""
    at = data.index(stored(1, START + (LOST - 1) * STEP, payload(LOST - 1)))
    return data[: at + 1] + struct.pack('<Q', len(data) - at - 9) + data[at + 9 :]


def cut_content(data: bytes) -> bytes:
    """Leave out the end of the content of a chunk, which is compressed."""
    head, content = data[:53], data[53:]
    half = content[: len(content) // 2]
    body = head[9:45] + struct.pack('<Q', len(half)) + half
    return struct.pack('<BQ', 6, len(body)) + body


def short_message() -> Records:
    records = messages()
    records[LOST] = stored(1, START + LOST * STEP, payload(LOST)[:6])
    return records


def missing_numbers() -> Records:
    records = messages(with_sequence=True)
    records[LOST] = b''
    return records


MCAP: dict[str, tuple[Callable[[], bytes], str]] = {
    'a wrong checksum': (lambda: file_of(messages(), change=with_byte(100)), 'is damaged'),
    'cut zstd': (lambda: file_of(messages(), 'zstd', change=cut_content), 'is damaged'),
    'cut zstd without checksum': (
        lambda: file_of(messages(), 'zstd', checksum=False, change=cut_content),
        'is incomplete',
    ),
    'flipped zstd': (lambda: file_of(messages(), 'zstd', change=with_byte(-20)), 'is damaged'),
    'flipped lz4': (lambda: file_of(messages(), 'lz4', change=with_byte(-20)), 'is damaged'),
    'unknown compression': (
        lambda: file_of(messages(), 'zstd', change=lambda data: data.replace(b'zstd', b'zst9')),
        'is compressed by zst9, not by zstd or lz4',
    ),
    'fewer bytes than it holds': (
        lambda: file_of(messages(), 'zstd', checksum=False, change=with_fewer_bytes),
        'holds more bytes than it states',
    ),
    'a record that swallows others': (
        lambda: file_of(messages(), checksum=False, change=swallowing),
        'holds 7 messages, not 10 as in its index',
    ),
    'no chunk': (lambda: file_of(messages(), change=with_byte(0)), 'a chunk is damaged'),
    'a short message': (lambda: file_of(short_message()), 'a message is shorter than its type'),
    'sequence numbers': (
        lambda: file_of(missing_numbers()),
        'a message is missing by the sequence numbers',
    ),
}


def check(path: Path, formula: str, *options: str) -> tuple[int, dict[str, Any], list[str]]:
    """Return the exit code, the document of the formula, and the notes."""
    found = run_check(path, '--formula', formula, '--json', *options)
    document = found.document
    assert document['error'] is None
    return found.code, document['formulas'][0], document['notes']


def check_lost(path: Path, reason: str) -> None:
    """Check formulas over a recording that has lost the violation."""
    for formula in ('always "/x".x < 5', 'always[0 s, 2 s] "/x".x < 5', 'eventually "/x".x > 5'):
        code, found, notes = check(path, formula)
        assert (code, found['outcome']) == (2, 'error'), formula
        error = found['error'] or found['episodes'][0]['error']
        assert DEPENDS in error['message']
        assert reason in error['message']
        assert 'between 17000000' in error['message'] or 'from 17000000' in error['message']
        assert any(reason in note for note in notes)
    for every in ('state', '"/x".x = 2'):
        code, found, _ = check(path, 'always "/x".x < 5', '--every', every)
        assert (code, found['outcome']) == (2, 'error'), every
        assert reason in found['error']['message']


def check_kept(path: Path) -> None:
    """Check formulas that are certain in spite of the damage."""
    for formula, outcome in (
        ('always "/x".x != 2', 'false'),
        ('eventually "/x".x = 2', 'true'),
        ('always[0 s, 800 ms] "/x".x < 5', 'true'),
        ('always "/x".x != 3', 'false'),
        ('eventually "/x".x = 3', 'true'),
    ):
        code, found, _ = check(path, formula)
        assert (code, found['outcome']) == (int(outcome == 'false'), outcome), formula


@pytest.mark.parametrize('kind', MCAP)
def test_damage_of_an_mcap_file(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'a.mcap'
    path.write_bytes(file_of(messages()))
    code, found, notes = check(path, 'always "/x".x < 5', '--strict')
    assert (code, found['outcome'], notes) == (1, 'false', [])
    build, reason = MCAP[kind]
    path.write_bytes(build())
    check_lost(path, reason)
    check_kept(path)


def test_a_chunk_that_states_fewer_bytes_and_has_no_compression(tmp_path: Path) -> None:
    """It can be read, but which of the sizes is right is not known."""
    path = tmp_path / 'a.mcap'
    path.write_bytes(file_of(messages(), checksum=False, change=with_fewer_bytes))
    code, _, notes = check(path, 'always "/x".x < 5')
    assert (code, len(notes)) == (1, 1)
    assert 'holds more bytes than it states' in notes[0]
    assert check(path, 'always "/x".x < 10')[0] == 2


def rows() -> list[tuple[int, bytes | None]]:
    """Return messages for a database, padded so that ten of them fill a page."""
    return [(START + number * STEP, payload(number) + bytes(24)) for number in range(COUNT)]


def without_data(path: Path) -> None:
    lacking = rows()
    lacking[LOST] = (lacking[LOST][0], None)
    database(path, lacking, DEFINITION)


def with_a_destroyed_page(path: Path) -> None:
    database(path, rows(), DEFINITION)
    data = bytearray(path.read_bytes())
    page = data.index(payload(LOST)) // 512 * 512
    data[page : page + 512] = b'\xff' * 512
    path.write_bytes(data)


def cut_off(path: Path) -> None:
    database(path, rows(), DEFINITION)
    data = path.read_bytes()
    path.write_bytes(data[: data.index(payload(LOST)) // 512 * 512])


def with_damaged_compression(path: Path) -> None:
    packed = [(time, zstd.compress(data or b'')) for time, data in rows()]
    packed[LOST] = packed[LOST][0], packed[LOST][1][:-3]
    database(path, packed, DEFINITION)


DATABASES: dict[str, tuple[Callable[[Path], None], str]] = {
    'no data': (without_data, 'a message has no time or no data'),
    'a destroyed page': (with_a_destroyed_page, 'the database is damaged'),
    'a cut end': (cut_off, 'the database is damaged'),
    'compression': (with_damaged_compression, 'the compression of a message is damaged'),
}


@pytest.mark.parametrize('kind', DATABASES)
def test_damage_of_a_database(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'a.db3'
    database(path, rows(), DEFINITION)
    code, found, notes = check(path, 'always "/x".x < 5')
    assert (code, found['outcome'], notes) == (1, 'false', [])
    build, reason = DATABASES[kind]
    path.unlink()
    build(path)
    check_lost(path, reason)


def folder_of(folder: Path, files: dict[str, bytes], counts: int) -> Path:
    folder.mkdir()
    listed = ', '.join(files)
    (folder / 'metadata.yaml').write_text(
        f'rosbag2_bagfile_information:\n  relative_file_paths: [{listed}]\n'
        '  topics_with_message_count:\n'
        f'    - {{topic_metadata: {{name: /x}}, message_count: {counts}}}\n'
    )
    for name, content in files.items():
        if content:
            (folder / name).write_bytes(content)
    return folder


def part(first: int, last: int) -> bytes:
    times = START + first * STEP, START + (last - 1) * STEP
    return mcap(NUMBER, chunk(messages()[first:last], times), b'')


@pytest.mark.parametrize('has_metadata', [True, False])
def test_a_file_that_is_missing(tmp_path: Path, *, has_metadata: bool) -> None:
    files = {'x_0.mcap': part(0, 10), 'x_1.mcap': b'', 'x_2.mcap': part(20, 40)}
    path = folder_of(tmp_path / 'bag', files, COUNT)
    if not has_metadata:
        (path / 'metadata.yaml').unlink()
    check_lost(path, 'the file x_1.mcap is missing')
    check_kept(path)


@pytest.mark.parametrize(
    ('names', 'missing'),
    [
        (['x_0', 'x_1'], []),
        (['run_2', 'run_5', 'run_10'], [0, 3, 6]),
        (['x_0', 'x_9999999999999'], [1]),
        (['x_2'], []),
        (['x'], []),
        (['x_1', 'x_2'], None),
        (['x_0', 'y_1'], None),
        (['x', 'y'], None),
    ],
)
def test_files_without_metadata(
    tmp_path: Path, names: list[str], missing: list[int] | None
) -> None:
    """They are one bag if their numbers tell so, which also show what is missing but the last."""
    content = {f'{name}.mcap': part(10 * at, 10 * at + 10) for at, name in enumerate(names)}
    path = folder_of(tmp_path / 'run', content, COUNT)
    (path / 'metadata.yaml').unlink()
    if missing is None:
        with pytest.raises(RecordingError, match=r'not numbered .* write: .*/run/\*\.mcap$'):
            Bag(path)
        return
    with Bag(path) as bag:
        assert len(list(bag.messages())) == 10 * len(names)
        reasons = [each.reason for each in bag.faults]
    stem = names[0].partition('_')[0]
    after = f'files after {names[-1]}.mcap may be missing: metadata.yaml would name them'
    assert reasons[1:] == [
        *([after] if len(names) > 1 else []),
        *(f'the file {stem}_{number}.mcap is missing' for number in missing),
    ]


@pytest.mark.parametrize('source', ['metadata.yaml', 'statistics'])
@pytest.mark.parametrize('difference', [-1, 1])
def test_counts_that_do_not_match(tmp_path: Path, source: str, difference: int) -> None:
    """It is not known where messages are missing; more than in the metadata do no harm."""
    file = tmp_path / 'a.mcap'
    if source == 'statistics':
        data = bytearray(file_of(messages(), checksum=False))
        at = data.rindex(struct.pack('<HQ', 1, COUNT))
        struct.pack_into('<Q', data, at + 2, COUNT + difference)
        data[-12:-8] = bytes(4)
        file.write_bytes(data)
    else:
        file = folder_of(tmp_path / 'bag', {'a.mcap': file_of(messages())}, COUNT + difference)
    code, found, notes = check(file, 'always "/x".x < 10')
    reason = f"topic '/x' has 40 messages, not {COUNT + difference} as in the {source}"
    assert any(reason in note for note in notes)
    if difference < 0 and source == 'metadata.yaml':
        assert (code, found['outcome']) == (0, 'undecided')
        return
    for formula in ('always "/x".x < 10', 'always "/x".x < 5', 'eventually "/x".x > 5'):
        code, found, _ = check(file, formula)
        assert code == 2
        assert f'{DEPENDS} at an unknown time: ' in found['error']['message']
        assert reason in found['error']['message']


def test_damage_that_makes_a_message(tmp_path: Path) -> None:
    """One bit turns the index of a chunk into a message, with a time long before the others."""
    data = bytearray(file_of(messages()))
    at = data.index(struct.pack('<BQ', 7, 6 + 16 * PER_CHUNK))
    data[at] = 5
    path = tmp_path / 'a.mcap'
    path.write_bytes(data)
    code, found, _ = check(path, 'always[0 s, 2 s] "/x".x < 5')
    assert code == 2
    reason = f"topic '/x' has {COUNT + 1} messages, not {COUNT} as in the statistics"
    assert reason in found['error']['message']


@pytest.mark.parametrize('size', [-9, -200, -600, -1200])
def test_a_recording_that_ends_early(tmp_path: Path, size: int) -> None:
    """It is no pass, unless only the index is cut."""
    path, report = tmp_path / 'a.mcap', tmp_path / 'out.xml'
    path.write_bytes(file_of(messages())[:size])
    code, found, notes = check(path, 'always "/x".x < 10', '--junit', str(report))
    text = report.read_text()
    if size >= -200:
        assert (code, found['outcome']) == (0, 'undecided')
        assert 'the index at the end of the file is damaged' in notes[0]
    else:
        assert (code, found['outcome']) == (2, 'error')
        assert 'the file ends early, within the recording' in found['error']['message']
        assert '<error ' in text
    assert '<property name="note 1" value="' in text
    # What was certain before is.
    assert check(path, 'always "/x".x < 5')[1]['outcome'] == 'false'
    assert check(path, 'eventually "/x".x = 9')[1]['outcome'] == 'true'
    assert check(path, 'eventually "/x".x = 9', '--strict')[0] == 2


def test_topics_that_have_lost_nothing(tmp_path: Path) -> None:
    """Sequence numbers name the topic; those that a writer counts over all topics do not count."""
    other = channel(2, 1, '/y')
    for is_shared in (False, True):
        pairs: Records = []
        for number in (n for n in range(COUNT) if n != LOST):
            time, value = START + number * STEP, payload(number)
            sequence = 3 * number + 1 if is_shared else number + 1
            pairs.append(stored(1, time, value, sequence))
            if number % 10 == 0:
                pairs.append(stored(2, time, value, sequence + 1 if is_shared else number // 10))
        path = tmp_path / 'a.mcap'
        times = START, START + (COUNT - 1) * STEP
        path.write_bytes(mcap(NUMBER, other, chunk(pairs, times)))
        assert check(path, 'always "/y".x < 5')[0] == 0
        assert check(path, 'always "/x".x < 5')[0] == (0 if is_shared else 2)


Row = tuple[int, int, int]
"""The time in steps, the channel and the sequence number of a message."""


def counted(key: int, period: int, *lost: int, first: int = 1) -> list[Row]:
    """Return the messages of a channel that counts them by itself, without those that are lost."""
    numbers = range(first, first + 400 // period)
    return [((n - first) * period, key, n) for n in numbers if n not in lost]


EVERY = counted(1, 1) + counted(2, 10)
TOGETHER = [(time, key, n) for n, (time, key, _) in enumerate(sorted(EVERY))]
SEQUENCES: dict[str, tuple[list[Row], dict[str, int]]] = {
    'none is missing': (EVERY, {}),
    'an early one': (counted(1, 1) + counted(2, 10, 2), {'/y': 1}),
    'a late one': (counted(1, 1) + counted(2, 10, 35), {'/y': 1}),
    'of large numbers': (counted(1, 1, 1330, first=1001) + counted(2, 10), {'/x': 1}),
    'each third': (counted(1, 1, *range(2, 401, 3)) + counted(2, 10), {'/x': 133}),
    'a silence': (counted(1, 1, *range(101, 200)) + counted(2, 10), {'/x': 99}),
    'all are zero': ([(time, key, 0) for time, key, _ in EVERY], {}),
    'counted together': ([row for row in TOGETHER if row[2] % 30 != 5], {}),
    'two publishers': (counted(1, 1, 9) + counted(1, 10) + counted(2, 10), {}),
}
"""By kind: the messages, and how many of a topic are known to be missing."""


def in_chunks(path: Path, rows: list[Row], size: int) -> Path:
    chunks = []
    for at in range(0, len(rows), size):
        part = sorted(rows)[at : at + size]
        content = [stored(key, START + time * STEP, payload(0), n) for time, key, n in part]
        times = START + part[0][0] * STEP, START + part[-1][0] * STEP
        chunks.append((chunk(content, times), times, Counter(key for _, key, _ in part)))
    path.write_bytes(indexed_mcap(NUMBER + channel(2, 1, '/y'), chunks))
    return path


@pytest.mark.parametrize('topics', [{'/x'}, {'/y'}, {'/x', '/y'}])
@pytest.mark.parametrize('size', [3, 20, 4000])
@pytest.mark.parametrize('kind', SEQUENCES)
def test_sequence_numbers(tmp_path: Path, kind: str, size: int, topics: set[str]) -> None:
    """Losses depend neither on the size of chunks, nor on topics whose chunks are skipped."""
    rows, missing = SEQUENCES[kind]
    with Bag(in_chunks(tmp_path / 'a.mcap', rows, size)) as bag:
        assert list(bag.messages(topics))
        found = [(each.place, each.reason, each.count) for each in bag.faults]
    lost = [(f"topic '{name}'", MISSING, n) for name, n in missing.items() if name in topics]
    assert found == lost


@pytest.mark.parametrize('end', [150, 250])
@pytest.mark.parametrize('kind', [*SEQUENCES, 'each begins anew', 'all begin anew'])
def test_sequence_numbers_in_two_files(tmp_path: Path, kind: str, end: int) -> None:
    """Messages may be lost between files; a writer may begin to count anew with each."""
    rows, missing = SEQUENCES.get(kind, (EVERY if kind.startswith('each') else TOGETHER, {}))
    files = [row for row in rows if row[0] < end], [row for row in rows if row[0] >= end]
    if kind not in SEQUENCES:
        first = {key: n for _, key, n in sorted(files[1], reverse=True)}
        least = min(first.values()) if kind.startswith('all') else None
        files[1][:] = [(time, key, n - (least or first[key])) for time, key, n in files[1]]
    for number, each in enumerate(files):
        in_chunks(tmp_path / f'a_{number}.mcap', each, 20)
    with Bag(tmp_path) as bag:
        assert list(bag.messages())
        found = {each.place: each.count for each in bag.faults if each.reason == MISSING}
    assert found == {f"topic '{name}'": n for name, n in missing.items()}


def test_sequence_numbers_of_chunks_in_another_order(tmp_path: Path) -> None:
    """A chunk of messages that were recorded later may begin with an earlier one."""
    chunks = [
        [(time, 1, time) for time in range(1, 100)],
        [(102, 2, 0), (101, 1, 100)],
        [(100, 2, 0), (103, 1, 101)],
        [(time, 1, time - 2) for time in range(104, 200)],
    ]
    records = [
        chunk(
            [stored(key, START + time * STEP, payload(0), n) for time, key, n in part],
            (START + min(part)[0] * STEP, START + max(part)[0] * STEP),
        )
        for part in chunks
    ]
    path = tmp_path / 'a.mcap'
    path.write_bytes(mcap(NUMBER, channel(2, 1, '/y'), *records))
    with Bag(path) as bag:
        assert list(bag.messages())
        assert not [each for each in bag.faults if each.reason == MISSING]


def test_sequence_numbers_that_seldom_increase_by_one(tmp_path: Path) -> None:
    rows = counted(1, 1, *range(2, 401, 2))
    path = in_chunks(tmp_path / 'a.mcap', rows, 20)
    code, found, (note,) = check(path, 'always "/x".x < 5', '--strict')
    assert (code, found['outcome']) == (2, 'undecided')
    assert "topic '/x': its sequence numbers mostly increase by more than one" in note


SYNC = 'stream s = sync(select x from "/x", select x as y from "/y"); sink s'


def test_no_state_holds_a_value_from_before_the_gap(tmp_path: Path) -> None:
    """The last value of /x is not taken for the one that was lost."""
    streams = tmp_path / 's.streams'
    streams.write_text(SYNC)
    path = tmp_path / 'a.mcap'
    records = []
    for number in range(COUNT):
        value = payload(number)[: 6 if number == 10 else 8]
        if number % 10 == 0:
            records.append(stored(1, START + number * STEP, value))
        records.append(stored(2, START + number * STEP + 1, payload(number)))
    path.write_bytes(mcap(NUMBER, channel(2, 1, '/y'), *records))
    code, found, _ = check(path, 'always s.y < 3', '--streams', str(streams))
    assert (code, found['outcome']) == (1, 'false')
    (gap,) = found['gaps']
    assert gap['after_ns'] < START + 10 * STEP
    assert gap['before_ns'] >= START + 20 * STEP
    # The violation of /y in the gap is no violation of a state that is known.
    assert found['episodes'][0]['decided_at_ns'] == START + LATE * STEP + 1


@given(
    st.lists(st.tuples(st.integers(8, 5000), st.integers(1, 255)), min_size=1, max_size=4),
    st.none() | st.integers(9, 5000),
    st.sampled_from(['', 'zstd', 'lz4']),
)
def test_random_damage_never_makes_a_verdict_true(
    tmp_path_factory: pytest.TempPathFactory,
    changes: list[tuple[int, int]],
    cut: int | None,
    compression: str,
) -> None:
    """All formulas are false over the whole recording."""
    data = bytearray(file_of(messages(), compression))
    if cut is not None:
        del data[cut % len(data) :]
    else:
        for place, value in changes:
            data[place % len(data)] ^= value
    path = tmp_path_factory.mktemp('damage') / 'a.mcap'
    path.write_bytes(data)
    formulas = ('always "/x".x < 5', 'always[0 s, 2 s] "/x".x < 5', 'not eventually "/x".x = 9')
    found = run_check(path, '--json', *(w for each in formulas for w in ('--formula', each)))
    document = found.document
    assert found.code in {1, 2}
    if document['error'] is None:
        outcomes = [each['outcome'] for each in document['formulas']]
        assert set(outcomes) <= {'false', 'error'}, document
