"""The cache of what was computed from texts."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import cached_by_text, limits


def test_a_text_is_computed_once_for_the_same_arguments() -> None:
    calls: list[tuple[str, int]] = []

    @cached_by_text
    def measured(text: str, factor: int) -> int:
        calls.append((text, factor))
        return len(text) * factor

    assert [measured('ab', 1), measured('ab', 2), measured('ab', 1), measured('ab', factor=2)] == [
        2, 4, 2, 4,
    ]  # fmt: skip
    assert calls == [('ab', 1), ('ab', 2), ('ab', 2)]


def test_errors_are_not_kept() -> None:
    calls: list[str] = []

    @cached_by_text
    def failing(text: str) -> None:
        calls.append(text)
        raise ValueError(text)

    for _ in range(2):
        with pytest.raises(ValueError, match='ab'):
            failing('ab')
    assert calls == ['ab', 'ab']


@given(st.lists(st.text('ab', max_size=6)))
def test_the_texts_that_were_used_last_are_kept(texts: list[str]) -> None:
    limit = 10 + 2 * limits.ENTRY_CHARACTERS
    computed: list[str] = []

    @cached_by_text
    def identity(text: str) -> str:
        computed.append(text)
        return text

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limits, 'MAX_CACHED_CHARACTERS', limit)
        kept: list[str] = []
        for text in texts:
            before = len(computed)
            assert identity(text) == text
            assert (len(computed) > before) == (text not in kept)
            kept = [each for each in kept if each != text] + [text]
            while sum(len(each) + limits.ENTRY_CHARACTERS for each in kept) > limit:
                kept.pop(0)


def test_short_texts_are_not_all_kept() -> None:
    computed: list[int] = []

    @cached_by_text
    def identity(_text: str, number: int) -> int:
        computed.append(number)
        return number

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limits, 'MAX_CACHED_CHARACTERS', 1000)
        for number in range(1000):
            identity('', number)
        identity('', 999)
        identity('', 0)
    assert computed == [*range(1000), 0]
