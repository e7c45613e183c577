"""The length of messages."""

from __future__ import annotations

import pytest

from dyknow_common import DyKnowError


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


def test_messages_of_many_words_stay_whole() -> None:
    message = "it isn't known; " * 100
    assert DyKnowError(message).message == message
