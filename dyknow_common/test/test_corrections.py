"""Corrections in messages: of other languages' symbols, and of misspelt words."""

from __future__ import annotations

import pytest

from dyknow_common.parsing.language import correction

CORRECTIONS = {'&&': 'and', 'G': 'always', '==': '=', 'ALWAYS': 'always'}


@pytest.mark.parametrize(
    ('text', 'offset', 'expected'),
    [
        ('p && q', 2, "did you mean 'and' instead of '&&'?"),
        ('x == 1', 3, "did you mean '=' instead of '=='?"),
        ('G p', 2, "did you mean 'always' instead of 'G'?"),
        ('G[0, 5] p', 2, "did you mean 'always' instead of 'G'?"),
        ('alway p', 6, "did you mean 'always' instead of 'alway'?"),
        ('G > 1 1', 6, ''),
        ('always p q', 9, ''),
        ('p q', 2, ''),
        ('', 0, ''),
        ('G(p > q)', 4, "did you mean 'always' instead of 'G'?"),
        ('G(p) > q r', 9, ''),
        ('always /odom.x > 1', 7, 'did you mean "/odom" instead of /odom?'),
        ("always '/odom'.x > 1", 7, 'did you mean "/odom" instead of \'/odom\'?'),
        ('always “/odom”.x > 1', 7, 'did you mean "/odom" instead of “/odom”?'),
        ('always / 2', 7, ''),
        ('alway' + ' ' * 100 + 'p', 105, ''),
    ],
)
def test_corrections(text: str, offset: int, expected: str) -> None:
    assert correction(text, offset, CORRECTIONS) == expected
