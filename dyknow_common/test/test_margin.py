"""Texts of margins."""

from __future__ import annotations

from math import inf

import pytest

from dyknow_common import Margin


@pytest.mark.parametrize(
    ('margin', 'text'),
    [
        (Margin(2.5, 2.5, 'W', 'Power[uav1] > 150'), '2.5 W (Power[uav1] > 150)'),
        (Margin(-inf, 3.0, atom='x < 5'), 'at most 3 (x < 5)'),
        (Margin(-1.25, inf, 'm', 'x < 5'), 'at least -1.25 m (x < 5)'),
        (Margin(-1.0, 2.0, '', 'x < 5'), '-1 to 2 (x < 5)'),
        (Margin(-inf, -inf), '-inf'),
        (Margin(), 'unknown'),
    ],
)
def test_text(margin: Margin, text: str) -> None:
    assert str(margin) == text
