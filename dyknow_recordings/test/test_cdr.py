import re
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_types import Member, all_values, definition, messages, types
from rosbags.rosbag2 import StoragePlugin, Writer

from dyknow_common import ValueType, listed_as
from dyknow_recordings import Bag
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.cdr import CdrReader
from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.layouts import TypeLayout
from dyknow_recordings.reading.messages.stored_messages import StoredMessages

Drawn = tuple[dict[str, list[Member]], list[Any], list[bytes]]
SHORT = 'a message is shorter than its type'


def same(value: Any, expected: Any) -> bool:
    return bool(value == expected) or (value != value and expected != expected)  # noqa: PLR0124 - NaN


@given(messages(), st.data())
def test_every_field_is_what_rosbags_decodes(drawn: Drawn, data: st.DataObject) -> None:
    made, decoded, serialised = drawn
    expected = [all_values(message, made) for message in decoded]
    layout = TypeLayout(definition(made))
    known = sorted(set().union(*expected))
    assert all(listed_as(layout.fields, path) for path in known)
    paths = data.draw(st.lists(st.sampled_from(known), unique=True)) if known else []
    fields, faults = CdrReader(layout, paths).read(stored(serialised))
    assert faults == {}
    assert fields.intact.all()
    assert set(fields.values) == set(paths)
    for path in paths:
        for row, values in enumerate(expected):
            assert (path in values) == (row not in fields.absent.get(path, {}))
            assert path not in values or same(fields.values[path].tolist()[row], values[path])


@given(messages(), st.data())
def test_messages_that_are_cut_are_found(drawn: Drawn, data: st.DataObject) -> None:
    made, decoded, serialised = drawn
    expected = [all_values(message, made) for message in decoded]
    cuts = [data.draw(st.integers(0, len(each))) for each in serialised]
    paths = sorted(set().union(*expected))
    # A message may end with bytes that align what follows it in another message.
    cut = [each[:size] for each, size in zip(serialised, cuts, strict=True)]
    fields, faults = CdrReader(TypeLayout(definition(made)), paths).read(stored(cut))
    whole = [size == len(each) for each, size in zip(serialised, cuts, strict=True)]
    assert sum(faults.values()) == len(cut) - int(fields.intact.sum())
    assert fields.intact.tolist() == whole
    for path in paths:
        for row in np.flatnonzero(fields.intact).tolist():
            if path in expected[row]:
                assert same(fields.values[path].tolist()[row], expected[row][path])


@given(types(), st.lists(st.binary(max_size=60), min_size=1, max_size=5))
def test_any_bytes_are_read_or_counted(made: dict[str, list[Member]], data: list[bytes]) -> None:
    layout = TypeLayout(definition(made))
    paths = [path for path in layout.fields if '[' not in path]
    headed = [b'\0\1\0\0' + each for each in data[1:]] + data[:1]
    fields, faults = CdrReader(layout, paths).read(stored(headed))
    assert sum(faults.values()) == len(data) - int(fields.intact.sum())


def stored(messages: Sequence[bytes]) -> StoredMessages:
    return StoredMessages.of(range(len(messages)), [0] * len(messages), messages)


def read(text: str, paths: list[str], *serialised: bytes) -> Any:
    layout = TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', text))
    return CdrReader(layout, paths).read(stored(serialised))


@pytest.mark.parametrize(('order', 'header'), [('<', b'\0\1\0\0'), ('>', b'\0\0\0\0')])
def test_wide_strings(order: str, header: bytes) -> None:
    units = [0x41, 0xD83D, 0xDE80]
    data = header + struct.pack(f'{order}I3Id', 3, *units, 0.5)
    fields, faults = read('wstring<=4 name\nfloat64 x\n', ['name', 'x'], data)
    assert faults == {}
    assert fields.values['name'].tolist() == ['A\N{ROCKET}']
    assert fields.values['x'].tolist() == [0.5]


IDL = """
module made_up {
  module msg {
    struct Top {
      octet a;
      long double wide;
      char grade;
      char grades[2];
      sequence<char> more;
      double x;
    };
  };
};
"""


def test_characters_of_idl_are_texts_and_long_doubles_are_left_out() -> None:
    """A `char` of IDL is a text in rclpy, unlike that of a .msg file, which is an uint8."""
    layout = TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2idl', IDL))
    text = ValueType.STRING
    assert layout.fields == {
        'a': ValueType.INT,
        'grade': text,
        'grades[0..1]': text,
        'more[0..]': text,
        'x': ValueType.FLOAT,
    }
    # As Fast CDR 2.2.5 writes it: 16 bytes, which are aligned to 8.
    head = b'\0\1\0\0' + bytes([7]) + bytes(7) + bytes(16)
    data = head + b'ABC' + b'\0' + struct.pack('<I', 1) + b'D' + bytes(7) + struct.pack('<d', 0.5)
    paths = ['grade', 'grades[1]', 'more[0]', 'count(more = "D")', 'x']
    fields, faults = CdrReader(layout, paths, is_exact=True).read(stored([data, data[:30]]))
    assert faults == {'a message is shorter than its type': 1}
    fields = fields.intact_rows()
    assert {path: fields.values[path].tolist() for path in paths} == {
        'grade': ['A'],
        'grades[1]': ['C'],
        'more[0]': ['D'],
        'count(more = "D")': [1],
        'x': [0.5],
    }


WIDE = """
module made_up {
  module msg {
    struct Letter {
      octet a;
      WIDE;
      octet b;
    };
    struct Top {
      double x;
      MEMBERS
      double y;
    };
  };
};
"""


@pytest.mark.parametrize(
    ('wide', 'members', 'readable'),
    [
        ('octet w', 'wchar w;', ['x']),
        ('octet w', 'wchar w[2];', ['x']),
        ('octet w', 'sequence<wchar> w;', ['x']),
        ('wchar w', 'Letter first; Letter second;', ['x', 'first.a']),
        ('wchar w', 'sequence<Letter> letters;', ['x']),
        ('wchar w', 'Letter letters[2];', ['x']),
    ],
)
def test_what_precedes_a_wide_character_is_read(
    wide: str, members: str, readable: list[str]
) -> None:
    """A wide character has 2 bytes or 4, so nobody knows where the next field begins."""
    idl = WIDE.replace('WIDE', wide).replace('MEMBERS', members)
    layout = TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2idl', idl))
    assert list(layout.fields) == readable
    data = b'\0\1\0\0' + struct.pack('<d', 0.5) + bytes([7]) + bytes(40)
    fields, faults = CdrReader(layout, readable, is_exact=True).read(stored([data]))
    assert faults == {}
    expected = {'x': 0.5, 'first.a': 7}
    assert all(fields.values[path].tolist() == [expected[path]] for path in readable)
    assert re.match("'w' of made_up/msg/.*, a wchar, and what follows it are not", layout.unread)


def test_what_is_not_read_of_a_wide_character_is_noted(tmp_path: Path) -> None:
    text = f'{"=" * 80}\nIDL: made_up/msg/Top\n{WIDE.replace("WIDE", "octet w")}'
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        text = text.replace('MEMBERS', 'wchar w;')
        topic = writer.add_connection('/top', 'made_up/msg/Top', msgdef=text, rihs01='x')
        writer.write(topic, 1, b'\0\1\0\0' + struct.pack('<d2sxxxxxxd', 0.5, b'A', 1.0))
    with Bag(tmp_path / 'bag') as bag:
        assert bag.contents['/top'].fields == {'x': ValueType.FLOAT}
        (part,) = bag.columns({'/top': ['x']})
        (fault,) = bag.faults
    assert part.values['x'].tolist() == [0.5]
    assert str(fault).startswith("the type of topic '/top': 'w' of made_up/msg/Top, a wchar, and")


def test_types_keep_their_width() -> None:
    data = b'\0\1\0\0' + struct.pack('<QB', 2**64 - 1, 1)
    fields, _ = read('uint64 count\nbool on\n', ['count', 'on'], data)
    assert fields.values['count'].dtype == np.uint64
    assert fields.values['count'].tolist() == [2**64 - 1]
    assert fields.values['on'].tolist() == [True]


def test_an_empty_type_is_one_byte() -> None:
    text = f'made_up/Nothing nothing\nuint8 x\n{"=" * 80}\nMSG: made_up/Nothing\n'
    layout = TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', text))
    assert layout.fields == {'x': ValueType.INT}
    fields, _ = CdrReader(layout, ['x']).read(stored([b'\0\1\0\0\0\7']))
    assert fields.values['x'].tolist() == [7]


def test_a_string_that_is_not_utf_8_and_one_without_an_end() -> None:
    data = [b'\0\1\0\0\2\0\0\0\xff\0', b'\0\1\0\0\1\0\0\0a', b'\0\1\0\0\0\0\0\0']
    fields, faults = read('string x\n', ['x'], *data)
    assert faults == {}
    assert fields.values['x'].tolist() == ['\N{REPLACEMENT CHARACTER}', 'a', '']


def test_huge_lengths_end_at_once() -> None:
    text = f'made_up/Named[] all\n{"=" * 80}\nMSG: made_up/Named\nstring name\n'
    _, faults = read(text, [], b'\0\1\0\0\xff\xff\xff\xff')
    assert faults == {SHORT: 1}


def test_unknown_types() -> None:
    with pytest.raises(RecordingError, match="the message type 'made_up/msg/Top' is unknown"):
        TypeLayout(TypeDefinition('made_up/msg/Top'))
    with pytest.raises(RecordingError, match="message type 'made_up/msg/No' is unknown"):
        TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', 'No x\n'))
    with pytest.raises(RecordingError, match=r"definition of .* 'made_up/msg/Top' cannot be read"):
        TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', 'float64'))
    with pytest.raises(RecordingError, match=r"definition of .* 'made_up/msg/Top' cannot be read"):
        TypeLayout(TypeDefinition('made_up/msg/Top', 'protobuf', 'float64 x'))
    with pytest.raises(RecordingError, match="message type 'made_up/msg/Top' contains itself"):
        TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', 'Top[] x\n'))


def test_a_header_without_a_stamp() -> None:
    text = f'std_msgs/Header header\n{"=" * 80}\nMSG: std_msgs/Header\nuint8 stamp\n'
    layout = TypeLayout(TypeDefinition('made_up/msg/Top', 'ros2msg', text))
    assert layout.stamp_fields == ()


def test_a_type_of_ros_without_a_definition() -> None:
    layout = TypeLayout(TypeDefinition('sensor_msgs/msg/LaserScan'))
    assert layout.fields['ranges[0..]'] is ValueType.FLOAT
    assert layout.stamp_fields == ('header.stamp.sec', 'header.stamp.nanosec')
    with pytest.raises(RecordingError, match="LaserScan has no field 'range'"):
        layout.check(['range_max', 'range'])
