"""Traces in all the shapes in which tools and people write them."""

from __future__ import annotations

import io
import json
import time
from pathlib import Path

import numpy as np
import pytest

from dyknow_common import MAX_LINE, Value
from dyknow_reasoning import ReasoningError, read_trace
from dyknow_reasoning.check import main


def values(header: str, *cells: str) -> list[Value | None]:
    """The values of the one column of a trace."""
    rows = [f'time_s,{header}', *(f'{time},{cell}' for time, cell in enumerate(cells))]
    return [next(iter(state.values.values()), None) for state in read_trace(rows)]


@pytest.mark.parametrize(
    ('header', 'cells', 'expected'),
    [
        ('m', ['5', '-6', '+7', '007'], [5, -6, 7, 7]),
        ('m', ['5', '2.5', '1e2', '.5', '5.'], [5, 2.5, 100.0, 0.5, 5.0]),
        ('m', ['9007199254740993', '0.5'], [9007199254740993, 0.5]),
        ('m', ['"5"', '" 6 "'], [5, 6]),
        ('m', ['', '5', ''], [None, 5, None]),
        ('m', ['true', 'False', 'TRUE', '"true"'], [True, False, True, True]),
        ('m', ['on', '5', 'true', '"a, b"'], ['on', '5', 'true', 'a, b']),
        ('m', ['1', '-inf'], [1, float('-inf')]),
        ('m: string', ['5', 'true', 'nan', '007'], ['5', 'true', 'nan', '007']),
        ('m:float', ['5', '6.5'], [5.0, 6.5]),
        ('m : int', ['5'], [5]),
        ('m: boolean', ['true'], [True]),
    ],
)
def test_types_of_columns(header: str, cells: list[str], expected: list[Value | None]) -> None:
    found = values(header, *cells)
    assert found == expected
    assert [type(value) for value in found] == [type(value) for value in expected]


@pytest.mark.parametrize(
    ('header', 'cells', 'message'),
    [
        ('m', ['1', 'x'], "line 3, column 'm': 'x' is not a number, as the first value"),
        ('m', ['1', 'true'], "line 3, column 'm': 'true' is not a number"),
        ('m', ['true', '1'], "line 3, column 'm': '1' is not a boolean"),
        ('m', ['5', 'A'], "declare a column of strings as 'm: string'"),
        ('m: int', ['1', '1.5'], "line 3, column 'm': '1.5' is not of the type of the column, int"),
        ('m: boolean', ['1'], "'1' is not of the type of the column, boolean"),
        (
            'm',
            ['9' * 5000],
            r"line 2, column 'm': '9{50}…9{50}' is an integer of more than 64 bits",
        ),
        ('m', [str(2**63)], 'more than 64 bits'),
        ('m', ['0.5', '9' * 30], 'more than 64 bits'),
        ('m', ['1e400'], "'1e400' is too large for a float"),
        ('m', ['a\0b'], "line 2, column 'm': .* has a NUL character"),
        ('m', ['x' * (MAX_LINE + 1)], r'line 2: field larger than field limit \(1048576\)'),
        ('m', ['"1'], 'line 2: unexpected end of data; is a quote missing'),
        ('m', ['1,2'], 'line 2: 3 values for 2 columns'),
        ('m', ['\u0665'], None),
        ('m', ['x' * 200_000], None),
    ],
)
def test_refused_values(header: str, cells: list[str], message: str | None) -> None:
    if message is None:  # A digit of another script is no number, so the column holds strings.
        assert values(header, *cells) == cells
        return
    with pytest.raises(ReasoningError, match=message):
        values(header, *cells)


@pytest.mark.parametrize(
    ('unit', 'nanoseconds'), [('s', 10**9), ('ms', 10**6), ('us', 1000), ('ns', 1)]
)
def test_units_of_time(unit: str, nanoseconds: int) -> None:
    states = list(read_trace([f'x,time_{unit}', '1,-3', '2,4']))
    assert [each.valid_time for each in states] == [-3 * nanoseconds, 4 * nanoseconds]


def test_a_header_that_numpy_has_written() -> None:
    file = io.BytesIO()
    np.savetxt(file, [[0.1, 5], [0.25, 6]], delimiter=',', header='time_s,x')
    lines = file.getvalue().decode().splitlines()
    assert lines[0] == '# time_s,x'
    found = [(each.valid_time, each.values) for each in read_trace(lines)]
    assert found == [(100_000_000, {'x': 5.0}), (250_000_000, {'x': 6.0})]
    assert list(read_trace(['#time_s,x', '1,2'])) == list(read_trace(['time_s,x', '1,2']))


def test_many_columns_are_checked_in_linear_time() -> None:
    rows = [','.join(['time_s', *(f'many{each}' for each in range(5000))])]
    times = []
    for _ in range(2):
        begin = time.process_time()
        assert list(read_trace(rows)) == []
        times.append(time.process_time() - begin)
    assert times[1] < times[0] / 4, 'the names were parsed before'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('', 'line 1: a trace has one column of times, .*: time_s, time_ms, .* columns: none'),
        ('p,q\ntrue,true', 'this trace has the columns: p, q'),
        ('time_s,time_ns,p', 'one column of times'),
        ('time_s,p,p', "there are two columns 'p'"),
        ('time_s,D[a,b]', r"the column 'D\[a' is not a ground feature"),
        ('time_s,p\n1', 'line 2: 1 values for 2 columns'),
        ('time_s,p\n0,true\nsoon,true', "line 3, column 'time_s': 'soon' is not a whole number"),
        ('time_s,p\n0.0000000001,true', 'not a whole number'),
        ('time_ns,p\ninf,true', 'not a whole number'),
        ('time_ns,p\nnan,true', 'not a whole number'),
        ('time_s,p,q\n0,true', "line 2: 2 values for 3 columns, none for 'q'"),
        ('time_s,p\n1,true\n1,true', "line 3, column 'time_s': the time is not later"),
        ('time_s,p\n1,true\n\n0.5,true', "line 4, column 'time_s': the time is not later"),
        ('time_s,p\n,true', "line 2, column 'time_s': the time is missing"),
        ('time_s,p\n2026-01-01T00:00:00Z,true', "'2026-01-01T00:00:00Z' is not a whole number"),
        ('time_ns,p\n1_0,true', 'is not a whole number of nanoseconds within 64 bits'),
        ('time_s,p\n1e300,true', 'is not a whole number of nanoseconds within 64 bits'),
        ('time_s,p\n1e999999999999,true', 'is not a whole number of nanoseconds within 64 bits'),
        ('time_s,p\n0.12345678901,true', 'is not a whole number'),
        ('time_s,p\n0.1000000000000001,true', 'is not a whole number'),
        (f'time_ns,p\n{"9" * 5000},true', 'is not a whole number'),
        ('time_s,p and q\n0,true', "line 1: the column 'p and q' is not a ground feature"),
        ('time_s,true\n0,true', "line 1: the column 'true' is not a ground feature"),
        ('time_s,speed (m/s)\n0,1', r"'speed \(m/s\)' is not .*; name it as in x or Power\[uav1\]"),
        ('time_s;p\n0;1', "the column 'time_s;p' is not .*; separate columns by commas"),
        ('time_s\tp\n0\t1', 'separate columns by commas'),
        ('x,# time_s\n0,1', "the column '# time_s' is not a ground feature"),
        ('# x,time\n0,1', 'rename it; this trace has the columns: x, time'),
        ('time_s,p:\n0,true', "line 1: the column 'p:' is not a ground feature"),
        ('time_s,p: text\n0,true', "column 'p: text': unknown type 'text'; use int, "),
        ('time_s,p:flaot\n0,1', "column 'p:flaot': unknown type 'flaot'; did you mean 'float'"),
        ('time_s,p,p: int\n0,1,1', "line 1: there are two columns 'p'"),
        ('time_s,"D[a,b]","D[a, b]"\n0,1,1', r"there are two columns 'D\[a, b\]'"),
    ],
)
def test_refused_traces(text: str, message: str) -> None:
    with pytest.raises(ReasoningError, match=message):
        list(read_trace(text.splitlines()))


@pytest.mark.parametrize(
    ('content', 'code', 'printed'),
    [
        (b'\xef\xbb\xbftime_s,m\n0,1\n', 0, 'true at 0.000 s'),
        (b'time_s,m\r\n0,1\r\n\r\n', 0, 'true at 0.000 s'),
        (b'time_s,m\n', 0, 'undecided after 0 states'),
        (b'', 2, 'line 1: a trace has one column of times'),
        (b'time_s,m\n0,\xff\n', 2, 'it is not in UTF-8'),
        (b'time_s,m\n0,"1"\n', 0, 'true at 0.000 s'),
        (b'time_s,m: string\n0,1\n', 2, 'the field \'m\' holds the string "1", not a number'),
        (
            b'time_s,m\n0,nan\n',
            2,
            "the field 'm' holds nan, not a number; if that is an unknown value, add 'missing: ",
        ),
    ],
)
def test_files(
    content: bytes, code: int, printed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trace = tmp_path / 'trace.csv'
    trace.write_bytes(content)
    assert main(['--trace', str(trace), 'm = 1']) == code
    assert printed in ''.join(capsys.readouterr())


@pytest.mark.parametrize('name', ['', 'missing.csv'])
def test_a_folder_and_a_missing_file(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['--trace', str(tmp_path / name), 'm = 1']) == 2
    assert capsys.readouterr().err.startswith(f'check: cannot read the trace in {tmp_path / name}')


def test_errors_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = tmp_path / 'trace.csv'
    trace.write_text('time_s,m\n0,1\n1,x\n', encoding='utf-8')
    assert main(['--json', '--trace', str(trace), 'm = 1']) == 2
    [line] = capsys.readouterr().out.splitlines()
    error = json.loads(line)['error']
    assert error['code'] == 'INVALID_ARGUMENT'
    assert error['message'].startswith("line 3, column 'm': 'x' is not a number")
    assert main(['--json', '--trace', str(tmp_path / 'none'), 'm = 1']) == 2
    assert json.loads(capsys.readouterr().out)['error']['code'] == 'NOT_FOUND'


def test_failed_formulas_in_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trace = tmp_path / 'trace.csv'
    trace.write_text('time_s,m\n0,1\n', encoding='utf-8')
    assert main(['--json', '--trace', str(trace), 'm = 1', 'm = "1"']) == 2
    good, bad = map(json.loads, capsys.readouterr().out.splitlines())
    assert (good['verdict'], good['error']) == ('true', None)
    assert bad['verdict'] == 'undecided'
    assert bad['error']['code'] == 'INVALID_ARGUMENT'
    assert "the field 'm' holds the number 1, not a string" in bad['error']['message']
