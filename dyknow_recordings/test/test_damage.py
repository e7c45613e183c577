"""Recordings that are damaged at random places: what is read is a part of what was recorded."""

import struct
from collections import Counter
from pathlib import Path
from typing import Any
from zlib import crc32

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from small_bags import COMPRESSIONS, FIELDS, Message, messages, write
from small_logs import log, logged_numbers

from dyknow_recordings import Bag, RecordingError, in_order, open_recording

COUNT = 120


@pytest.fixture(scope='module', params=COMPRESSIONS, ids='-'.join)
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp('bags')
    write(folder / 'bag', *request.param, messages(COUNT))
    (file,) = (each for each in (folder / 'bag').iterdir() if each.name != 'metadata.yaml')
    return file


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp('damaged')


def cuts() -> st.SearchStrategy[float]:
    return st.floats(0, 1)


def messages_of(path: Path) -> tuple[list[Message], Any]:
    """Return what can be read, by each of the ways to read; None if nothing can be."""
    try:
        with open_recording(path) as opened:
            topics = {topic.name for topic in opened.topics}
            wanted = {topic: paths for topic, paths in FIELDS.items() if topic in topics}
            try:
                columns = sum(1 for _ in in_order(opened.columns(wanted)))
            except RecordingError:
                columns = None
            assert isinstance(opened, Bag)
            found = [(each.log_time, each.topic, each.data) for each in opened.messages()]
            assert columns is None or columns <= len(found)
            return found, opened.faults
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017 - or it is read
        return [], error


def is_part(found: list[Message], whole: list[Message]) -> bool:
    return found == sorted(found, key=lambda each: each[0]) and Counter(found) <= Counter(whole)


@given(part=cuts(), unit=st.sampled_from([1, 4096]))
def test_a_file_that_ends_early(recording: Path, folder: Path, part: float, unit: int) -> None:
    data = recording.read_bytes()
    size = int(part * len(data)) // unit * unit
    path = folder / recording.name
    path.write_bytes(data[:size])
    found, faults = messages_of(path)
    assert is_part(found, messages(COUNT))
    # The end of an MCAP file and of a database may hold nothing that is needed.
    assert faults or len(found) == COUNT


@given(st.lists(st.tuples(cuts(), st.integers(0, 255)), min_size=1, max_size=8))
def test_a_file_with_other_bytes(
    recording: Path, folder: Path, changes: list[tuple[float, int]]
) -> None:
    path = folder / recording.name
    path.write_bytes(changed(recording.read_bytes(), changes))
    messages_of(path)


def changed(data: bytes, changes: list[tuple[float, int]]) -> bytes:
    found = bytearray(data)
    for part, value in changes:
        found[int(part * (len(data) - 1))] = value
    return bytes(found)


@given(cuts(), st.binary(min_size=1, max_size=20))
def test_a_chunk_with_a_checksum(folder: Path, part: float, noise: bytes) -> None:
    """The writer of rosbags leaves out the checksums that recorders of ROS write."""
    write_checked(folder / 'checked.mcap')
    data = bytearray((folder / 'checked.mcap').read_bytes())
    begin, size = chunk_content(bytes(data))
    at = begin + int(part * (size - len(noise)))
    data[at : at + len(noise)] = noise
    path = folder / 'changed.mcap'
    path.write_bytes(data)
    found, _ = messages_of(path)
    assert is_part(found, messages(COUNT))


def write_checked(path: Path) -> None:
    if path.exists():
        return
    write(path.with_name('unchecked'), 'mcap', 'none', messages(COUNT))
    data = bytearray((path.with_name('unchecked') / 'unchecked.mcap').read_bytes())
    begin, size = chunk_content(bytes(data))
    struct.pack_into('<I', data, begin - 16, crc32(data[begin : begin + size]))
    path.write_bytes(data)


def chunk_content(data: bytes) -> tuple[int, int]:
    """Return where the only chunk of a file without compression begins, and its size."""
    position = 8
    while data[position] != 6:
        position += 9 + struct.unpack_from('<Q', data, position + 1)[0]
    (size,) = struct.unpack_from('<Q', data, position + 9 + 16)
    return position + 9 + 28 + 4 + 8, size


def test_damage_between_chunks_leaves_the_others(tmp_path: Path) -> None:
    # More than one chunk of rosbags, which has a mebibyte.
    recorded = messages(9000)
    write(tmp_path / 'bag', 'mcap', 'none', recorded)
    file = tmp_path / 'bag' / 'bag.mcap'
    data = bytearray(file.read_bytes())
    begin, size = chunk_content(bytes(data))
    assert data[begin + size] == 7
    data[begin + size] = 0
    file.write_bytes(data)
    found, faults = messages_of(file)
    assert found == recorded
    (fault,) = faults
    assert fault.reason == f'byte {begin + size} and those after it are damaged'


@pytest.mark.parametrize('change', [-7, 5, 1000, 1 << 20])
def test_the_wrong_length_of_a_chunk_leaves_the_others(tmp_path: Path, change: int) -> None:
    recorded = messages(9000)
    write(tmp_path / 'bag', 'mcap', 'none', recorded)
    file = tmp_path / 'bag' / 'bag.mcap'
    data = bytearray(file.read_bytes())
    begin, _ = chunk_content(bytes(data))
    at = begin - 9 - 28 - 4 - 8 + 1
    struct.pack_into('<Q', data, at, struct.unpack_from('<Q', data, at)[0] + change)
    file.write_bytes(data)
    found, faults = messages_of(file)
    assert is_part(found, recorded)
    assert len(found) >= len(recorded) - 1
    assert faults


def test_an_index_that_is_damaged(tmp_path: Path) -> None:
    write(tmp_path / 'bag', 'mcap', 'none', messages(COUNT))
    file = tmp_path / 'bag' / 'bag.mcap'
    data = bytearray(file.read_bytes())
    data[-37] = 0
    file.write_bytes(data)
    found, faults = messages_of(file)
    assert found == messages(COUNT)
    assert [each.reason for each in faults] == ['the index at the end of the file is damaged']


@given(cuts())
def test_a_log_of_px4_that_ends_early(folder: Path, part: float) -> None:
    path = folder / 'log.ulg'
    data = log(range(50))
    path.write_bytes(data[: int(part * len(data))])
    found = logged_numbers(path)
    assert found is None or found == list(range(len(found)))


@example([(0.013883301545636332, 128)])  # The first field of a format gets an empty name.
@given(st.lists(st.tuples(cuts(), st.integers(0, 255)), min_size=1, max_size=8))
def test_a_log_of_px4_with_other_bytes(folder: Path, changes: list[tuple[float, int]]) -> None:
    path = folder / 'log.ulg'
    path.write_bytes(changed(log(range(50)), changes))
    logged_numbers(path)


@given(st.integers(0, 60), st.binary(max_size=5))
def test_a_trace_with_other_bytes(folder: Path, at: int, noise: bytes) -> None:
    data = b'time_s, x, mode: string\n' + b''.join(b'%d, %d, a\n' % (n, n) for n in range(9))
    path = folder / 'trace.csv'
    path.write_bytes(data[:at] + noise + data[at + len(noise) :])
    try:
        with open_recording(path) as opened:
            fields = opened.fields('/trace')
            assert len(list(in_order(opened.columns({'/trace': list(fields)})))) >= 1
    except RecordingError as error:
        assert str(path) in str(error)  # noqa: PT017 - or it is read
