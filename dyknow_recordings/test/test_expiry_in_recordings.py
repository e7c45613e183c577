"""Values that expire in recordings: from robot.yaml to the verdict."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from unittest import mock

from running_checks import run_check

from dyknow_recordings.evaluation.evaluation import ColumnStates

ROBOT = """\
objects: {Robot: [r1, r2]}
features:
  Charge:
    of: {r: Robot}
    missing: unknown
    range: [0, 1]
    from:
      topic: /trace
      field: charge
      where: {r: robot}
      max_delay: 100 ms
      max_gap: 2 s
      expires: EXPIRES
formulas:
  - {name: kept, formula: 'always Charge[r1] > 0.2'}
  - {name: lasting, formula: 'always[0 s, 20 s] Charge[r1] > 0.2'}
  - {name: possible, formula: 'always[0 s, 20 s] Charge[r1] <= 1'}
  - {name: other, formula: 'always[0 s, 20 s] Charge[r2] > 0.2'}
  - name: charged
    formula: 'always[0 s, 20 s] (Charge[r2] < 0.3 -> eventually[0 s, 5 s] Charge[r1] > 0.2)'
  - {name: emptied, formula: 'always Charge[r1] > 0.5'}
  - {name: standing, formula: 'Charge[r1] > 0.2', every_state: true}
"""
CHARGES = {0: 0.9, 1: 0.8, 2: 0.7, 3: 0.6, 16: 0.4, 17: 0.4, 18: 0.4, 19: 0.4, 20: 0.4, 21: 0.4}
"""Of r1, by the second: it is silent for longer than the limit of silence."""
LOW = {3, 12}
"""The seconds in which r2 has little left."""


def reports(folder: Path, expires: str) -> dict[str, Any]:
    trace, robot = folder / 'trace.csv', folder / 'robot.yaml'
    rows = []
    for second in range(27):
        if second in CHARGES:
            rows.append(f'{second},r1,{CHARGES[second]}')
        rows.append(f'{second}.5,r2,{0.25 if second in LOW else 0.6}')
    trace.write_text('\n'.join(['time_s,robot: string,charge: float', *rows]))
    robot.write_text(ROBOT.replace('EXPIRES', expires))
    return run_check(trace, '--config', robot, '--json').by_name


def test_silence_is_unknown_from_the_last_value_on(tmp_path: Path) -> None:
    found = reports(tmp_path, 'true')
    episodes = {name: each['episodes'] for name, each in found.items()}
    decided = {
        name: (each[0]['verdict'], each[0].get('decided_at_ns')) for name, each in episodes.items()
    }
    assert decided['emptied'] == ('false', 16 * 10**9)
    assert decided['possible'][0] == decided['other'][0] == 'true'
    # What is open from 12.5 s on is decided by the value at 16 s.
    assert decided['charged'][0] == 'true'
    assert decided['kept'][0] == decided['lasting'][0] == 'undecided'
    want = 'undecided for want of Charge[r1] since 5.000 s'
    assert want in episodes['kept'][0]['residual_formula']
    standing = {each['begin_ns'] // 10**9: each['verdict'] for each in episodes['standing']}
    assert standing == {**dict.fromkeys(CHARGES, 'true'), 5: 'undecided', 23: 'undecided'}


def test_columns_and_single_messages_are_the_same(tmp_path: Path) -> None:
    found = reports(tmp_path, 'true')
    with mock.patch.object(ColumnStates, 'progress', return_value=False):
        assert reports(tmp_path, 'true') == found


def test_without_expires_silence_ends_the_formulas(tmp_path: Path) -> None:
    found = reports(tmp_path, 'false')
    assert 'max_gap is 2 s' in found['kept']['error']['message']
