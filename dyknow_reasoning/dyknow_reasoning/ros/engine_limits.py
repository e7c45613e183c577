"""Limits of the stream reasoning engine, which are parameters of the node."""

from __future__ import annotations

from typing import Final

from dyknow_common.ros import ParameterLimits
from dyknow_reasoning.progression.sizes import FormulaLimits

_OF_GROUP: Final = {
    'object_limit': (10_000, 'Sorts and objects for which a formula group is evaluated.'),
    'instance_limit': (10_000, 'Instances of a formula: choices of objects for its variables.'),
    'instance_part_limit': (20_000, 'Parts of a formula for one choice of objects.'),
    'part_limit': (200_000, 'Parts of all formulas of a group for all choices of objects.'),
    'node_limit': (
        100_000,
        'Maximum number of nodes that a formula may grow to by progression before it fails.',
    ),
    'possibility_limit': (
        1000,
        'Cases of unknown values at a state that make a difference to a formula.',
    ),
}
LIMITS: Final = _OF_GROUP | {
    'group_limit': (1000, 'Formula groups.'),
    'idle_group_limit': (
        500,
        'Formula groups that nobody evaluates; one more replaces the oldest of them.',
    ),
    'formula_limit': (5000, 'Formulas in all groups.'),
    'total_part_limit': (1_000_000, 'Parts of the formulas of all groups.'),
}


def limits_of_group(limits: ParameterLimits) -> FormulaLimits:
    """Return the limits of a new group, given those of the engine."""
    return FormulaLimits(**{name: limits[name] for name in _OF_GROUP})
