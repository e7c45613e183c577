"""The functions of formulas, and how many operands they have."""

from __future__ import annotations

from typing import Final

from lark import Token

from dyknow_common import AGGREGATES, CONVERSIONS, PositionedError, TextPosition

_OPERANDS: Final[dict[str, tuple[str, int, int | None]]] = {
    'abs': ('one operand', 1, 1),
    'sqrt': ('one operand', 1, 1),
    'sin': ('one operand', 1, 1),
    'cos': ('one operand', 1, 1),
    'atan2': ('two operands', 2, 2),
    'angle_difference': ('two operands', 2, 2),
    'mod': ('two operands', 2, 2),
    'bit': ('two operands', 2, 2),
    'pow': ('two operands', 2, 2),
    'min': ('two operands or more', 2, None),
    'max': ('two operands or more', 2, None),
    'hypot': ('two operands or more', 2, None),
    'prev': ('one operand', 1, 1),
    'normal': ('a mean, a standard deviation and perhaps a time constant', 2, 3),
    'P': ('one operand, a formula', 1, 1),
}
"""For each function, its operands in words, the fewest and the most."""


FIELD_FUNCTIONS: Final = frozenset({*AGGREGATES, *CONVERSIONS})
"""The functions that have one operand, a field of a stream."""

_NAMES: Final = (*_OPERANDS, *sorted(FIELD_FUNCTIONS - _OPERANDS.keys()))

OBJECT_FUNCTIONS: Final = ('max', 'min', 'sum', 'count')
"""The functions of values of all objects of a sort."""


def check_call(name: Token, operands: int) -> None:
    """Check that a function has this number of operands.

    Raises:
        PositionedError: if it has not.
    """
    if name not in _OPERANDS:
        message = f"'{name}' has one operand, a field of a stream, not {operands}"
        raise PositionedError(message, TextPosition.of(name))
    wanted, fewest, most = _OPERANDS[name]
    if operands < fewest or (most is not None and operands > most):
        raise PositionedError(f"'{name}' has {wanted}, not {operands}", TextPosition.of(name))


def not_a_function(name: Token) -> PositionedError:
    """Return the error of a name that is reserved for functions, where it is not one."""
    if name in _OPERANDS or name in FIELD_FUNCTIONS:
        message = f"'{name}' is a function; write its operands in round brackets, {name}(...)"
    else:
        message = (
            f"'{name}' is no function of formulas, which are {', '.join(_NAMES)}; apply a "
            'computational unit in a stream, and use that stream'
        )
    return PositionedError(message, TextPosition.of(name))
