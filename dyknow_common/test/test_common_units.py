"""Units that need no look-up are units all the same, and pint is loaded for the others only."""

import subprocess
import sys
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import DyKnowError, check_unit, unit_conversion
from dyknow_common.units import COMMON_UNITS

COMMON_ONLY = """
import sys
from dyknow_common import check_unit, unit_conversion
check_unit('m/s')
assert unit_conversion('V', 'V') is None
assert unit_conversion('%', '%') is None
assert 'pint' not in sys.modules
check_unit('furlong')
assert 'pint' in sys.modules
"""


def test_common_units_are_known_to_pint() -> None:
    import pint  # noqa: PLC0415 - it takes half a second, which each process that collects would need

    registry = pint.UnitRegistry()
    assert all(registry.parse_units(unit) is not None for unit in COMMON_UNITS)


def test_common_units_do_not_load_pint() -> None:
    subprocess.run([sys.executable, '-c', COMMON_ONLY], check=True)


def test_a_common_unit_converts_to_others() -> None:
    conversion = unit_conversion('km/h', 'm/s')
    assert conversion is not None
    assert conversion(36.0) == 10.0


FACTORS = {
    ('m', 'cm'): Fraction(100),
    ('cm', 'm'): Fraction(1, 100),
    ('km/h', 'm/s'): Fraction(5, 18),
    ('ft', 'm'): Fraction(3048, 10000),
    ('m', 'ft'): Fraction(10000, 3048),
    ('min', 's'): Fraction(60),
    ('%', 'dimensionless'): Fraction(1, 100),
    ('g', 'kg'): Fraction(1, 1000),
    ('mile', 'km'): Fraction(1609344, 1000000),
}


@given(
    pair=st.sampled_from(sorted(FACTORS)),
    text=st.decimals(-(10**6), 10**6, places=4) | st.integers(-(10**18), 10**18),
)
def test_a_constant_is_rounded_once(pair: tuple[str, str], text: object) -> None:
    value = int(str(text)) if '.' not in str(text) else float(str(text))
    conversion = unit_conversion(*pair)
    assert conversion is not None
    exact = Fraction(str(text)) * FACTORS[pair]
    converted = conversion.of_constant(value)
    assert converted == (exact if exact.denominator == 1 else float(exact))


def test_a_temperature_is_rounded_once() -> None:
    conversion = unit_conversion('degC', 'K')
    assert conversion is not None
    assert (conversion.of_constant(0.1), conversion(0.1)) == (273.25, 273.25)
    assert conversion.of_constant(-273.15) == 0


@pytest.mark.parametrize(('given', 'wanted'), [('m', 'V'), ('V', 'warp'), ('warp', 'warp')])
def test_what_does_not_convert_is_refused(given: str, wanted: str) -> None:
    with pytest.raises(DyKnowError, match=r'convert|unknown unit'):
        unit_conversion(given, wanted)


def test_an_unknown_unit_is_refused() -> None:
    with pytest.raises(DyKnowError, match="unknown unit 'warp'"):
        check_unit('warp')


@pytest.mark.parametrize('angles', ['rpm', 'rad/s', 'deg/s', 'turn/s', 'rps'])
def test_periods_are_neither_turns_nor_radians(angles: str) -> None:
    """The library takes 1 Hz for 1 rad/s, so for 9.5 rpm."""
    for pair in ((angles, 'kHz'), ('Hz', angles), (f'm/({angles})', 'm/Hz')):
        with pytest.raises(DyKnowError, match=r'Hz may be turns or radians; write turn/s or rad/s'):
            unit_conversion(*pair)
    assert unit_conversion('Hz', '1/s') is None
    assert unit_conversion('rad*Hz', 'rad/s') is None
    conversion = unit_conversion('turn/s', 'rpm')
    assert conversion is not None
    assert conversion(10.0) == 600.0
