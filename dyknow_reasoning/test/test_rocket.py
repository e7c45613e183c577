"""A real launch, at irregular times, against what its rows say when read one by one."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from reasoning_reference import begun

from dyknow_common import Verdict
from dyknow_reasoning import check_trace, read_trace

MS = 1_000_000
RECORDING = Path(__file__).parent / 'data' / 'sounding_rocket_launch.csv'
Row = dict[str, float]

with RECORDING.open(encoding='utf-8', newline='') as lines:
    names, *cells = csv.reader(lines)
HEADER = [name.strip('# ') for name in names]
ROWS: list[Row] = [dict(zip(HEADER, map(float, row), strict=True)) for row in cells]


def first(rows: Sequence[Row], holds: Callable[[Row], bool]) -> int:
    """The time of the first row for which something holds, in milliseconds."""
    return next(int(row['time']) for row in rows if holds(row))


def since(time: int) -> list[Row]:
    return [row for row in ROWS if row['time'] >= time]


BEGIN = int(ROWS[0]['time'])
OUT = [int(row['time']) for row in ROWS if row['actuation_status'] == 1]
FIRST_OUT_FOR_2_S = next(
    time
    for time in OUT
    if all(row['actuation_status'] == 1 for row in since(time) if row['time'] <= time + 2000)
)
LAST_AT_60_S = max(int(row['time']) for row in ROWS if row['time'] <= BEGIN + 60_000)
FALLING = first(ROWS, lambda row: row['rocket_state'] == 3)


@pytest.mark.parametrize(
    ('formula', 'verdict', 'decided_at'),
    [
        # The rocket gets above 10.65 km once, and never above 10.652 km.
        (
            'eventually[0 s, 60 s] alt > 10650',
            Verdict.TRUE,
            first(ROWS, lambda row: row['alt'] > 10650),
        ),
        ('always[0 s, 70 s] alt < 10652', Verdict.TRUE, first(since(BEGIN + 70_000), bool)),
        # It is known to fall only after it has coasted, and does fall then.
        (
            'rocket_state < 3 until[0 s, 60 s] (rocket_state = 3 and vert_velocity < 0)',
            Verdict.TRUE,
            FALLING,
        ),
        # The phases come in order: none comes back.
        (
            (
                'always[0 s, 60 s] ((rocket_state = 3 -> always[0 s, 10 s] rocket_state = 3) '
                'and (rocket_state = 2 -> always[0 s, 10 s] rocket_state >= 2))'
            ),
            Verdict.TRUE,
            first(since(BEGIN + 60_000), lambda row: row['time'] >= LAST_AT_60_S + 10_000),
        ),
        # The airbrakes are out for at most three seconds at a time, but once for more than two.
        (
            'always[0 s, 70 s] (actuation_status = 1 -> eventually[0 s, 3 s] actuation_status = 0)',
            Verdict.TRUE,
            first(since(BEGIN + 70_000), bool),
        ),
        (
            'always (actuation_status = 1 -> eventually[0 s, 2 s] actuation_status = 0)',
            Verdict.FALSE,
            first(since(FIRST_OUT_FOR_2_S + 2000), bool),
        ),
        # On the motor it does not brake for longer than 300 ms.
        (
            (
                'always[0 s, 10 s] (rocket_state = 0 -> '
                'actuation_status = 0 or eventually[0 ms, 300 ms] actuation_status = 0)'
            ),
            Verdict.TRUE,
            first(since(BEGIN + 10_000), bool),
        ),
    ],
)
def test_properties_of_a_launch(formula: str, verdict: Verdict, decided_at: int) -> None:
    lines = [','.join(('time_s', *HEADER))]
    lines += [','.join((str(row['time'] / 1000), *map(str, row.values()))) for row in ROWS]
    [found] = check_trace([formula], {}, read_trace(lines))
    assert (found.verdict, found.decided_at) == (verdict, decided_at * MS)
    group, _ = begun(formula)
    times = [int(row['time']) * MS for row in ROWS]
    [result] = group.progress_many(times, {name: [row[name] for row in ROWS] for name in HEADER})
    assert (result.verdict, result.decided_at) == (verdict, decided_at * MS)
    assert result.explanation == found.explanation
