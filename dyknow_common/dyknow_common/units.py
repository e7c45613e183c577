"""Units of measurement; the only module that uses the library pint."""

from __future__ import annotations

import re
from dataclasses import dataclass
from difflib import get_close_matches
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any, Final

from dyknow_common.errors import DyKnowError, ExitCode, shortened

# pint evaluates the numbers in a unit. Only small exponents and roots are passed on, one each.
_EXPONENT: Final = re.compile(r'(\^|\*\*)\s*(0\.5|-?\d{1,2})(?!\s*(\^|\*|\d))|\b1\b')
_UNIT_WITHOUT_NUMBERS: Final = re.compile(r'[^\W\d]?([^\W\d]|[ */().%°-])*')
_MAX_LENGTH: Final = 100
_SIMILARITY: Final = 0.75

COMMON_UNITS: Final = frozenset(
    [
        'm',
        'mm',
        'cm',
        'km',
        's',
        'ms',
        'min',
        'h',
        'm/s',
        'km/h',
        'm/s^2',
        'rad',
        'deg',
        'rad/s',
        'deg/s',
        'rad/s^2',
        'V',
        'A',
        'W',
        'Hz',
        'N',
        'N*m',
        'Pa',
        'J',
        'T',
        'K',
        'degC',
        'kg',
        'g',
        '%',
    ]
)
"""Units that are known without pint, which takes half a second to load."""


def check_unit(unit: str) -> None:
    """Check that a unit is known.

    Raises:
        DyKnowError: NOT_FOUND, if it is not.
    """
    if unit not in COMMON_UNITS:
        _parsed(unit)


@dataclass(frozen=True, slots=True)
class UnitConversion:
    """A conversion of numbers from one unit to another: value * factor + offset.

    Args:
        factor: as a float.
        offset: as a float.
        exact: factor and offset without a rounding.
    """

    factor: float
    offset: float
    exact: tuple[Fraction, Fraction]

    def __call__(self, value: float) -> float:
        """Convert the value of a sample: each operation rounds."""
        return value * self.factor + self.offset

    def of_constant(self, value: float) -> float:
        """Convert a decimal number with one rounding: 0.29 m is 29.0 cm.

        An integer that no float holds stays an integer.

        Raises:
            OverflowError: if the result is too large for a float.
        """
        factor, offset = self.exact
        converted = Fraction(repr(value)) * factor + offset
        rounded = float(converted)
        is_rounded_integer = converted.denominator == 1 and converted != rounded
        return int(converted) if is_rounded_integer else rounded


@lru_cache(maxsize=4096)
def unit_conversion(given: str, wanted: str) -> UnitConversion | None:
    """Return the conversion of numbers between two units; `None` if the numbers are the same.

    Units of logarithms, such as dBm, convert to themselves only.

    Raises:
        DyKnowError: NOT_FOUND, if a unit is unknown; if one does not convert to the other.
    """
    if given == wanted:
        check_unit(given)
        return None
    one, other = _parsed(given), _parsed(wanted)
    if one == other:
        return None
    try:
        # In fractions, so that 1,000 ft are 304.8 m and not 304.79999999999995 m.
        origin, end = (_registry().convert(Fraction(each), one, other) for each in (0, 1))
        factor, offset = float(end - origin), float(origin)
        periods, angles = zip(*map(_has_periods_and_angles, (one, other)), strict=True)
    # Dimensions, products of units with an origin, logarithms and factors that are too large for a
    # float each have their own errors.
    except Exception as error:
        raise DyKnowError(f"the unit '{given}' does not convert to '{wanted}'") from error
    if any(periods) and angles[0] is not angles[1]:
        raise DyKnowError(
            f"the unit '{given}' does not convert to '{wanted}': the periods of Hz may be turns or "
            'radians; write turn/s or rad/s'
        )
    if (end - origin, origin) == (1, 0):
        return None
    return UnitConversion(factor, offset, (end - origin, origin))


def _has_periods_and_angles(unit: Any) -> tuple[bool, bool]:
    quantity = _registry().Quantity(1, unit)
    names, roots = (dict(each.unit_items()) for each in (quantity, quantity.to_root_units()))
    return any(name.endswith('hertz') for name in names), 'radian' in roots


@cache
def _registry() -> Any:
    # The import and pint's definitions take time, and many systems have no units.
    import pint  # noqa: PLC0415

    return pint.UnitRegistry(non_int_type=Fraction)


@lru_cache(maxsize=4096)
def _parsed(unit: str) -> Any:
    if len(unit) > _MAX_LENGTH or not _UNIT_WITHOUT_NUMBERS.fullmatch(_EXPONENT.sub('', unit)):
        raise _unknown(unit)
    try:
        return _registry().parse_units(unit)
    # pint evaluates the text, which may raise anything.
    except Exception:  # noqa: BLE001
        raise _unknown(unit) from None


def _unknown(unit: str) -> DyKnowError:
    near = get_close_matches(shortened(unit), sorted(COMMON_UNITS), 1, _SIMILARITY)
    name = f"'{shortened(unit)}'"
    text = f'unknown unit {name}; units are written as in m, ft, m/s^2, degC or %'
    if near:
        text = f"did you mean '{near[0]}' instead of {name}? (unknown unit)"
    return DyKnowError(text, ExitCode.NOT_FOUND)
