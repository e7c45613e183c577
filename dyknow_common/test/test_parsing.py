"""Parsing that all languages share: constraints, and errors at positions."""

from __future__ import annotations

import pytest

from dyknow_common import (
    NOWHERE,
    ConstraintBuilder,
    DyKnowError,
    ExitCode,
    Language,
    LanguageError,
    PositionedError,
    TextPosition,
)

CONSTRAINT = Language('constraint', 'dyknow_common', 'common.lark', {}, 'constraint')


def test_a_constraint() -> None:
    builder = ConstraintBuilder[tuple[str, int]]()
    assert CONSTRAINT.parse('max_delay=1.5 s', builder) == ('max_delay', 1_500_000_000)
    assert CONSTRAINT.parse('reorder=true', builder) == ('reorder', True)
    assert CONSTRAINT.parse('reorder=false', builder) == ('reorder', False)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('max_delay=5 days', "1:11: unknown unit of time 'days'; the units are ns, us, ms"),
        ('max_delay5 s', "1:10: unexpected '5 s', expected '='"),
        ('max_delay=', '1:11: unexpected end of the constraint, expected a duration'),
        ('delay=5 s', "1:1: unexpected character 'd', expected a constraint (start_time, "),
        ('max_delay=true', "1:11: unexpected 'true', expected a duration"),
        ('reorder=1 s', "1:9: unexpected '1 s', expected true or false"),
        ('max_delay=5 s=', "1:14: unexpected '=', expected the end of the constraint"),
    ],
)
def test_errors_name_what_was_expected(text: str, message: str) -> None:
    with pytest.raises(LanguageError) as error:
        CONSTRAINT.parse(text, ConstraintBuilder[tuple[str, int]]())
    assert str(error.value).startswith(f'constraint:{message}')


def test_errors_show_their_position() -> None:
    text = 'max_delay\n\t= 5'
    with pytest.raises(LanguageError) as error, CONSTRAINT.errors_in(text):
        raise PositionedError('a fault', TextPosition(2, 2))
    assert str(error.value) == 'constraint:2:2: a fault\n  \t= 5\n  \t^'
    assert (error.value.reason, error.value.position) == ('a fault', TextPosition(2, 2))
    with pytest.raises(LanguageError) as error, CONSTRAINT.errors_at(text, NOWHERE):
        raise DyKnowError('a fault', ExitCode.NOT_FOUND)
    assert str(error.value) == 'constraint: a fault'
    assert error.value.code is ExitCode.NOT_FOUND
