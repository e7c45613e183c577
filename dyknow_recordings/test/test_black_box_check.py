"""A check of a black box gives no verdict that the states before the box may change."""

from __future__ import annotations

from base64 import b64encode
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from running_checks import run_check

from dyknow_common import SECOND_NS
from dyknow_recordings import BLACK_BOX, BlackBoxContent, RecordingError, read_black_box

S = SECOND_NS
BOOL = 'std_msgs/msg/Bool'
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
        connection = writer.add_connection('/p', BOOL, typestore=TYPES)
        for second, value in enumerate(values, start=10):
            message = TYPES.types[BOOL](data=value)
            data = TYPES.serialize_cdr(message, message.__msgtype__)
            writer.write(connection, second * S, data)
    return path


def content(formula: str, **more: object) -> BlackBoxContent:
    return BlackBoxContent('f', formula, states=STATES, **more)  # type: ignore[arg-type]


def checked(path: Path) -> dict[str, Any]:
    (found,) = run_check(path, '--json').formulas
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
        ('always (once[0 s, 1 s] P)', {}, 'undecided'),
        ('always previous P', {}, 'false'),
        ('(always P or not P) and always previous P', {}, 'false'),
        # The first states are left out, of which the past is not known.
        ('always (once[0 s, 2 s] not P)', {}, 'false'),
        ('always (once[0 s, 4 s] not P)', {}, 'undecided'),
        ('always (once[0 s, 7 s] not P)', {}, 'error'),
        ('always (once not P)', {}, 'error'),
        ('always ((once[2 s, inf] true) -> previous P)', {}, 'false'),
        ('always ((once[7 s, inf] true) -> previous P)', {}, 'error'),
        ('always previous P', {'begin': 14 * S}, 'undecided'),
        ('always previous P', {'begin': 10 * S, 'is_complete': True}, 'false'),
        ('always previous P', {'begin': 9 * S, 'is_complete': True}, 'error'),
        ('eventually previous P', {}, 'error'),
        ('always (once[0 s, 1 s] P)', {'begin': 10 * S, 'is_complete': True}, 'undecided'),
        ('previous P', {'every_state': True}, 'false'),
        ('previous not P', {'every_state': True}, 'false'),
        ('previous P or not P or P', {'every_state': True}, 'true'),
        ('once[0 s, 4 s] not P', {'every_state': True}, 'true'),
        ('once[0 s, 7 s] not P', {'every_state': True}, 'error'),
        ('once not P', {'every_state': True}, 'error'),
        ('previous P', {'every_state': True, 'begin': 10 * S, 'is_complete': True}, 'false'),
    ],
)
def test_verdicts_of_a_black_box(
    tmp_path: Path, formula: str, more: dict[str, object], outcome: str
) -> None:
    path = write(tmp_path, content(formula, **more), VALUES)
    assert checked(path)['outcome'] == outcome


def test_the_error_names_the_mend(tmp_path: Path) -> None:
    path = write(tmp_path, content('eventually[0 s, 2 s] not P'), VALUES)
    assert checked(path)['error'] == {
        'code': 'NOT_FOUND',
        'message': 'the black box begins after the first state of the formula; the verdict '
        'depends on its first state: check a recording from its first state on',
    }


def test_an_invariant_about_the_past_is_false_again_at_the_same_state(tmp_path: Path) -> None:
    box = content('always previous P', verdict='false', decided_at=14 * S, margin=True)
    path = write(tmp_path, box, VALUES)
    found = run_check(path, '--json').document
    (formula,) = found['formulas']
    (episode,) = formula['episodes']
    assert (episode['begin_ns'], episode['decided_at_ns']) == (11 * S, 14 * S)
    assert (formula['states'], found['notes']) == (5, [])
    assert formula['events'] == [
        'the verdict looks back to earlier states: the states before 11.000 s are left out'
    ]
    assert run_check(path, '--html', tmp_path / 'page.html').code == 1


LATE = 'stream a = select data as P from "/p" with max_gap = 1 s;\nsink sync(a)'


@pytest.mark.parametrize('states', [STATES, LATE])
def test_states_that_look_back_before_the_box_are_left_out(tmp_path: Path, states: str) -> None:
    formula = 'once[0 s, 2 s] (P and previous P)'
    box = replace(content(formula, every_state=True), states=states)
    found = checked(write(tmp_path, box, VALUES))
    assert [each['begin_ns'] // S for each in found['episodes']] == [13, 14, 15, 16]


def test_a_later_evaluation_of_a_black_box_begins_after_the_first_state(tmp_path: Path) -> None:
    states = STATES.replace(';', ' with max_gap = 900 ms, max_delay = 100 ms;')
    box = replace(content('previous P', every_state=True), states=states)
    (found,) = run_check(write(tmp_path, box, VALUES), '--retry', '--json').formulas
    assert [each['begin_ns'] // S for each in found['episodes']] == [11, 13, 16]
    assert [each['episodes'] for each in found['attempts']] == [0, 1, 1, 1]


def test_another_verdict_than_that_of_the_system_is_noted(tmp_path: Path) -> None:
    box = content('always P', verdict='false', decided_at=15 * S)
    found = run_check(write(tmp_path, box, VALUES), '--json')
    assert found.document['notes'] == ["the running system decided that 'f' is false at 15.000 s"]


def test_states_keep_their_period(tmp_path: Path) -> None:
    constraints = 'start_time = 9500 ms, sample_period = 1 s'
    box = content('always P', constraints=constraints)
    found = checked(write(tmp_path, box, VALUES))
    assert found['episodes'][0]['decided_at_ns'] == 13_500_000_000


@pytest.mark.parametrize(
    ('formula', 'begin', 'more', 'verdict'),
    [
        ('eventually[0 s, 2 s] not (A and P)', 10.5, {}, ('true', 12.0)),
        ('eventually[0 s, 1 s] not (A and P)', 10.5, {}, ('false', 11.5)),
        ('always once[0 s, 1 s] (A and P)', 10.5, {'every_state': True}, ('false', 13.0)),
        # In the bag are messages from before the formula: of a time without /p, and a late one.
        ('always[0 s, 4 s] (A and P)', 20.5, {'is_late': True}, ('true', 24.5)),
        ('always[0 s, 4 s] (A and P)', 20.5, {'is_late': True, 'rate': 1500}, ('true', 24.5)),
    ],
)
def test_the_first_state_is_made_of_messages_from_before_it(
    tmp_path: Path, formula: str, begin: float, more: dict[str, Any], verdict: tuple[str, float]
) -> None:
    gap = f' with max_gap = {rate} ms' if (rate := more.pop('rate', None)) else ''
    texts = (f'stream {name} = select data as {name.upper()} from "/{name}"' for name in 'ap')
    states = f'{";".join(texts)}{gap};sink sync(a, p)'
    is_late = more.pop('is_late', False)
    box = BlackBoxContent(
        'f', formula, states=states, begin=round(begin * S), is_complete=True, **more
    )
    path = tmp_path / 'box'
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    for key, text in box.custom_data.items():
        writer.set_custom_data(key, text)
    with writer:
        topics = [writer.add_connection(name, BOOL, typestore=TYPES) for name in ('/a', '/p')]
        for second in range(10, 30):
            for number, connection in enumerate(topics):
                if number and is_late and 10 < second < 20:
                    continue
                data = TYPES.serialize_cdr(TYPES.types[BOOL](data=second != 12), BOOL)
                writer.write(connection, second * S + number * S // 2, data)
    found = checked(path)
    assert not found['error'], found
    episode = found['episodes'][0]
    assert episode['begin_ns'] == begin * S
    assert (episode['verdict'], episode['decided_at_ns']) == (verdict[0], verdict[1] * S)


def test_options_take_the_place_of_the_content(tmp_path: Path) -> None:
    path = write(tmp_path, content('always P'), VALUES)
    assert run_check(path, '--formula', 'eventually not "/p".data').code == 0
    refused = run_check(path, '--every', 'state')
    assert refused.code == 2
    assert 'the black box says from which states its formula is evaluated' in refused.err


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
    assert run_check(path).code == 2


def test_a_long_content_survives_its_metadata(tmp_path: Path) -> None:
    texts = tuple(f'stream s{n} = select "a\\nb" as x from "/p";\nsink s{n}' for n in range(99))
    path = write(tmp_path, content('always P', streams=texts, explanation='\\' * 300), VALUES)
    found = read_black_box(path)
    assert found is not None
    assert tuple(found.streams) == texts


def test_a_bag_that_is_no_black_box_needs_a_formula(tmp_path: Path) -> None:
    path = write(tmp_path, content('always P'), VALUES)
    metadata = path / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(BLACK_BOX, 'other'))
    found = run_check(path)
    assert (found.code, 'there is no formula to check' in found.err) == (2, True)
