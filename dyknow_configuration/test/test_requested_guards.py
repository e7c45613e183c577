"""The guards of a robot.yaml: what is refused, at its place, and how it is mended."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_configuration import ConfigurationError, read_robot

START = """\
formulas:
  - {name: soon, formula: 'eventually[0 s, 1 s] "/cmd_in".x > 0'}
guards:
  - {name: first, input: /cmd_in, output: /cmd, formulas: p > 0}
"""
IN_A_ROW = """\
  - {name: second, input: /cmd, output: /cmd_late, formulas: p > 0}
  - {name: third, input: /cmd_late, output: /end, formulas: p > 0}
"""


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (
            '  - {name: b, input: /a, output: /a, formulas: p > 0}',
            '5:34: the output is the input; use another topic',
        ),
        (
            '  - {name: first, input: /a, output: /b, formulas: p > 0}',
            "5:12: the name 'first' is taken; use another",
        ),
        (
            '  - {name: b, input: /a, output: /cmd, formulas: p > 0}',
            (
                "5:34: the guard 'first' publishes /cmd already, so what one of them stops the "
                'other may pass; use one guard with all formulas'
            ),
        ),
        (
            IN_A_ROW.replace('/end', '/cmd_in').rstrip(),
            (
                '6:45: messages of /cmd_in come back to /cmd_late by other guards, and pass again '
                'for ever; use another topic'
            ),
        ),
        (
            '  - {name: b, input: /a, output: /b, formulas: []}',
            '5:48: a guard without formulas guards nothing; add one',
        ),
        (
            '  - {name: b, input: /a, output: /b, formulas: [p > 0, p > 0]}',
            "5:56: 'p > 0' is given twice; keep one",
        ),
        (
            '  - {name: b, input: /cmd_in, output: /b, formulas: soon}',
            (
                "5:53: 'soon' cannot be a formula of a guard: 'eventually[0 s, 1 s] "
                '("/cmd_in".x > 0)\' looks into the future'
            ),
        ),
        (
            '  - {name: b, input: /a, output: /b, formulas: [\'forall r in Rover: "/a".x < 1\']}',
            "5:50: no feature is about the variable 'r'; leave its quantifier out",
        ),
        (
            '  - {name: b, input: /a, output: /b, formulas: p > 0, timeout: 5 ms}',
            '5:64: write a duration from 10 ms to 1 min',
        ),
    ],
)
def test_a_guard_that_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(START + text + '\n')
    with pytest.raises(ConfigurationError) as refused:
        read_robot(path)
    assert str(refused.value).startswith(f'{path}:{message}')


def test_guards_in_a_row(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(START + IN_A_ROW)
    assert [each.output for each in read_robot(path).guards] == ['/cmd', '/cmd_late', '/end']
