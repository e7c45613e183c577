"""The memory of a stream manager over its restart."""

import os
from pathlib import Path

import pytest

from dyknow_common import DyKnowError, StreamConstraints
from dyknow_stream_processing.management.persistence import (
    PersistenceFile,
    streams_from_json,
    streams_to_json,
)
from dyknow_stream_processing.management.streams import (
    CreatedStream,
    RegisteredStream,
    read_streams,
)

MANAGER = '/robot1/stream_manager'
BATTERY = RegisteredStream('battery', '/uav1/battery', 'sensor_msgs/msg/BatteryState')
POWER = CreatedStream(
    'power', 'select a from battery', StreamConstraints(max_delay=5), '/e1', '/streams/power'
)


def test_what_is_written_is_read() -> None:
    battery, power = streams_from_json(streams_to_json([BATTERY, POWER], MANAGER), MANAGER)
    assert battery == BATTERY
    assert isinstance(power, CreatedStream)
    assert (power.name, power.specification) == (POWER.name, POWER.specification)
    assert power.constraints == POWER.constraints
    assert power.waits


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('{', 'not what a stream manager wrote'),
        ('[]', 'not what a stream manager wrote'),
        ('{"streams": [{"name": "a"}]}', 'not what a stream manager wrote'),
        ('{"streams": [{"name": "a", "specification": "x", "constraints": {"b": 1}}]}', 'wrote'),
        ('{"streams": [{"name": "a", "specification": "select", "constraints": {}}]}', 'expected'),
    ],
)
def test_what_is_no_memory(text: str, words: str) -> None:
    with pytest.raises(DyKnowError, match=words):
        streams_from_json(text, MANAGER)


def test_the_file_holds_what_was_written_last(tmp_path: Path) -> None:
    path = tmp_path / 'new' / 'streams.json'
    memory = PersistenceFile(str(path), MANAGER)
    assert memory.read() == ()
    memory.write([BATTERY, POWER])
    memory.write([BATTERY])
    assert PersistenceFile(str(path), MANAGER).read() == (BATTERY,)
    assert list(path.parent.iterdir()) == [path]


def test_the_memory_of_another_manager_is_refused(tmp_path: Path) -> None:
    """Its streams may have other specifications under the same names."""
    path = tmp_path / 'streams.json'
    PersistenceFile(str(path), '/robot2/stream_manager').write([BATTERY])
    with pytest.raises(DyKnowError, match=f'{path}: it is the memory of /robot2/stream_manager'):
        PersistenceFile(str(path), MANAGER).read()


def test_no_file_keeps_nothing() -> None:
    memory = PersistenceFile('', MANAGER)
    memory.write([BATTERY])
    assert memory.read() == ()


def test_a_file_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    path = tmp_path / 'streams.json'
    path.write_text('{')
    with pytest.raises(DyKnowError, match=f'{path}: it is not what a stream manager wrote'):
        PersistenceFile(str(path), MANAGER).read()
    with pytest.raises(DyKnowError, match=f'cannot read the streams in {tmp_path}'):
        PersistenceFile(str(tmp_path), MANAGER).read()
    with pytest.raises(DyKnowError, match=f'cannot write the memory {path}/beneath'):
        PersistenceFile(str(path / 'beneath'), MANAGER).write([BATTERY])


def test_a_sink_in_two_files_is_named(tmp_path: Path) -> None:
    paths = [tmp_path / name for name in ('one', 'two')]
    for path in paths:
        path.write_text('stream a = select b from "/c"; sink a')
    with pytest.raises(DyKnowError, match=f"{paths[1]}: there is a sink 'a' in another file"):
        list(read_streams(paths))


def test_only_the_owner_may_read_a_memory(tmp_path: Path) -> None:
    path = tmp_path / 'streams.json'
    (tmp_path / 'streams.json.new').symlink_to(tmp_path / 'other')
    PersistenceFile(str(path), MANAGER).write([BATTERY])
    assert path.stat().st_mode & 0o777 == 0o600
    assert [each.name for each in tmp_path.iterdir()] == ['streams.json']


def test_a_memory_of_another_version_is_refused_and_left(tmp_path: Path) -> None:
    path = tmp_path / 'streams.json'
    path.write_text('{"version": 2, "streams": []}')
    with pytest.raises(DyKnowError, match='it has version 2'):
        PersistenceFile(str(path), MANAGER).read()
    assert path.read_text() == '{"version": 2, "streams": []}'


def test_a_pipe_is_no_memory(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(DyKnowError, match='it is no regular file'):
        PersistenceFile(str(tmp_path / 'pipe'), MANAGER).read()
