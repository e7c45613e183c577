"""Verdicts and margins over a real launch, compared with RTAMT where it is installed."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from reasoning_reference import begun

from dyknow_common import Verdict
from dyknow_reasoning import check_types, parse_formula
from dyknow_reasoning.margins.formula_margin import FormulaMargin

MS = 1_000_000
RECORDING = Path(__file__).parent / 'data' / 'sounding_rocket_launch.csv'


@pytest.mark.parametrize(
    'formula',
    [
        'always[0, 900] (alt < {})',
        'always[0, 900] ((acc_x > {} / 100) -> (eventually[0, 40] (acc_x < 1)))',
        'always[0, 900] ((acc_y > 5) -> (eventually[3, 30] (vert_velocity < {} - 9000)))',
        'eventually[0, 900] (always[0, 25] (pressure < {} / 100))',
    ],
)
def test_verdicts_are_those_of_rtamt(formula: str) -> None:
    """RTAMT evaluates in discrete time: the times here are the numbers of the rows, as ms."""
    rtamt = pytest.importorskip('rtamt')
    with RECORDING.open(encoding='utf-8', newline='') as lines:
        header, *rows = csv.reader(lines)
    names = [name.strip('# ') for name in header]
    columns = {
        name: [float(row[index]) for row in rows]
        for index, name in enumerate(names)
        if name != 'time'
    }
    found = set()
    for limit in (1500, 7000, 9000, 10_640, 11_000):
        text = formula.format(limit)
        theirs = rtamt.StlDiscreteTimeOfflineSpecification()
        for name in columns:
            theirs.declare_var(name, 'float')
        theirs.spec = text.replace('->', 'implies')
        theirs.parse()
        robustness = theirs.evaluate({'time': list(range(len(rows))), **columns})[0][1]
        group, _ = begun(text)
        times = range(0, len(rows) * MS, MS)
        [result] = group.progress_many(times, columns)
        assert (result.verdict is Verdict.TRUE) == (robustness > 0)
        assert _margin(text, times, columns) == pytest.approx((robustness, robustness))
        found.add(result.verdict)
    assert len(found) == 2


def _margin(text: str, times: range, columns: dict[str, list[float]]) -> tuple[float, float]:
    formula = parse_formula(text)
    margin = FormulaMargin(formula, check_types(formula, text), {}, 1000)
    for time, row in zip(times, zip(*columns.values(), strict=True), strict=True):
        margin.step(time, dict(zip(columns, row, strict=True)))
    found = margin.at_present()
    return found.lower, found.upper
