"""Small files that ask for much memory or time: each is answered soon, with an error."""

from __future__ import annotations

import os
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from backports import zstd
from lz4 import frame as lz4
from running_checks import CODE
from small_bags import START, channel, chunk, database, mcap, messages, record, schema, stored, text
from small_bags import write as write_bag

from dyknow_recordings.check import main
from dyknow_recordings.reading.bags import mcap_records

pytestmark = pytest.mark.long

MOST_SECONDS = 20
MOST_MEGABYTES = 700
GIB = 1 << 30
NUMBER = schema(1, 'made_up/msg/Number', 'int32 x\n') + channel(1, 1, '/x')


def check(path: Path) -> str:
    """Return the errors of a check, which needs little time and memory."""
    command = [sys.executable, '-c', CODE, str(path), '--formula', 'always "/x".x < 5']
    errors = path.parent / 'errors.txt'
    with errors.open('w') as file:
        process = subprocess.Popen(command, stdout=file, stderr=file)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 2
    # Other processes may have the machine, but not the time of this one.
    assert usage.ru_utime + usage.ru_stime < MOST_SECONDS
    assert usage.ru_maxrss / 1024 < MOST_MEGABYTES
    found = ' '.join(errors.read_text().replace('│', ' ').split())
    assert 'Traceback' not in found
    return found


def bomb(compression: str, stated: int) -> bytes:
    """A chunk of a GiB of zeros that states another size."""
    zeros, pieces = bytes(GIB >> 6), []
    if compression == 'zstd':
        compressor = zstd.ZstdCompressor()
        pieces = [compressor.compress(zeros) for _ in range(64)] + [compressor.flush()]
    else:
        other = lz4.LZ4FrameCompressor()
        pieces = [other.begin(), *(other.compress(zeros) for _ in range(64)), other.flush()]
    packed = b''.join(pieces)
    head = struct.pack('<QQQI', START, START, stated, 0) + text(compression)
    return record(6, head + struct.pack('<Q', len(packed)) + packed)


@pytest.mark.parametrize(
    ('compression', 'stated'), [('zstd', 4 * GIB), ('lz4', GIB), ('zstd', 1000), ('lz4', 1000)]
)
def test_a_chunk_that_grows(tmp_path: Path, compression: str, stated: int) -> None:
    path = tmp_path / 'a.mcap'
    first = chunk([stored(1, START - 1, b'\0\1\0\0\1\0\0\0')], (START - 1, START - 1))
    path.write_bytes(mcap(NUMBER, first, bomb(compression, stated)))
    found = check(path)
    if stated == 1000:
        assert 'holds more bytes than it states' in found
    else:
        limit = 'more than the limit of 256 MiB'
        assert f'a chunk has {stated} bytes without its compression, {limit}' in found


def test_a_message_that_grows(tmp_path: Path) -> None:
    path = tmp_path / 'a.db3'
    compressor = zstd.ZstdCompressor()
    packed = b''.join(compressor.compress(bytes(GIB >> 6)) for _ in range(64)) + compressor.flush()
    database(path, [(START, zstd.compress(b'\0\1\0\0\1\0\0\0')), (START + 1, packed)], 'int32 x\n')
    assert 'the compression of a message is damaged' in check(path)


@pytest.mark.parametrize('table', ['messages', 'topics'])
def test_a_view_without_end(tmp_path: Path, table: str) -> None:
    path = tmp_path / 'a.db3'
    database(path, [(START, b'\0\1\0\0\1\0\0\0')], 'int32 x\n')
    with closing(sqlite3.connect(path)) as file:
        columns = [row[1] for row in file.execute(f'PRAGMA table_info({table})')]
        names = ', '.join(f'n AS {name}' for name in columns)
        file.executescript(
            f'DROP TABLE {table}; CREATE VIEW {table} AS WITH RECURSIVE c(n) AS'
            f' (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT {names} FROM c;'
        )
    assert f"'{table}' is no table" in check(path)


def test_a_file_that_is_named_often(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', 'mcap', 'none', messages(30))
    metadata = tmp_path / 'bag' / 'metadata.yaml'
    name = '    - bag.mcap\n'
    whole = metadata.read_text()
    start = whole.index('relative_file_paths:') + len('relative_file_paths:\n')
    assert 'bag.mcap' in whole[start : start + 40]
    metadata.write_text(whole[:start] + name * 20_000 + whole[whole.index('\n', start) + 1 :])
    found = check(tmp_path / 'bag')
    assert 'metadata.yaml names a file again (19999 times)' in found


def test_too_little_memory_is_no_damage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class TooLarge:
        def decompress(self, *_: object) -> bytes:
            raise MemoryError

    path = tmp_path / 'a.mcap'
    part = chunk([NUMBER, stored(1, START, b'\0\1\0\0\1\0\0\0')], (START, START), 'zstd')
    path.write_bytes(mcap(part))
    monkeypatch.setitem(mcap_records._DECOMPRESSORS, b'zstd', TooLarge)
    assert main([str(path), '--formula', 'always "/x".x < 5']) == 2
    found = capsys.readouterr().err
    assert 'internal error: MemoryError' in found
    assert 'lost' not in found
