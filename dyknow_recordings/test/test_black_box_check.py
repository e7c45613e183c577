"""A check of a black box gives no verdict that the states before the box may change."""

from __future__ import annotations

import json
from base64 import b64encode
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from dyknow_common import SECOND_NS
from dyknow_recordings import BLACK_BOX, BlackBoxContent, RecordingError, read_black_box
from dyknow_recordings.check import main

S = SECOND_NS
TYPES = get_typestore(Stores.ROS2_JAZZY)
STATES = 'stream a = select data as P from "/p";\nsink sync(a)'


def write(folder: Path, content: BlackBoxContent | str, values: list[bool]) -> Path:
    """Write a bag with a value each second from 10 s on."""
    path = folder / 'box'
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    if isinstance(content, str):
        writer.set_custom_data(BLACK_BOX, b64encode(content.encode()).decode())
    else:
        for key, text in content.custom_data.items():
            writer.set_custom_data(key, text)
    with writer:
        connection = writer.add_connection('/p', 'std_msgs/msg/Bool', typestore=TYPES)
        for second, value in enumerate(values, start=10):
            message = TYPES.types['std_msgs/msg/Bool'](data=value)
            data = TYPES.serialize_cdr(message, message.__msgtype__)
            writer.write(connection, second * S, data)
    return path


def content(formula: str, **more: object) -> BlackBoxContent:
    return BlackBoxContent('f', formula, states=STATES, **more)  # type: ignore[arg-type]


def checked(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    main([str(path), '--json'])
    (found,) = json.loads(capsys.readouterr().out)['formulas']
    return dict(found)


VALUES = [True, True, True, False, True, True, True]


@pytest.mark.parametrize(
    ('formula', 'more', 'outcome'),
    [
        ('always P', {}, 'false'),
        ('always P', {'every_state': True}, 'false'),
        ('always P', {'begin': 14 * S}, 'undecided'),
        ('always (P or eventually[0 s, 1 s] P)', {}, 'undecided'),
        ('eventually[0 s, 2 s] not P', {}, 'error'),
        ('eventually[0 s, 2 s] not P', {'every_state': True}, 'false'),
        ('eventually[0 s, 2 s] not P', {'begin': 10 * S, 'is_complete': True}, 'false'),
        # The first recorded message is later than the first state of the formula.
        ('eventually[0 s, 2 s] not P', {'begin': 9 * S, 'is_complete': True}, 'error'),
        ('(always P) or (always not P)', {}, 'error'),
        ('always[0 s, 2 s] P', {}, 'error'),
        ('always (once[0 s, 1 s] P)', {}, 'error'),
        ('always (once[0 s, 1 s] P)', {'begin': 10 * S, 'is_complete': True}, 'undecided'),
        ('previous P', {'every_state': True}, 'error'),
        ('previous P', {'every_state': True, 'begin': 10 * S, 'is_complete': True}, 'false'),
    ],
)
def test_verdicts_of_a_black_box(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    formula: str,
    more: dict[str, object],
    outcome: str,
) -> None:
    path = write(tmp_path, content(formula, **more), VALUES)
    assert checked(path, capsys)['outcome'] == outcome


def test_the_error_names_the_mend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path, content('eventually[0 s, 2 s] not P'), VALUES)
    assert checked(path, capsys)['error'] == {
        'code': 'NOT_FOUND',
        'message': 'the black box begins after the first state of the formula, whose verdict '
        "depends on its first state; record more with a longer 'before'",
    }


def test_another_verdict_than_that_of_the_system_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box = content('always P', verdict='false', decided_at=15 * S)
    main([str(write(tmp_path, box, VALUES)), '--json'])
    notes = json.loads(capsys.readouterr().out)['notes']
    assert notes == ["the running system decided that 'f' is false at 15.000 s"]


def test_states_keep_their_period(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    constraints = 'start_time = 9500 ms, sample_period = 1 s'
    box = content('always P', constraints=constraints)
    found = checked(write(tmp_path, box, VALUES), capsys)
    assert found['episodes'][0]['decided_at_ns'] == 13_500_000_000  # type: ignore[index]


def test_options_take_the_place_of_the_content(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, content('always P'), VALUES)
    assert main([str(path), '--formula', 'eventually not "/p".data']) == 0
    assert main([str(path), '--every', 'state']) == 2
    assert (
        'the black box says from which states its formula is evaluated' in capsys.readouterr().err
    )


def test_the_file_of_a_black_box_is_one(tmp_path: Path) -> None:
    box = content('always P', domains={'A': ('a', 'b')})
    path = write(tmp_path, box, VALUES)
    found = read_black_box(path / 'box.mcap')
    assert found is not None
    assert found.text == box.text
    assert read_black_box(tmp_path) is None


@pytest.mark.parametrize(
    'damaged',
    [
        '', '[]', '{}', '{"name": "a"}', '{"name": "a", "formula": "always ("}', '{"name": 1',
        '{"name": "a", "formula": "a.b = 1", "begin": "1"}',
        '{"name": "a", "formula": "a.b = 1", "domains": {"A": [1]}}',
        '{"name": "a", "formula": "a.b = 1", "domains": []}',
        '{"name": "a", "formula": "a.b = 1", "streams": "sink a"}',
    ],
)  # fmt: skip
def test_a_damaged_content_is_an_error(tmp_path: Path, damaged: str) -> None:
    path = write(tmp_path, damaged, VALUES)
    with pytest.raises(RecordingError, match=r'black box in metadata\.yaml is damaged'):
        read_black_box(path)
    assert main([str(path)]) == 2


def test_a_long_content_survives_its_metadata(tmp_path: Path) -> None:
    texts = tuple(f'stream s{n} = select "a\\nb" as x from "/p";\nsink s{n}' for n in range(99))
    path = write(tmp_path, content('always P', streams=texts, explanation='\\' * 300), VALUES)
    found = read_black_box(path)
    assert found is not None
    assert tuple(found.streams) == texts


def test_a_bag_that_is_no_black_box_needs_a_formula(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write(tmp_path, content('always P'), VALUES)
    metadata = path / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(BLACK_BOX, 'other'))
    assert main([str(path)]) == 2
    assert 'there is no formula to check' in capsys.readouterr().err
