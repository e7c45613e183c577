"""Annotations of values in arrays, and of messages that carry many objects."""

from __future__ import annotations

import pytest

from dyknow_common import LanguageError, ValueType
from dyknow_semantics import (
    Knowledge,
    check_annotation,
    check_fields,
    match,
    parse_annotations,
    parse_concept,
)

DIAGNOSTICS = {
    'header.stamp.sec': ValueType.INT,
    'status[0..].name': ValueType.STRING,
    'status[0..].level': ValueType.INT,
    'status[0..].values[0..].key': ValueType.STRING,
    'status[0..].values[0..].value': ValueType.STRING,
}
POSES = {'poses[0..].position.z': ValueType.FLOAT}


def checked(text: str, knowledge: Knowledge, fields: dict[str, ValueType]) -> None:
    (annotation,) = parse_annotations(text)
    assert parse_annotations(str(annotation)) == (annotation,)
    check_annotation(annotation, knowledge)
    check_fields(annotation, knowledge, 'a/msg/B', fields)


def streams(concept: str, ssl: str, knowledge: Knowledge) -> list[str]:
    found = match(parse_concept(concept), parse_annotations(ssl), knowledge)
    return [str(each.declaration.stream) for each in found]


@pytest.mark.parametrize(
    ('text', 'fields', 'concept', 'expected'),
    [
        (
            'stream "/d" contains Altitude[uav1] = status[name = "uav1"].level',
            DIAGNOSTICS,
            'Altitude[uav1]',
            'select number(status[name = "uav1"].level) as "Altitude[uav1]" from "/d"',
        ),
        (
            'stream "/d" contains Altitude[uav1] = max(status.level) with max_delay = 1 s',
            DIAGNOSTICS,
            'Altitude[uav1]',
            'select max(status.level) as "Altitude[uav1]" from "/d" with max_delay = 1 s',
        ),
        (
            (
                'stream each status as s in "/d" contains Altitude[u] = s.values[key = "z"].value '
                'for every u in UAV where u = s.name'
            ),
            DIAGNOSTICS,
            'Altitude[uav2]',
            (
                'select number(s.values[key = "z"].value) as "Altitude[uav2]" '
                'from each status as s in "/d" where s.name = "uav2"'
            ),
        ),
        (
            (
                'stream each poses as p in "/p" contains Altitude[u] = p.position.z '
                'for every u in UAV where u = "uav%index(p)%"'
            ),
            POSES,
            'Altitude[uav1]',
            (
                'select p.position.z as "Altitude[uav1]" from each poses as p in "/p" '
                'where index(p) = 1'
            ),
        ),
        (
            (
                'stream each status as s in "/d" contains Altitude[u] = s.level '
                'for every u in UAV where u = "uav%s.level%"'
            ),
            DIAGNOSTICS,
            'Altitude[uav1]',
            (
                'select s.level as "Altitude[uav1]" from each status as s in "/d" '
                'where text(s.level) = "1"'
            ),
        ),
    ],
)
def test_streams_of_values_in_arrays(
    text: str, fields: dict[str, ValueType], concept: str, expected: str, knowledge: Knowledge
) -> None:
    checked(text, knowledge, fields)
    assert streams(concept, text, knowledge) == [expected]


def test_objects_whose_names_no_value_makes(knowledge: Knowledge) -> None:
    text = 'stream each poses as p in "/p" contains Altitude[v] = p.position.z '
    text += 'for every v in Vehicle where v = "uav%index(p)%"'
    found = streams('Altitude', text, knowledge)
    assert [each.rpartition(' ')[2] for each in found] == ['1', '2']


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (
            'stream each level as s in "/d" contains Altitude[uav1] = s.level',
            "a/msg/B: 'level' is not an array (arrays are in: status, status.values)",
        ),
        (
            (
                'stream each status as s in "/d" contains Altitude[u] = s.level '
                'for every u in UAV where u = s.level'
            ),
            'but \'s.level\' of a/msg/B is of the type int; write u = "name_%s.level%"',
        ),
        (
            'stream "/d" contains Altitude[uav1] = max(status.name)',
            "'status[0..].name' is a string, and max takes numbers",
        ),
        (
            'stream "/d" contains Altitude[uav1] = status[id = "x"].level',
            "the elements of 'status' have no 'id', and no array 'id' is beside it",
        ),
        (
            'stream "/d" contains Altitude[u] = level for every u in UAV where u = "a%b%"',
            "a/msg/B has no field 'level'; did you mean 'status[0].level'?",
        ),
    ],
)
def test_faults(text: str, message: str, knowledge: Knowledge) -> None:
    with pytest.raises(LanguageError) as error:
        checked(text, knowledge, DIAGNOSTICS)
    assert message in str(error.value)
