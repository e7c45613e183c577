"""The command `dyknow check` on recordings that are damaged or odd."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest
from running_checks import run_check
from small_bags import START, channel, mcap, messages, record, schema, stored, write

from dyknow_common import SECOND_NS

HOUR_NS = 3600 * SECOND_NS
NUMBER = schema(1, 'made_up/msg/Number', 'int32 x\n') + channel(1, 1, '/x')


def number(x: int) -> bytes:
    return b'\0\1\0\0' + struct.pack('<i', x)


def file(folder: Path, *records: bytes) -> Path:
    path = folder / 'made.mcap'
    path.write_bytes(mcap(*records))
    return path


def check(path: Path, formula: str, *options: str) -> tuple[int, Any, str]:
    """Return the exit code, the document, and what people read."""
    code, out, err = run_check(path, '--formula', formula, *options)
    lines = run_check(path, '--formula', formula, '--json', *options)
    assert lines.code == code
    assert 'Traceback' not in out + err
    return code, lines.document, out + err


@pytest.mark.parametrize(
    ('name', 'content', 'message'),
    [
        ('a.mcap', b'', 'is empty'),
        ('a.mcap', b'\x89MCAP0\r\n\1', 'the file ends early'),
        ('a.ulg', b'\x55\x4c\x6f\x67\x01\x12\x35', 'a.ulg'),
        ('a.csv', b'time_s,x\n', 'has no messages'),
        ('nowhere.mcap', None, 'no such recording'),
    ],
)
def test_nothing_can_be_read(
    tmp_path: Path, name: str, content: bytes | None, message: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    code, document, text = check(path, 'always "/x".x < 5')
    assert code == 2
    assert message in document['error']['message']
    assert str(path) in text


def test_a_file_that_ends_within_a_chunk(tmp_path: Path) -> None:
    write(tmp_path / 'bag', 'mcap', 'none', messages(300))
    data = (tmp_path / 'bag' / 'bag.mcap').read_bytes()
    path = tmp_path / 'cut.mcap'
    path.write_bytes(data[: len(data) // 2])
    code, document, text = check(path, 'always "/odom".pose.pose.position.z < 900')
    assert code == 2
    assert 'the file ends early' in document['formulas'][0]['error']['message']
    assert document['formulas'][0]['states'] > 10
    assert any('ends' in note for note in document['notes'])
    assert document['notes'][0] in text.replace('\n', ' ')


def test_an_unknown_message_type(tmp_path: Path) -> None:
    unknown = schema(1, 'made_up/msg/Unknown') + channel(1, 1, '/x')
    path = file(tmp_path, unknown, stored(1, START, number(1)))
    code, document, _ = check(path, 'always "/x".x < 5')
    assert code == 2
    (formula,) = document['formulas']
    assert (
        "no message of /x can be read: the message type 'made_up/msg/Unknown' is unknown"
        in formula['error']['message']
    )


@pytest.mark.parametrize('definition', ['int32 x\n', 'string name\n', '?'])
def test_a_topic_that_changes_its_type(tmp_path: Path, definition: str) -> None:
    other = schema(2, 'made_up/msg/Other', definition) + channel(2, 2, '/x')
    rows = [stored(1, START + n * SECOND_NS, number(n)) for n in range(3)]
    path = file(tmp_path, NUMBER, other, *rows, stored(2, START + 3 * SECOND_NS, number(1)))
    code, document, _ = check(path, 'always "/x".x < 5')
    (formula,) = document['formulas']
    assert (code, formula['states']) == (2, 3)
    assert 'the type of the topic has changed' in formula['error']['message']
    changed = "topic '/x': it changes its type: made_up/msg/Number, made_up/msg/Other"
    assert changed in document['notes']
    # What is decided before is well.
    assert check(path, 'eventually "/x".x = 2')[0] == 0


def test_hours_of_silence(tmp_path: Path) -> None:
    times = [START, START + SECOND_NS, START + 3 * HOUR_NS, START + 3 * HOUR_NS + SECOND_NS]
    rows = [stored(1, time, number(n)) for n, time in enumerate(times)]
    path = file(tmp_path, NUMBER, *rows)
    code, document, _ = check(path, 'always "/x".x < 3')
    assert (code, document['formulas'][0]['episodes'][0]['decided_at_ns']) == (1, times[-1])
    assert 'no message is recorded, first for 10799 s' in ''.join(document['notes'])
    (tmp_path / 'a.streams').write_text(
        'stream a = select x from "/x" with sample_period = 1 s; sink a'
    )
    streams = ('--streams', str(tmp_path / 'a.streams'))
    code, document, _ = check(path, 'always a.x < 5', *streams)
    assert code == 2
    assert 'sample_period' in document['formulas'][0]['error']['message']


def test_topics_with_faults(tmp_path: Path) -> None:
    data = mcap(NUMBER, stored(1, START, number(1)))
    path = tmp_path / 'a.mcap'
    path.write_bytes(data[:-40] + record(5, b'') + b'\0')
    found = run_check(path, '--topics', '--json')
    assert found.code == 0
    assert found.document['topics'][0]['messages'] == 1
    assert found.document['notes']
