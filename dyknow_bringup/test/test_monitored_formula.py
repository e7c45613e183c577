"""The table of `dyknow monitor` on a terminal of 80 columns."""

from __future__ import annotations

import io

from dyknow_bringup.monitored_formula import MonitoredFormula, formula_table
from dyknow_common import SECOND_NS, clock_time
from dyknow_common.tables import Terminal
from dyknow_configuration import RequestedFormula

START = 1_700_000_000 * SECOND_NS


def test_the_table_says_since_when_times_count() -> None:
    why = f'Speed[r1] = 3.0 at {START // SECOND_NS + 2}.500 s is not < 2 m/s (it must always hold)'
    failed = MonitoredFormula(
        RequestedFormula('always Speed[r1] < 2 m/s', 'speed'),
        outcome='false',
        known_at=START + 3 * SECOND_NS,
        explanation=why,
    )
    output = io.StringIO()
    Terminal(file=output, width=80).print(formula_table([failed], START, 9 * SECOND_NS))
    title, *lines = output.getvalue().splitlines()
    assert title.strip() == f'9.000 s since {clock_time(START)}'
    assert max(map(len, lines)) <= 80
    shown = ' '.join(output.getvalue().replace('│', ' ').split())
    assert 'speed false 3.000 s Speed[r1] = 3.0 at 2.500 s is not < 2 m/s' in shown


def test_no_caret_is_folded() -> None:
    fault = "formula:1:3: unknown unit 'warp'\n  x < 3 warp\n        ^"
    wrong = MonitoredFormula(RequestedFormula('x'), outcome='INVALID_ARGUMENT', explanation=fault)
    output = io.StringIO()
    Terminal(file=output, width=80).print(formula_table([wrong], START, 0))
    assert "unknown unit 'warp'" in output.getvalue()
    assert '^' not in output.getvalue()
