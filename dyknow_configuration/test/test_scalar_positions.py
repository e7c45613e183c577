"""Every character of a scalar is found in its document, whatever its style."""

from __future__ import annotations

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from dyknow_configuration.yaml_values import source_offsets

WORDS = st.text('ab<\'"\\é:#{}%\t☃', min_size=1, max_size=8).filter(lambda each: each.strip())
VALUES = st.lists(WORDS, min_size=1, max_size=12).map(' '.join) | st.text(
    'a" \'\\\n', min_size=1, max_size=30
)


@given(VALUES, st.sampled_from([None, "'", '"', '|', '>']), st.integers(10, 40))
def test_each_character_is_that_of_the_document(value: str, style: str | None, width: int) -> None:
    text = yaml.dump({'key': value}, default_style=style, width=width, allow_unicode=True)
    node = yaml.compose(text, Loader=yaml.SafeLoader).value[0][1]
    assert node.value == value
    begin = node.start_mark.index
    offsets = source_offsets(value, text[begin : node.end_mark.index], node.style)
    assert offsets is not None
    assert len(offsets) == len(value) + 1
    assert offsets == sorted(offsets)
    for character, offset in zip(value, offsets, strict=False):
        source = text[begin + offset]
        # An escape of a character that PyYAML does not write as it is.
        assert character.isspace() or source in {character, '\\'}


@pytest.mark.parametrize(
    ('source', 'value', 'style', 'offsets'),
    [
        ('"a\\x62c"', 'abc', '"', [1, 2, 6, 7]),
        ('"\\u00e9\\\n  b"', 'éb', '"', [1, 11, 12]),
        ("'it''s'", "it's", "'", [1, 2, 3, 5, 6]),
        ('|2-\n  a\n   b', 'a\n b', '|', [6, 7, 7, 11, 12]),
        ('', '', None, [0]),
    ],
)
def test_examples(source: str, value: str, style: str | None, offsets: list[int]) -> None:
    assert source_offsets(value, source, style) == offsets


def test_a_source_of_another_value() -> None:
    assert source_offsets('abc', 'abd', None) is None
