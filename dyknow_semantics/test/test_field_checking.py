"""Annotations against the fields of their streams."""

from __future__ import annotations

import pytest

from dyknow_common import ExitCode, LanguageError, ValueType
from dyknow_semantics import Knowledge, check_annotation, check_fields, parse_annotations

FIELDS = {
    'id': ValueType.STRING,
    'number': ValueType.INT,
    'position.z': ValueType.FLOAT,
    'ranges[0..]': ValueType.FLOAT,
    'is_day': ValueType.BOOLEAN,
}


def check(text: str, knowledge: Knowledge) -> None:
    """Checks a text in SSL."""
    (annotation,) = parse_annotations(text)
    check_annotation(annotation, knowledge)
    check_fields(annotation, knowledge, 'a/msg/B', FIELDS)


@pytest.mark.parametrize(
    'text',
    [
        'stream a contains Altitude[v] = position.z for every v in Vehicle where v = id',
        'stream a contains Altitude[uav1] = number, Daylight = is_day',
        'stream a contains Altitude[uav1] = ranges[3]',
    ],
)
def test_fields_that_hold_what_they_should(knowledge: Knowledge, text: str) -> None:
    check(text, knowledge)


@pytest.mark.parametrize(
    ('text', 'code', 'message'),
    [
        (
            'stream a contains Altitude[uav1] = position.y',
            ExitCode.NOT_FOUND,
            "a/msg/B has no field 'position.y' (position has: z)",
        ),
        (
            'stream a contains Altitude[uav1] = position',
            ExitCode.NOT_FOUND,
            "a/msg/B has no field 'position': it is not a single value; ask for position.z",
        ),
        (
            'stream a contains Altitude[uav1] = id',
            ExitCode.INVALID_ARGUMENT,
            (
                "feature 'Altitude' has values of the type float, but field 'id' of a/msg/B is of "
                'the type string'
            ),
        ),
        (
            'stream a contains Daylight = position.z',
            ExitCode.INVALID_ARGUMENT,
            (
                "feature 'Daylight' has values of the type boolean, but field 'position.z' of "
                'a/msg/B is of the type float'
            ),
        ),
        (
            'stream a contains Altitude[v] = position.z for every v in Vehicle where v = number',
            ExitCode.INVALID_ARGUMENT,
            (
                "the field that names the object 'v' must be of the type string, but 'number' of "
                'a/msg/B is of the type int'
            ),
        ),
        (
            'stream a contains Altitude[v] = position.z for every v in Vehicle where v = ident',
            ExitCode.NOT_FOUND,
            "a/msg/B has no field 'ident'",
        ),
    ],
)
def test_fields_that_do_not(knowledge: Knowledge, text: str, code: ExitCode, message: str) -> None:
    with pytest.raises(LanguageError) as error:
        check(text, knowledge)
    assert error.value.code is code
    assert message in error.value.message
    assert error.value.message.splitlines()[-1].strip() == '^'
