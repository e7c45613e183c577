import os
import shutil
import sqlite3
import struct
from collections import defaultdict
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from backports import zstd
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer
from small_bags import (
    BOOL,
    COMPRESSIONS,
    FIELDS,
    START,
    STORE,
    TOPICS,
    Message,
    channel,
    chunk,
    database,
    index,
    mcap,
    message,
    messages,
    read_by_rosbags,
    schema,
    stored,
    value_at,
    write,
)

from dyknow_common import ExitCode, ValueType
from dyknow_recordings import (
    Bag,
    RecordedTopic,
    RecordingError,
    TopicContent,
    in_order,
    open_recording,
)

COUNT = 300


@pytest.fixture(scope='module', params=COMPRESSIONS, ids='-'.join)
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('bags') / 'bag'
    write(path, *request.param, messages(COUNT))
    return path


def reasons(opened: Any) -> list[str]:
    return [fault.reason for fault in opened.faults]


def found_in(path: Path) -> list[Message]:
    with Bag(path) as bag:
        return [(each.log_time, each.topic, each.data) for each in bag.messages()]


def check_columns(path: Path, expected: list[Message]) -> None:
    with Bag(path) as bag:
        rows = list(in_order(bag.columns(FIELDS)))
    assert [(row.log_time, row.topic) for row in rows] == [each[:2] for each in expected]
    for row, (_, topic, data) in zip(rows, expected, strict=True):
        decoded = STORE.deserialize_cdr(data, TOPICS[topic])
        values = {name: value_at(decoded, name) for name in FIELDS[topic]}
        assert row.values == {name: value for name, value in values.items() if value is not None}
        assert row.absent.keys() == {name for name, value in values.items() if value is None}
        if topic != '/armed':
            stamp = decoded.header.stamp
            assert row.stamp == stamp.sec * 10**9 + stamp.nanosec
        else:
            assert row.stamp is None


def test_every_storage_gives_the_messages_that_rosbags_reads(recording: Path) -> None:
    expected = read_by_rosbags(recording)
    assert expected == messages(COUNT)
    assert found_in(recording) == expected
    check_columns(recording, expected)
    with open_recording(recording) as bag:
        assert bag.topics == tuple(
            RecordedTopic(topic, TOPICS[topic], COUNT // 3, None) for topic in sorted(TOPICS)
        )
        assert bag.start_time == expected[0][0]
        assert bag.end_time == expected[-1][0]
        list(bag.columns(FIELDS))
        assert bag.faults == ()


def test_a_topic_without_fields_gives_times(recording: Path) -> None:
    with Bag(recording) as bag:
        rows = list(in_order(bag.columns({'/odom': []})))
        assert [row.log_time for row in rows] == [
            time for time, topic, _ in messages(COUNT) if topic == '/odom'
        ]
        assert list(bag.columns({})) == []
        assert bag.fields('/scan')['ranges[0..]'] is ValueType.FLOAT


def test_an_element_that_some_messages_lack(recording: Path) -> None:
    with Bag(recording) as bag:
        rows = list(in_order(bag.columns({'/scan': ['ranges[2]']})))
    assert rows[0].absent == {'ranges[2]': "'ranges' has 2 elements, not one at [2]"}
    assert rows[1].values == {'ranges[2]': 2.0}


def test_wrong_topics_and_fields(recording: Path) -> None:
    with Bag(recording) as bag:
        with pytest.raises(RecordingError, match=r"unknown topic '/odo'; did you mean '/odom'"):
            bag.columns({'/odo': []})
        with pytest.raises(
            RecordingError, match=r"topic '/scan': .* has no field 'range'"
        ) as error:
            bag.columns({'/scan': ['range']})
        assert error.value.code == ExitCode.NOT_FOUND
        with pytest.raises(RecordingError, match='it is not a single value; ask for ranges'):
            bag.columns({'/scan': ['ranges']})
    with pytest.raises(RecordingError, match='the recording is closed'):
        next(bag.messages())


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_split_bag(tmp_path: Path, storage: str) -> None:
    suffix = {'mcap': '.mcap', 'sqlite3': '.db3'}[storage]
    folder = tmp_path / 'split'
    folder.mkdir()
    for number in range(3):
        # The files overlap, as a recorder with several threads makes them.
        part = messages(100, 100 * number)
        part[0] = (part[0][0] - 25_000_000 * (number > 0), *part[0][1:])
        write(tmp_path / f'part_{number}', storage, 'none', sorted(part))
        shutil.copy(tmp_path / f'part_{number}' / f'part_{number}{suffix}', folder)
    everything = [each for n in range(3) for each in read_by_rosbags(tmp_path / f'part_{n}')]
    names = [f'part_{number}{suffix}' for number in range(3)]
    listed = ''.join(f'    - {name}\n' for name in names)
    (folder / 'metadata.yaml').write_text(
        f'rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}'
    )
    assert found_in(folder) == sorted(everything, key=lambda each: each[0])
    check_columns(folder, sorted(everything, key=lambda each: each[0]))
    (folder / names[1]).unlink()
    with Bag(folder) as bag:
        assert reasons(bag) == [f'the file {names[1]} is missing']
        assert len(list(bag.messages())) == 200
    (folder / 'metadata.yaml').unlink()
    (folder / names[2]).rename(folder / names[1])
    with Bag(folder) as bag:
        assert reasons(bag) == [
            'metadata.yaml is missing: the bag is read without it',
            f'files after {names[1]} may be missing: metadata.yaml would name them',
        ]


@pytest.mark.parametrize('metadata', [None, '', '{', 'a: 3', 'rosbag2_bagfile_information: []'])
def test_without_its_metadata(recording: Path, tmp_path: Path, metadata: str | None) -> None:
    folder = tmp_path / 'bag'
    shutil.copytree(recording, folder)
    (folder / 'metadata.yaml').unlink()
    if metadata is not None:
        (folder / 'metadata.yaml').write_text(metadata)
    with Bag(folder) as bag:
        what = 'damaged' if metadata is not None else 'missing'
        assert reasons(bag) == [f'metadata.yaml is {what}: the bag is read without it']
    assert found_in(folder) == messages(COUNT)


def write_mcap(path: Path, *records: bytes) -> Path:
    file = path / 'made.mcap'
    file.write_bytes(mcap(*records))
    return file


NUMBER = schema(1, 'made_up/msg/Number', 'uint8 x\n') + channel(1, 1, '/x')


def number(value: int) -> bytes:
    return b'\0\1\0\0' + bytes([value])


@pytest.mark.parametrize('compression', ['', 'zstd', 'lz4'])
def test_chunks_that_overlap_and_have_no_index(tmp_path: Path, compression: str) -> None:
    chunks = [
        chunk(
            [stored(1, time, number(time)) for time in times], (min(times), max(times)), compression
        )
        for times in ([10, 30, 50], [20, 40, 90], [60, 55])
    ]
    file = write_mcap(tmp_path, NUMBER, *chunks)
    with Bag(file) as bag:
        assert bag.topics[0].message_count == 8
        rows = list(in_order(bag.columns({'/x': ['x']})))
        assert bag.faults == ()
    assert [row.log_time for row in rows] == [10, 20, 30, 40, 50, 55, 60, 90]
    assert all(row.values['x'] == row.log_time for row in rows)


def test_messages_without_chunks_and_with_definitions_inside_chunks(tmp_path: Path) -> None:
    free = [stored(1, time, number(time)) for time in (7, 5, 6)]
    inside = chunk([NUMBER, stored(1, 9, number(9))], (9, 9))
    file = write_mcap(tmp_path, *free, inside)
    with Bag(file) as bag:
        rows = list(in_order(bag.columns({'/x': ['x']})))
        assert (bag.start_time, bag.end_time) == (5, 9)
    assert [row.values['x'] for row in rows] == [5, 6, 7, 9]


def test_topics_that_nobody_uses_are_not_read(tmp_path: Path) -> None:
    damaged = bytearray(chunk([stored(2, 5, number(1))], (5, 5)))
    damaged[-1] ^= 1
    other = channel(2, 1, '/images')
    used = chunk([stored(1, 6, number(2))], (6, 6))
    file = write_mcap(tmp_path, NUMBER, other, bytes(damaged), index(2, 1), used, index(1, 1))
    with Bag(file) as bag:
        assert [row.log_time for row in in_order(bag.columns({'/x': []}))] == [6]
        assert bag.faults == ()
        assert list(bag.messages(['/images'])) == []
        (fault,) = bag.faults
    assert fault.reason == 'a chunk is damaged: its messages are lost'
    assert fault.place.startswith(f'{file}, byte ')


def test_messages_without_a_topic(tmp_path: Path) -> None:
    path = tmp_path / 'a.db3'
    database(path, [(time, number(1)) for time in range(3)], 'uint8 x')
    with closing(sqlite3.connect(path)) as file, file:
        file.execute('UPDATE messages SET topic_id = NULL WHERE timestamp = 1')
    with Bag(path) as bag:
        (fault,) = bag.faults
        assert len(list(bag.messages())) == 2
    reason = 'a message has no number for its topic or time'
    assert str(fault) == f'{path}: the database is damaged: {reason}'


def test_messages_of_a_chunk_are_counted(tmp_path: Path) -> None:
    whole = chunk([stored(1, time, number(1)) for time in range(5)], (0, 4), checksum=False)
    short = whole[:9] + struct.pack('<QQQ', 0, 4, len(whole)) + whole[33:]
    with Bag(write_mcap(tmp_path, NUMBER, short, index(1, 9))) as bag:
        assert len(list(bag.messages())) == 5
        (fault,) = bag.faults
    reason = 'a chunk is incomplete: some of its messages are lost (4 messages)'
    assert str(fault).endswith(f': {reason}')


def test_a_topic_that_changes_its_type(tmp_path: Path) -> None:
    second = schema(2, 'made_up/msg/Text', 'string name\n') + channel(2, 2, '/x')
    data = b'\0\1\0\0\2\0\0\0a\0'
    file = write_mcap(tmp_path, NUMBER, second, stored(1, 1, number(3)), stored(2, 2, data))
    with Bag(file) as bag:
        assert [(each.name, each.message_type) for each in bag.topics] == [
            ('/x', 'made_up/msg/Number'),
            ('/x', 'made_up/msg/Text'),
        ]
        assert bag.fields('/x') == {'x': ValueType.INT, 'name': ValueType.STRING}
        assert bag.contents['/x'] == TopicContent(
            'made_up/msg/Number', {'x': ValueType.INT}, has_stamp=False, count=2
        )
        rows = list(in_order(bag.columns({'/x': ['name']})))
        assert [(row.log_time, row.values) for row in rows] == [(1, {}), (2, {'name': 'a'})]
        changes, lack = map(str, bag.faults)
        assert changes == "topic '/x': it changes its type: made_up/msg/Number, made_up/msg/Text"
        assert lack == (
            "topic '/x': its messages of another type cannot be used: made_up/msg/Number has no "
            "field 'name' (it has: x)"
        )


def test_messages_that_cannot_be_decoded(tmp_path: Path) -> None:
    data = [b'', b'\0\1', number(1), b'\0\x07\0\0\5', b'\0\1\0\0']
    records = [stored(1, time, each) for time, each in enumerate(data)]
    with Bag(write_mcap(tmp_path, NUMBER, *records)) as bag:
        (row,) = in_order(bag.columns({'/x': ['x']}))
        assert (row.log_time, row.values) == (2, {'x': 1})
        assert [str(fault) for fault in bag.faults] == [
            "topic '/x': a message is shorter than its type, made_up/msg/Number (3 times)",
            "topic '/x': a message is not serialised by CDR, made_up/msg/Number",
        ]
        assert len(list(bag.messages())) == 5


def test_types_that_cannot_be_read(tmp_path: Path) -> None:
    file = write_mcap(
        tmp_path,
        schema(1, 'made_up/msg/Unknown') + channel(1, 1, '/unknown'),
        schema(2, 'made_up/msg/Odd', '?') + channel(2, 2, '/odd'),
        schema(3, 'made_up/msg/Fine', 'bool x\n') + channel(3, 3, '/json', 'json'),
        channel(4, 3, '/other', 'protobuf'),
    )
    with Bag(file) as bag:
        assert [topic.name for topic in bag.topics] == ['/json', '/odd', '/other', '/unknown']
        with pytest.raises(RecordingError, match="type 'made_up/msg/Unknown' is unknown"):
            bag.columns({'/unknown': []})
        with pytest.raises(RecordingError, match="type 'made_up/msg/Odd' cannot be read"):
            bag.fields('/odd')
        with pytest.raises(RecordingError, match="'/other' is serialised as 'protobuf'; DyKnow"):
            bag.columns({'/other': []})
        with pytest.raises(RecordingError, match="'/json': its messages are JSON without a schema"):
            bag.columns({'/json': []})
        with pytest.raises(RecordingError, match='the recording has no messages'):
            _ = bag.start_time


def test_jumps_of_time(tmp_path: Path) -> None:
    hour = 3600 * 10**9
    times = [10 * hour, 13 * hour, 13 * hour + 1, 0, 10**9]
    records = [stored(1, time, number(1)) for time in times]
    with Bag(write_mcap(tmp_path, NUMBER, *records)) as bag:
        assert [each.log_time for each in bag.messages()] == sorted(times)
        assert reasons(bag) == [
            'the log time jumps back, first for 46800 s after 46800.000000001 s',
            'no message is recorded, first for 35999 s after 1.000 s',
        ]
        assert bag.faults[1].count == 2


def test_a_chunk_whose_header_is_wrong(tmp_path: Path) -> None:
    records = [
        chunk([stored(1, time, number(1)) for time in (50, 60)], (50, 60)),
        index(1, 2),
        chunk([stored(1, time, number(1)) for time in (1, 70)], (65, 70)),
        index(1, 2),
    ]
    file = write_mcap(tmp_path, NUMBER, *records)
    with Bag(file) as bag:
        assert [each.log_time for each in bag.messages()] in ([50, 60, 70], [1, 50, 60, 70])


POINTER = b'version https://git-lfs.github.com/spec/v1\noid sha256:4d7a2146\nsize 12345\n'


@pytest.mark.parametrize(
    ('name', 'content', 'reason'),
    [
        ('a.mcap', b'', 'the file is empty'),
        ('a.db3', b'', 'the file is empty'),
        ('a.ulg', b'', 'the file is empty'),
        ('a.csv', b'', 'a trace has one column of times'),
        ('a.csv', b'time_s, x\n-10, 1\n', r'begins at -10\.000 s; no time may be below 0'),
        ('a.mcap', b'time_s, x\n', 'the file is no MCAP file'),
        ('a.db3', b'time_s, x\n', 'the file is no database of SQLite'),
        ('a.ulg', b'time_s, x\n', 'the file is no log of PX4'),
        ('a.csv', b'\xff\xfe\0', 'it is not in UTF-8'),
        ('a.db3', b'SQLite format 3\0', r'to rescue a part of it: sqlite3 .*a\.db3 \.recover'),
        (
            'a.mcap.zstd',
            zstd.compress(POINTER)[:9],
            'ends early, in its first block; was it copied',
        ),
        ('a.db3.zstd', zstd.compress(POINTER)[:9], 'ends early, in its first block; was it copied'),
        (
            'a.ulg',
            b'ULog\x01\x125\1' + bytes(99) + b'\xff\xff\x07.',
            'its beginning is damaged, or .* again',
        ),
        ('a.bag', b'#ROSBAG V2.0', 'a bag of ROS 1; convert it with: rosbags-convert --src'),
        ('a.bin', b'\xa3\x95', 'not a recording; DyKnow reads folders of rosbag2'),
        ('a.mcap', POINTER, 'a pointer file of Git LFS, not the recording; run: git lfs pull'),
        ('a.csv', POINTER, 'a pointer file of Git LFS'),
    ],
)
def test_files_that_are_no_recordings(
    tmp_path: Path, name: str, content: bytes, reason: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RecordingError, match=reason) as error:
        open_recording(tmp_path / name)
    assert str(tmp_path / name) in str(error.value)


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='there are no named pipes')
@pytest.mark.parametrize('name', ['a.mcap', 'a.db3', 'a.ulg', 'a.csv'])
def test_named_pipes_are_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    with pytest.raises(RecordingError, match='not a file; copy the recording into one'):
        open_recording(tmp_path / name)


def test_folders_that_are_no_recordings(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match='no such recording') as error:
        open_recording(tmp_path / 'none')
    assert error.value.code == ExitCode.NOT_FOUND
    with pytest.raises(RecordingError, match=r'not a recording: the folder has no metadata\.yaml'):
        open_recording(tmp_path)
    (tmp_path / 'metadata.yaml').write_text(
        'rosbag2_bagfile_information: {relative_file_paths: [a.mcap]}'
    )
    with pytest.raises(RecordingError, match=r'the files of the bag are missing: a\.mcap'):
        open_recording(tmp_path)
    (tmp_path / 'a.mcap').write_bytes(POINTER)
    with pytest.raises(RecordingError, match=r'a\.mcap: a pointer file of Git LFS'):
        open_recording(tmp_path)


def test_one_file_of_a_bag_that_is_damaged(tmp_path: Path) -> None:
    write(tmp_path / 'bag', 'mcap', 'none', [message(0)])
    (tmp_path / 'bag' / 'metadata.yaml').unlink()
    (tmp_path / 'bag' / 'bag.mcap').rename(tmp_path / 'bag' / 'bag_0.mcap')
    (tmp_path / 'bag' / 'bag_1.mcap').write_bytes(b'')
    with Bag(tmp_path / 'bag') as bag:
        assert len(list(bag.messages())) == 1
        assert 'bag_1.mcap: the file is empty' in bag.faults[-1].reason


def test_real_flights() -> None:
    # Columns of every field of every topic are what rosbags decodes.
    share = Path(__file__).parents[2] / 'dyknow_bringup' / 'recordings'
    for path in (share / 'nominal', share / 'power_surge'):
        with Bag(path) as bag:
            types = {topic.name: topic.message_type for topic in bag.topics}
            fields = {
                topic: [each.replace('..35', '').replace('..8', '') for each in bag.fields(topic)]
                for topic in types
            }
            fields = {
                t: [each for each in names if '..' not in each] for t, names in fields.items()
            }
            rows = list(in_order(bag.columns(fields)))
            assert bag.faults == ()
        expected = defaultdict(list)
        for time, topic, data in read_by_rosbags(path):
            expected[topic].append((time, STORE.deserialize_cdr(data, types[topic])))
        for topic, decoded in expected.items():
            found = [row for row in rows if row.topic == topic]
            assert [row.log_time for row in found] == [time for time, _ in decoded]
            for row, (_, each) in zip(found, decoded, strict=True):
                assert all(
                    repr(float(value)) == repr(float(value_at(each, name)))
                    for name, value in row.values.items()
                    if not isinstance(value, str)
                )


@pytest.mark.parametrize('plugin', StoragePlugin)
@pytest.mark.parametrize('known', [None, 1, 3])
def test_the_number_of_publishers(plugin: StoragePlugin, known: int | None, tmp_path: Path) -> None:
    """A recorder of ROS stores what each publisher offers; of others, the number is unknown."""
    profile = Qos(
        history=QosHistory.KEEP_LAST,
        depth=10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.VOLATILE,
        deadline=QosTime(0, 0),
        lifespan=QosTime(0, 0),
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=QosTime(0, 0),
        avoid_ros_namespace_conventions=False,
    )
    with Writer(tmp_path / 'bag', version=9, storage_plugin=plugin) as writer:
        connection = writer.add_connection(
            '/armed', BOOL, typestore=STORE, offered_qos_profiles=[profile] * (known or 0)
        )
        armed = STORE.types[BOOL](True)
        writer.write(connection, START, STORE.serialize_cdr(armed, BOOL))
    with open_recording(tmp_path / 'bag') as opened:
        assert opened.contents['/armed'].publishers == known
