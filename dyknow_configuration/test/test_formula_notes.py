"""Commands warn on stderr of numbers without a unit in the intervals of formulas."""

import pytest

from dyknow_configuration import warn_of_notes

WARNING = """\
warning: formula:1:15: the time 5 has no unit and is taken for 5 ms; write the unit
  eventually[0, 5] x > 1
                ^
"""


def test_a_number_without_a_unit(capsys: pytest.CaptureFixture[str]) -> None:
    warn_of_notes(['eventually[0, 5] x > 1', 'eventually[0 s, 5 s] x > 1', 'always ['])
    printed = capsys.readouterr()
    assert not printed.out
    assert printed.err == WARNING
