"""Units of measurement and the computational unit that converts between them."""

from __future__ import annotations

from contextlib import suppress
from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import DyKnowError, ExitCode, check_unit, unit_conversion
from dyknow_stream_processing import load_units


@pytest.mark.parametrize(
    ('number', 'unit', 'wanted', 'expected'),
    [
        (1000, 'ft', 'm', 304.8),
        (20, 'degC', 'K', 293.15),
        (-40, 'degF', '°C', -40),
        (36, 'km/h', 'm/s', 10),
        (50, '%', '1', 0.5),
        (180, 'deg', 'rad', 3.141592653589793),
        (3, 'kg m^2/s^2', 'J', 3),
        (7, 'm', 'meter', 7),
        (6, 'degC/min', 'K/s', 0.1),
    ],
)
def test_numbers_are_converted(number: float, unit: str, wanted: str, expected: float) -> None:
    convert = load_units()['convert'](given=unit, wanted=wanted)
    assert convert({'value': number}) == expected


@pytest.mark.parametrize(
    ('unit', 'wanted'), [('m', 'meter'), ('1', ''), ('m/s', 'm s^-1'), ('dBm', 'dBm')]
)
def test_two_spellings_of_a_unit_need_no_conversion(unit: str, wanted: str) -> None:
    assert unit_conversion(unit, wanted) is None


@pytest.mark.parametrize(
    ('unit', 'wanted'), [('m', 'kg'), ('m', '1'), ('K', 'm'), ('mW', 'dBm'), ('gauss', 'tesla')]
)
def test_what_does_not_convert(unit: str, wanted: str) -> None:
    message = f"^the unit '{unit}' does not convert to '{wanted}'$"
    with pytest.raises(DyKnowError, match=message):
        unit_conversion(unit, wanted)


@pytest.mark.parametrize(
    'unit', ['furlongs_or_so', '100 m', 'm^', '9**9**9', 'm^99^99', 'm^1000', '(', 'm' * 101, 'm;s']
)
def test_unknown_units(unit: str) -> None:
    with pytest.raises(DyKnowError, match='unknown unit') as error:
        check_unit(unit)
    assert error.value.code is ExitCode.NOT_FOUND


@given(st.text('m1s9^*/() -%', max_size=12))
def test_any_text_is_a_unit_or_none(unit: str) -> None:
    with suppress(DyKnowError):
        check_unit(unit)


@given(
    st.floats(-1e6, 1e6), st.sampled_from(['m', 'ft', 'km', 'degC', 'K', 'degF']),
    st.sampled_from(['m', 'ft', 'km', 'degC', 'K', 'degF']),
)  # fmt: skip
def test_there_and_back(number: float, unit: str, wanted: str) -> None:
    try:
        there, back = unit_conversion(unit, wanted) or float, unit_conversion(wanted, unit) or float
    except DyKnowError:
        assert (unit in {'m', 'ft', 'km'}) != (wanted in {'m', 'ft', 'km'})
    else:
        assert back(there(number)) == pytest.approx(number, rel=1e-9, abs=1e-9)
        assert there(inf) == inf
