"""Units that need no look-up are units all the same, and pint is loaded for the others only."""

import subprocess
import sys

import pint
import pytest

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
    registry = pint.UnitRegistry()
    assert all(registry.parse_units(unit) is not None for unit in COMMON_UNITS)


def test_common_units_do_not_load_pint() -> None:
    subprocess.run([sys.executable, '-c', COMMON_ONLY], check=True)


def test_a_common_unit_converts_to_others() -> None:
    conversion = unit_conversion('km/h', 'm/s')
    assert conversion is not None
    assert conversion(36.0) == 10.0


@pytest.mark.parametrize(('given', 'wanted'), [('m', 'V'), ('V', 'warp'), ('warp', 'warp')])
def test_what_does_not_convert_is_refused(given: str, wanted: str) -> None:
    with pytest.raises(DyKnowError, match=r'convert|unknown unit'):
        unit_conversion(given, wanted)


def test_an_unknown_unit_is_refused() -> None:
    with pytest.raises(DyKnowError, match="unknown unit 'warp'"):
        check_unit('warp')
