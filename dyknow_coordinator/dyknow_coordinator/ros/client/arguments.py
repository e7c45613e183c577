"""The types of the arguments of FormulaClient."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from types import NoneType, UnionType
from typing import Final

from dyknow_common import BlackBoxOptions, StreamConstraints
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.plans.plan import Plan

_TYPES: Final[Mapping[str, tuple[type | UnionType, str]]] = {
    'formula': (str, 'a text in the formula language'),
    'name': (str, 'a text'),
    'timeout': (Real, 'a number of seconds'),
    'wait': (Real, 'a number of seconds'),
    'grounding': (Grounding, 'a member of Grounding, such as Grounding.AUTO'),
    'constraints': (StreamConstraints, 'a StreamConstraints'),
    'plan': (Plan, 'a Plan'),
    'record': (BlackBoxOptions | NoneType, 'a BlackBoxOptions or None'),
}
"""The type of each argument, and the words for it."""


def check_request(
    formula: object,
    timeout: object,
    grounding: object,
    constraints: object,
    wait: object,
    name: object = '',
    record: object = None,
) -> None:
    """Check the types of the arguments of a request; raises like `check_arguments`."""
    check_arguments(
        formula=formula,
        timeout=timeout,
        grounding=grounding,
        constraints=constraints,
        wait=wait,
        name=name,
        record=record,
    )


def check_arguments(**arguments: object) -> None:
    """Check the types of arguments; rclpy would not say which one is wrong.

    Raises:
        TypeError: names the argument.
    """
    for name, value in arguments.items():
        expected, words = _TYPES[name]
        if not isinstance(value, expected) or isinstance(value, bool):
            raise TypeError(f'{name} must be {words}, not {value!r}')
