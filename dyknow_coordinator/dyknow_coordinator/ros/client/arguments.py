"""The types of the arguments of FormulaClient."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import isfinite
from numbers import Real
from types import NoneType
from typing import Any, Final

from rclpy.node import Node

from dyknow_common import BlackBoxOptions, StreamConstraints
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.plans.plan import Plan

_TYPES: Final[Mapping[str, tuple[Any, str]]] = {
    'formula': (str, 'a text in the formula language'),
    'name': (str, 'a text'),
    'timeout': (Real, 'a number of seconds'),
    'wait': (Real, 'a number of seconds'),
    'grounding': (Grounding, 'a member of Grounding, such as Grounding.AUTO'),
    'constraints': (StreamConstraints, 'a StreamConstraints'),
    'plan': (Plan, 'a Plan'),
    'record': (BlackBoxOptions | NoneType, 'a BlackBoxOptions or None'),
    'node': (Node, 'a node of rclpy'),
    'coordinator': (str, 'the name of a node'),
    **dict.fromkeys(('margin', 'every_state', 'restart_on_change'), (bool, 'True or False')),
    **dict.fromkeys(('on_verdict', 'on_feedback'), (Callable, 'a function')),
    'on_interruption': (Callable | NoneType, 'a function or None'),
}
"""The type of each argument, and the words for it."""


def check_request(
    formula: object,
    timeout: object,
    grounding: object,
    constraints: object,
    wait: object,
    **others: object,
) -> None:
    """Check the arguments of a request; raises like `check_arguments`."""
    check_arguments(
        formula=formula,
        timeout=timeout,
        grounding=grounding,
        constraints=constraints,
        wait=wait,
        **others,
    )


def check_arguments(**arguments: object) -> None:
    """Check arguments; rclpy would not say which one is wrong, or only when they are used.

    Raises:
        TypeError: names the argument of a wrong type.
        ValueError: names the time that is not finite.
    """
    for name, value in arguments.items():
        expected, words = _TYPES[name]
        if not isinstance(value, expected) or (expected is not bool and isinstance(value, bool)):
            raise TypeError(f'{name} must be {words}, not {value!r}')
        if isinstance(value, Real) and not isfinite(value):
            raise ValueError(f'{name} must be a finite number of seconds, not {value!r}')
