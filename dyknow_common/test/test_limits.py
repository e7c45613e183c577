"""Limits of texts: each is an error with a place, and no message is long."""

from __future__ import annotations

import pytest

from dyknow_common import (
    MAX_CHARACTERS,
    MAX_DIGITS,
    MAX_DURATION_NS,
    SECOND_NS,
    ConstraintBuilder,
    DyKnowError,
    Language,
    LanguageError,
    PositionedError,
    format_duration,
    parse_duration,
)
from dyknow_common.parsing import TextPosition

CONSTRAINT = Language('constraint', 'dyknow_common', 'common.lark', {}, 'constraint')


def fault(text: str) -> LanguageError:
    with pytest.raises(LanguageError) as error:
        CONSTRAINT.parse(text, ConstraintBuilder[tuple[str, int]]())
    return error.value


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('max_delay=5 s' + '\n' * MAX_CHARACTERS, '999988:1: the constraint has more than 1000000'),
        ('max_delay=\n\x005 s', "2:1: unexpected character '\\x00'; remove it"),
        ('max_delay=\x1b5 s', "1:11: unexpected character '\\x1b'; remove it"),
        ('max_delay=\ud8005 s', "1:11: unexpected character '\\ud800'; remove it"),
        (f'max_delay={"1" * (MAX_DIGITS + 1)}', '1:11: a number has at most 100 characters'),
        (f'max_delay=0.{"1" * MAX_DIGITS} s', '1:11: a number has at most 100 characters'),
        (f'max_delay={"1" * MAX_DIGITS} s', "1:11: '1111"),
        ('max_delay=2147483647.5 s', "1:11: '2147483647.5 s' is longer than 2147483647 s (68"),
        ('max_delay=1.00000000000000000000000000000001 s', "1:11: '1.0000"),
        (f'max_delay=5 {"x" * 1000}', "1:11: unknown unit of time 'xxxx"),
        (f'max_delay=5 s{"(" * 1000}', "1:14: unexpected character '(', expected the end"),
    ],
)  # fmt: skip
def test_what_is_too_large_has_a_place(text: str, message: str) -> None:
    found = str(fault(text))
    assert found.startswith(f'constraint:{message}')
    found.encode()
    assert len(found) < 600


def test_the_longest_duration() -> None:
    assert parse_duration(format_duration(MAX_DURATION_NS)) == MAX_DURATION_NS
    assert parse_duration(format_duration(-MAX_DURATION_NS)) == -MAX_DURATION_NS
    with pytest.raises(ValueError, match='is longer than'):
        parse_duration(format_duration(MAX_DURATION_NS + 1))
    # All digits count: a Decimal would round these.
    with pytest.raises(ValueError, match='not a whole number of nanoseconds'):
        parse_duration(f'1.{"0" * 40}1 s')
    assert parse_duration(f'1.{"0" * 40} s') == SECOND_NS


@pytest.mark.parametrize(
    ('column', 'line', 'caret'),
    [
        (1, 'a' * 100 + '…', 0),
        (61, '…' + 'a' * 100 + '…', 51),
        (1000, '…' + 'a' * 51, 51),
        (1001, '…' + 'a' * 50, 51),
    ],
)
def test_an_error_shows_the_neighbourhood_of_its_place(column: int, line: str, caret: int) -> None:
    text = 'first\n' + 'a' * 1000 + '\r\nlast'
    with pytest.raises(LanguageError) as error, CONSTRAINT.errors_in(text):
        raise PositionedError('a fault', TextPosition(2, column))
    assert str(error.value).split('\n')[1:] == [f'  {line}', f'  {" " * caret}^']


def test_lines_end_where_the_parser_says() -> None:
    """Other characters that Python takes for ends of lines do not count."""
    text = 'max_delay\x85\u2028='
    assert str(fault(text)).split('\n')[1:] == ['  max_delay\ufffd\ufffd=', ' ' * 11 + '^']


def test_an_error_shows_no_control_characters() -> None:
    shown = str(fault('a\x00\x1b\x07')).split('\n')[1]
    assert shown == '  a\ufffd\ufffd\ufffd'


def test_a_message_can_be_sent() -> None:
    message = DyKnowError(f"no stream '{'x' * 10_000}', \0 \ud800, but '{'y' * 200}'").message
    message.encode()
    assert '\0' not in message
    assert len(message) < 500
    assert 'y' * 200 in message
