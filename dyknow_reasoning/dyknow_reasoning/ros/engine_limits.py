"""Limits of the stream reasoning engine, which are parameters of the node."""

from __future__ import annotations

from typing import Final

from dyknow_common import ExitCode
from dyknow_common.ros import DyKnowNode, ParameterLimits
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.progression.sizes import FormulaLimits, amount

_MAX_NAME: Final = 1000
"""The characters of the name of a group or a formula."""

_MOST: Final = 100_000_000

_OF_GROUP: Final = {
    'object_limit': (10_000, 'Sorts and objects for which a formula group is evaluated.'),
    'instance_limit': (10_000, 'Instances of a formula: choices of objects for its variables.'),
    'instance_part_limit': (20_000, 'Parts of a formula for one choice of objects.'),
    'part_limit': (200_000, 'Parts of all formulas of a group for all choices of objects.'),
    'node_limit': (
        100_000,
        'Maximum number of nodes that a formula may grow to by progression before it fails.',
    ),
}
_OF_ALL: Final = {
    'group_limit': (1000, 'Formula groups.'),
    'idle_group_limit': (
        500,
        'Formula groups that nobody evaluates; one more replaces the oldest of them.',
    ),
    'formula_limit': (5000, 'Formulas in all groups.'),
    'total_part_limit': (1_000_000, 'Parts of the formulas of all groups.'),
}


class EngineLimits(ParameterLimits):
    """The parameters of a node that limit each group, and all groups."""

    def __init__(self, node: DyKnowNode) -> None:
        super().__init__(node, _OF_GROUP | _OF_ALL, _MOST)

    def of_group(self) -> FormulaLimits:
        """Return the limits of a new group."""
        return FormulaLimits(**{name: self[name] for name in _OF_GROUP})

    def check(self, parameter: str, count: int, what: str) -> None:
        """Check a number against a limit of all groups.

        Raises:
            ReasoningError: UNAVAILABLE.
        """
        limit = self[parameter]
        if count > limit:
            raise ReasoningError(
                f"there would be {amount(count)} {what}, more than {limit} (the limit '{parameter}'"
                '); try again when others have ended, or raise the parameter',
                ExitCode.UNAVAILABLE,
            )


def check_name(field: str, name: str) -> None:
    """Check the length of a name.

    Raises:
        ReasoningError: names the field of the request.
    """
    if len(name) > _MAX_NAME:
        raise ReasoningError(
            f'{field}: the name has {len(name)} characters, more than {_MAX_NAME}; shorten it'
        )
