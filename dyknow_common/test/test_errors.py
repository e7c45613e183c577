"""The length of messages, and errors in other processes."""

from __future__ import annotations

import pickle
import sys
import unicodedata

import pytest

from dyknow_common import NOWHERE, DyKnowError, ExitCode, LanguageError, printable


@pytest.mark.parametrize(
    'quoted',
    [
        'x' * 10_000,
        '"' + 'two words ' * 1000 + '"',
        repr('two words ' * 1000),
        'f("' + 'a b ' * 999 + '")',
    ],
)
def test_messages_quote_little(quoted: str) -> None:
    message = DyKnowError(f"the robot's name {quoted} isn't known").message
    assert len(message) < 200
    assert message.startswith("the robot's name ")
    assert message.endswith(" isn't known")


def test_messages_have_no_control_characters() -> None:
    assert DyKnowError('a\x1b[31m\r\x9bb:\n\t^').message == 'a\ufffd[31m\ufffd\ufffdb:\n\t^'


def test_no_invisible_character_is_shown() -> None:
    hidden = {'Cc', 'Cf', 'Cs', 'Zl', 'Zp'}
    for each in map(chr, range(sys.maxunicode + 1)):
        category = unicodedata.category(each)
        if category != 'Cn':  # Of a later version of Unicode.
            assert (printable(each) != each) is (category in hidden), hex(ord(each))
    assert printable('a\u202eb\U000e0041') == r'a\u202eb\udb40\udc41'
    assert DyKnowError('a\u200bb').message == 'a\ufffdb'


def test_messages_of_many_words_stay_whole() -> None:
    message = "it isn't known; " * 100
    assert DyKnowError(message).message == message


@pytest.mark.parametrize(
    'error',
    [
        DyKnowError('a', ExitCode.NOT_FOUND),
        LanguageError('a', 'formula', 'b c', NOWHERE, ExitCode.TIMEOUT),
    ],
)
def test_errors_are_pickled(error: DyKnowError) -> None:
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert (type(copy), copy.message, vars(copy)) == (type(error), error.message, vars(error))
