"""The check of recorded traces: the function and the command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dyknow_common import Verdict
from dyknow_reasoning import check_trace, read_trace
from dyknow_reasoning.check import main

TRACE = """time_s,Power[uav1],"XYDist[uav1,uav2]",mode,p
0.0,143,10.5,on,true
0.1,160.5,9.5,off,false
0.25,1e2,-8,on,true
"""


@pytest.fixture
def trace(tmp_path: Path) -> str:
    path = tmp_path / 'trace.csv'
    path.write_text(TRACE, encoding='utf-8')
    return str(path)


def test_reading_a_trace() -> None:
    first, second, third = read_trace(TRACE.splitlines())
    assert (first.valid_time, second.valid_time, third.valid_time) == (0, 10**8, 25 * 10**7)
    assert first.values == {
        'Power[uav1]': 143,
        'XYDist[uav1, uav2]': 10.5,
        'mode': 'on',
        'p': True,
    }
    assert [type(value) for value in first.values.values()] == [int, float, str, bool]
    assert third.values['Power[uav1]'] == 100.0


def test_times_are_exact_and_empty_cells_hold_no_value() -> None:
    rows = ['p, time_ns', 'true, 1234567890123456789', '', ',1234567890123456790']
    first, second = read_trace(rows)
    assert (first.valid_time, first.values) == (1234567890123456789, {'p': True})
    assert (second.valid_time, second.values) == (1234567890123456790, {})
    [state] = read_trace(['time_s,p', '1234567890.123456789,nan'])
    assert state.valid_time == 1234567890123456789
    assert state.values['p'] != state.values['p']


def test_checking_formulas() -> None:
    results = check_trace(
        ['always p', 'eventually Power[uav1] > 200', 'exists u in UAV: Power[u] < 150', 'always q'],
        {'UAV': ['uav1']},
        read_trace(TRACE.splitlines()),
    )
    assert [(each.verdict, each.decided_at, each.decided_at_state) for each in results] == [
        (Verdict.FALSE, 10**8, 1),
        (Verdict.UNDECIDED, None, None),
        (Verdict.TRUE, 0, 0),
        (Verdict.UNDECIDED, None, None),
    ]
    assert [each.states for each in results] == [3] * 4
    assert results[1].explanation == (
        'undecided after 3 states; what remains: eventually (Power[uav1] > 200)'
    )
    assert results[3].error is not None


@pytest.mark.parametrize('rows', [[], ['0,true', '1,true']], ids=['no states', 'states'])
def test_formulas_that_need_no_state_are_decided_at_none(rows: list[str]) -> None:
    formulas = ['1 < 2', 'exists u in UAV: p', 'p or not p']
    results = check_trace(formulas, {'UAV': []}, read_trace(['time_s,p', *rows]))
    assert [(each.verdict, each.decided_at, each.decided_at_state) for each in results] == [
        (Verdict.TRUE, None, None),
        (Verdict.FALSE, None, None),
        (Verdict.TRUE, None, None),
    ]


def test_the_report_of_a_formula_that_needs_no_state(
    trace: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['--trace', trace, '2 < 1']) == 1
    assert capsys.readouterr().out == ('2 < 1\n  false\n  it is false, whatever the states are\n')


def test_the_report(trace: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--trace', trace, 'always p', 'eventually[0, 1 s] Power[uav1] > 200']) == 1
    assert capsys.readouterr().out == (
        'always p\n'
        '  false at 0.100 s (state 1)\n'
        '  p is false at 0.100 s (always must hold since 0.000 s)\n'
        'eventually[0 s, 1 s] (Power[uav1] > 200)\n'
        '  undecided after 3 states; what remains: eventually[0 s, 750 ms] (Power[uav1] > 200)\n'
    )


def test_json(trace: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ['--json', '--domain', 'UAV = uav1, uav2', '--trace', trace]
    formula = 'forall x in UAV: x != uav1 or Power[x] > 3'
    assert main([*arguments, formula, 'eventually Power[uav1] > 200']) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert lines == [
        {
            'formula': 'forall x in UAV: ((x != uav1) or (Power[x] > 3))',
            'verdict': 'true',
            'decided_at_ns': 0,
            'decided_at_state': 0,
            'states': 3,
            'explanation': (
                'for all 2 objects of UAV, decided last for x = uav1: '
                'Power[uav1] = 143 at 0.000 s is > 3'
            ),
            'error': None,
        },
        {
            'formula': 'eventually (Power[uav1] > 200)',
            'verdict': 'undecided',
            'decided_at_ns': None,
            'decided_at_state': None,
            'states': 3,
            'explanation': 'undecided after 3 states; what remains: eventually (Power[uav1] > 200)',
            'error': None,
        },
    ]


def test_formulas_from_a_file(
    trace: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    formulas = tmp_path / 'formulas.txt'
    formulas.write_text('# my formulas\n\neventually p\n  p or q\n', encoding='utf-8')
    assert main(['--trace', trace, '--formulas', str(formulas), '--json', 'p']) == 2
    captured = capsys.readouterr()
    assert [json.loads(line)['formula'] for line in captured.out.splitlines()] == [
        'p',
        'eventually p',
        'p or q',
    ]
    assert captured.err.startswith("p or q: at 0.000 s: the state has no field 'q'")


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['Power[u] and 3'], "'3' is a number, not a formula"),
        (['forall u in UAV: p'], "the sort 'UAV' has no domain"),
        (['--domain', 'UAV', 'p'], "'UAV' is not a domain; write it as UAV=uav1,uav2"),
        (['--domain', 'A=a', '--domain', 'A=b', 'p'], "the sort 'A' has two domains"),
        (['--formulas', '/nowhere/formulas.txt'], 'No such file'),
        ([], 'there is no formula to check'),
    ],
)
def test_bad_input(
    trace: str, arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['--trace', trace, *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ''
    assert message in captured.err


def test_a_trace_without_an_end(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--trace', '/dev/zero', 'p']) == 2
    reason = 'line 1 has more than 1,048,576 characters'
    assert f'cannot read the trace in /dev/zero: {reason}' in capsys.readouterr().err


def test_no_trace(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(['--trace', '/nowhere/trace.csv', 'p']) == 2
    assert '/nowhere/trace.csv' in capsys.readouterr().err
