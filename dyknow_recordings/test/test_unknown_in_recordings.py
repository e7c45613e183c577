"""Values that are missing in a recording are unknown where a feature or the command says so."""

from __future__ import annotations

from pathlib import Path

import pytest
from running_checks import run_check

TRACE = """\
time_s, charge: float, docked: boolean
0,      0.9,           false
1,      nan,           false
2,      0.7,
3,      0.6,           true
"""
ROBOT = """\
objects: {Robot: [r1]}
features:
  Charge:
    of: Robot
    missing: unknown
    range: [0, 1]
    from: {topic: /trace, field: charge, only: {Robot: r1}}
  Load:
    of: Robot
    from: {topic: /trace, field: charge, only: {Robot: r1}}
formulas:
  - {name: emptied, formula: 'forall r in Robot: eventually Charge[r] < 0.65'}
  - {name: possible, formula: 'always[0 s, 2 s] Charge[r1] <= 1'}
  - {name: open, formula: 'always[0 s, 2 s] Charge[r1] > 0.5'}
  - {name: known, formula: 'always Load[r1] > 0.5'}
"""


@pytest.fixture
def trace(tmp_path: Path) -> str:
    path = tmp_path / 'trace.csv'
    path.write_text(TRACE)
    return str(path)


@pytest.mark.parametrize(
    ('formula', 'outcome'),
    [
        ('eventually (charge < 0.65 and docked)', '"verdict": "true"'),
        ('always charge > 0.65', '"verdict": "false"'),
        ('always charge > 0.5', 'undecided for want of charge since 1.000 s'),
        ('eventually[2 s, 2 s] docked', 'undecided for want of docked since 2.000 s'),
    ],
)
def test_the_command_takes_what_is_missing_for_unknown(
    trace: str, formula: str, outcome: str
) -> None:
    found = run_check(trace, '--missing', 'unknown', '--formula', formula, '--json')
    assert outcome in found.out


@pytest.mark.parametrize(
    ('formula', 'error'),
    [
        (
            'always charge > 0.5',
            "nan, not a number; if that is an unknown value, add 'missing: unknown'",
        ),
        ('eventually docked', 'is empty'),
        ('always chrge > 0.5', "the trace has no field 'chrge'; did you mean 'charge'?"),
    ],
)
def test_what_is_missing_is_an_error_without_the_option(
    trace: str, formula: str, error: str
) -> None:
    assert error in run_check(trace, '--formula', formula, '--json').out


def test_let_keeps_no_unknown_value(trace: str) -> None:
    formula = 'always let before = charge in eventually charge < before'
    found = run_check(trace, '--missing', 'unknown', '--formula', formula, '--json')
    mend = "not a number; if that is an unknown value, leave out the 'let', which cannot keep it\""
    assert mend in found.out


def test_a_robot_says_what_may_be_unknown(trace: str, tmp_path: Path) -> None:
    robot = tmp_path / 'robot.yaml'
    robot.write_text(ROBOT)
    code, output, _ = run_check(trace, '--config', robot)
    assert code == 2
    for name, outcome in (
        ('emptied', 'true'),
        ('possible', 'true'),
        ('open', 'undecided'),
        ('known', 'error'),
    ):
        (row,) = (line for line in output.splitlines() if f'│ {name} ' in line)
        assert f'│ {outcome} ' in row
    assert 'it may be false; what remains: ' in output


CELLS = """\
objects: {Robot: [r1]}
features:
  Charge: {of: Robot, unit: '%', missing: unknown, from: {topic: /trace, field: charge, unit: '1'}}
  Docked: {missing: unknown, from: {topic: /trace, field: docked}, type: boolean}
  Mode: {type: int, from: {topic: /trace, field: mode}}
  Level: {missing: unknown, from: {topic: /trace, field: level}, unknown: quality < 1}
  Plain: {missing: unknown, from: {topic: /trace, field: quality}}
formulas:
  - {name: charged, formula: 'always[0 s, 2 s] Charge[r1] > 50 %'}
  - {name: emptied, formula: 'eventually Charge[r1] < 40 %'}
  - {name: docked, formula: 'eventually[2 s, 2 s] Docked'}
  - {name: mode, formula: 'always Mode < 5'}
  - {name: level, formula: 'always Level < 5'}
"""


@pytest.mark.parametrize(
    ('name', 'outcome'),
    [
        ('charged', 'undecided'),
        ('emptied', 'true'),
        ('docked', 'undecided'),
        ('mode', 'error'),  # The feature may not be unknown.
        ('level', 'error'),  # Nobody knows whether the condition holds.
    ],
)
def test_an_empty_cell_of_a_feature_that_may_be_unknown(
    tmp_path: Path, name: str, outcome: str
) -> None:
    trace, robot = tmp_path / 'trace.csv', tmp_path / 'robot.yaml'
    columns = 'time_s,charge: float,docked: boolean,mode: int,level: float,quality: int'
    trace.write_text(f'{columns}\n0,0.9,false,1,1,1\n1,,true,,1,\n2,0.7,,1,1,1\n3,0.3,true,1,1,1\n')
    robot.write_text(CELLS)
    found = run_check(trace, '--config', robot, '--json').by_name[name]
    assert found['outcome'] == outcome
    if outcome == 'error':
        assert 'is empty' in found['error']['message']


GPS_LOSS = """\
objects: {UAV: [uav1]}
features:
  Altitude:
    of: UAV
    unit: m
    range: [0, 120]
    unknown: fix < 1
    from: {topic: /trace, field: altitude, only: {UAV: uav1}}
formulas:
  - {name: airspace, formula: 'forall u in UAV: always[0 s, 9 s] Altitude[u] <= 120 m'}
  - {name: geofence, formula: 'forall u in UAV: always[0 s, 9 s] Altitude[u] < 40 m'}
  - name: descends
    formula: 'always[0 s, 6 s] (Altitude[uav1] > 30 -> eventually[0 s, 6 s] Altitude[uav1] < 25)'
  - {name: climbed, formula: 'forall u in UAV: eventually[0 s, 9 s] Altitude[u] > 33 m'}
  - {name: standing, formula: 'forall u in UAV: Altitude[u] < 40 m', every_state: true}
"""
ALTITUDES = (20, 28, 32, -1, -1, -1, -1, 31, 24, 22, 20)
"""Without a fix for 4 s, the receiver tells -1."""


def test_the_altitude_of_a_vehicle_is_unknown_for_four_seconds(tmp_path: Path) -> None:
    trace, robot = tmp_path / 'trace.csv', tmp_path / 'robot.yaml'
    rows = [f'{second},{z},{int(z >= 0)}' for second, z in enumerate(ALTITUDES)]
    trace.write_text('\n'.join(['time_s,altitude: float,fix: int', *rows]))
    robot.write_text(GPS_LOSS)
    reports = run_check(trace, '--config', robot, '--json').formulas
    found = {each['name']: each['episodes'] for each in reports}
    decided = {
        name: (each[0]['verdict'], each[0].get('decided_at_ns')) for name, each in found.items()
    }
    assert decided['airspace'] == ('true', 9 * 10**9)
    assert decided['descends'] == ('true', 8 * 10**9)
    assert decided['geofence'][0] == decided['climbed'][0] == 'undecided'
    want = 'undecided for want of Altitude[uav1] since 3.000 s'
    assert want in found['geofence'][0]['residual_formula']
    assert [each['verdict'] for each in found['standing']] == [
        'true' if z >= 0 else 'undecided' for z in ALTITUDES
    ]
