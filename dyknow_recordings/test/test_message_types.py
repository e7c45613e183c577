"""Types of messages that a recording does not define, and types of any size."""

import sqlite3
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import yaml
from rosbags.typesys import Stores, get_typestore
from running_checks import run_check
from small_bags import channel, mcap, schema, stored

from dyknow_configuration import RequestedFormula
from dyknow_recordings import MessageTypes, RecordingError, evaluate_recording, open_recording
from dyknow_recordings.reading.messages import definitions
from dyknow_recordings.reading.messages.definitions import TypeDefinition
from dyknow_recordings.reading.messages.layouts import TypeLayout

START = 1_700_000_000 * 10**9
RANGE = 'sensor_msgs/msg/Range'
FORMULA = 'always "/range".range < 15'
SERVICE = 'bool data\n---\nbool success\nstring message\n'
TABLES = """
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB);
"""


def write(path: Path, topic: str, name: str, messages: Sequence[bytes]) -> Path:
    """Write a file as Humble does, without definitions."""
    database = sqlite3.connect(path)
    database.executescript(TABLES)
    database.execute("INSERT INTO topics VALUES(1, ?, ?, 'cdr')", (topic, name))
    rows = [(START + n * 10**8, each) for n, each in enumerate(messages)]
    database.executemany('INSERT INTO messages VALUES(NULL, 1, ?, ?)', rows)
    database.commit()
    database.close()
    return path


def ranges(distro: str) -> list[bytes]:
    store = get_typestore(Stores[f'ROS2_{distro.upper()}'])
    variance = [0.5] if distro == 'jazzy' else []
    found = []
    for n in range(20):
        stamp = store.types['builtin_interfaces/msg/Time'](*divmod(START + n * 10**8, 10**9))
        header = store.types['std_msgs/msg/Header'](stamp, 'sonar')
        made = store.types[RANGE](header, 0, 1.0, 0.1, 90.0, float(n), *variance)
        found.append(bytes(store.serialize_cdr(made, RANGE)))
    return found


def outcome(path: Path, types: MessageTypes | None = None) -> tuple[str, str]:
    with open_recording(path, types) as opened:
        (found,) = evaluate_recording(opened, [RequestedFormula(FORMULA)]).formulas
    return found.outcome, str(found.error or '')


@pytest.mark.parametrize('distro', ['humble', 'jazzy'])
def test_a_bag_without_definitions(tmp_path: Path, distro: str) -> None:
    path = write(tmp_path / 'a.db3', '/range', RANGE, ranges(distro))
    assert outcome(path, MessageTypes(distro)) == ('false', '')
    other = {'humble': 'jazzy', 'jazzy': 'humble'}[distro]
    fault = {'humble': 'shorter', 'jazzy': 'longer'}[distro]
    expected = (
        f"topic '/range': a message is {fault} than its type, {RANGE} by its definition in ROS 2 "
        f'{other.title()}'
    )
    found, reason = outcome(path, MessageTypes(other))
    assert found == 'error'
    assert reason.startswith('the verdict depends on messages that are lost between ')
    assert reason.endswith(expected)
    # Only Humble and those before write no definitions; the metadata knows better.
    assert outcome(path)[0] == {'humble': 'false', 'jazzy': 'error'}[distro]
    metadata = {'relative_file_paths': ['a.db3'], 'ros_distro': distro}
    content = yaml.safe_dump({'rosbag2_bagfile_information': metadata})
    (tmp_path / 'metadata.yaml').write_text(content)
    assert outcome(path) == outcome(tmp_path) == ('false', '')


@pytest.mark.parametrize('jobs', ['1', '2'])
def test_the_options(tmp_path: Path, jobs: str) -> None:
    paths = [write(tmp_path / f'{n}.db3', '/range', RANGE, ranges('jazzy')) for n in range(2)]
    options = [*paths, '--json', '--formula', FORMULA, '--jobs', jobs]
    assert run_check(*options).code == 2
    assert run_check(*options, '--distro', 'jazzy', '--messages', tmp_path).code == 1
    found = run_check(*options, '--messages', tmp_path / 'none')
    assert found.code == 2
    assert 'none: no such folder with messages' in found.out.splitlines()[-1]


def float_message(value: float) -> bytes:
    store = get_typestore(Stores.ROS2_JAZZY)
    made: Any = store.types['std_msgs/msg/Float64'](value)
    return bytes(store.serialize_cdr(made, 'std_msgs/msg/Float64'))


IDL = 'module own_msgs { module msg { struct Level { own_msgs::msg::Inner inner; }; }; };'


@pytest.mark.parametrize(
    ('is_sourced', 'file', 'text'),
    [
        (False, 'src/deep/own_msgs/msg/Level.msg', 'own_msgs/Inner inner\r\n'),
        (False, 'own_msgs/msg/Level.idl', IDL),
        (False, 'own_msgs/Level.msg', 'Inner inner'),
        (True, 'own_msgs/msg/Level.msg', 'Inner inner'),
        (True, 'own_msgs/msg/Level.idl', IDL),
    ],
)
def test_messages_of_folders_and_workspaces(
    tmp_path: Path, *, is_sourced: bool, file: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = 'own_msgs/msg/Level'
    path = write(tmp_path / 'a.db3', '/level', name, [float_message(1.5)])
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path / "none"}:{tmp_path / "install"}')
    folder = tmp_path / ('install/share' if is_sourced else 'messages')
    with open_recording(path) as opened:
        assert opened.contents['/level'].fields is None
        assert 'give the folder of its .msg file by --messages' in opened.fault_of('/level')
    (folder / file).parent.mkdir(parents=True)
    (folder / file).write_text(text)
    (folder / file).with_name('Inner.msg').write_text('float64 x')
    definitions._members.cache_clear()  # No command looks again.
    with open_recording(path, None if is_sourced else MessageTypes(folders=(folder,))) as opened:
        (part,) = opened.columns({'/level': ['inner.x']})
        assert part.values['inner.x'].tolist() == [1.5]


@pytest.mark.parametrize('source', ['recording', 'folder', 'workspace'])
def test_events_of_a_service(tmp_path: Path, source: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name, topic = 'own_msgs/srv/Set_Event', '/set/_service_event'
    info = (
        b'\1' + bytes(3) + (7).to_bytes(4, 'little') + bytes(4 + 16 + 4) + (9).to_bytes(8, 'little')
    )
    request = (1).to_bytes(4, 'little') + b'\1' + bytes(3)
    data = bytes.fromhex('00010000') + info + request + bytes(4)
    folder = tmp_path / 'share' / 'own_msgs' / 'srv'
    folder.mkdir(parents=True)
    (folder / 'Set.srv').write_text(SERVICE)
    types = None
    if source == 'recording':
        # As rosbag2 writes it: the encoding is unknown without a message in the service.
        text = f'{"=" * 80}\nSRV: own_msgs/srv/Set\n{SERVICE}'
        path = tmp_path / 'a.mcap'
        path.write_bytes(
            mcap(schema(1, name, text, 'unknown'), channel(1, 1, topic), stored(1, START, data))
        )
    else:
        path = write(tmp_path / 'a.db3', topic, name, [data])
        types = MessageTypes(folders=(tmp_path,)) if source == 'folder' else None
        monkeypatch.setenv('AMENT_PREFIX_PATH', str(tmp_path))
    with open_recording(path, types) as opened:
        wanted = [
            'info.event_type',
            'info.sequence_number',
            'request[0].data',
            'response[0].success',
        ]
        (part,) = opened.columns({topic: wanted})
    assert [part.values[each].tolist() for each in wanted[:3]] == [[1], [9], [True]]
    assert 'response[0].success' in part.absent


def chain(count: int, field: str) -> str:
    separator = f'{"=" * 80}\nMSG: own_msgs/'
    parts = [f'{separator}T{n}\n' + field.replace('T', f'T{n + 1}') for n in range(count)]
    return f'T0 x\n{"".join(parts)}{separator}T{count}\nstring x\n'


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        (chain(30, 'T x\nT y\n'), 'is too large'),
        (chain(9, 'T[100] x\n'), 'is too large'),
        (chain(9, 'T[100] x\n').replace('string x', 'float64 x'), 'is too large'),
        (chain(99, 'T x\n'), 'contains itself, or is nested too deeply'),
        ('Top[] x\nTop[] y\n', 'contains itself, or is nested too deeply'),
    ],
)
def test_types_of_any_size(text: str, reason: str) -> None:
    with pytest.raises(RecordingError, match=reason):
        TypeLayout(TypeDefinition('own_msgs/msg/Top', 'ros2msg', text))


def test_folders_of_any_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(definitions, 'MAX_FILES', 3)
    monkeypatch.setattr(definitions, 'MAX_DEFINITION', 100)
    path = tmp_path / 'large' / 'msg' / 'A.msg'
    path.parent.mkdir(parents=True)
    path.write_text('# ' * 51)
    with pytest.raises(RecordingError, match=r'A\.msg: the definition of .* is larger than 100'):
        MessageTypes(folders=(tmp_path / 'large',)).members('large/msg/A')
    path.with_name('B.msg').touch()
    path.with_name('C.msg').touch()
    with pytest.raises(RecordingError, match='more than 3 files'):
        MessageTypes(folders=(tmp_path,)).members('large/msg/B')
    with pytest.raises(RecordingError, match='no such folder with messages'):
        MessageTypes(folders=(tmp_path / 'none',)).members('large/msg/B')
