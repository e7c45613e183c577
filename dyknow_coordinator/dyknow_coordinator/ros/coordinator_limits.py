"""Limits of the coordinator, which are parameters of the node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Final

from dyknow_common import ExitCode, Symbol
from dyknow_common.ros import ParameterLimits
from dyknow_coordinator.grounding.candidate_search import feature_symbols

LIMITS: Final = {
    'evaluation_limit': (500, 'Formulas that are evaluated at once, for all clients together.'),
    'plan_limit': (50, 'Plans that are monitored at once.'),
    'plan_part_limit': (1000, 'Actions and formulas of a plan.'),
    'object_limit': (10_000, 'Sorts and objects for which a formula is evaluated.'),
    'feature_limit': (10_000, 'Ground features of a formula, which are the fields of its states.'),
    'ended_limit': (200, 'Formulas that are reported to operators after their end.'),
    'verdict_topic_limit': (200, 'Topics with the verdicts of formulas that have names.'),
}


def check_domains(
    limits: ParameterLimits, symbols: Sequence[Symbol], domains: Mapping[str, Sequence[str]]
) -> None:
    """Check the objects of a formula, and the number of its ground features.

    Args:
        limits: of the coordinator.
        symbols: of the formula.
        domains: the objects of each of its sorts.

    Raises:
        CoordinationError: if there are too many.
    """
    objects = len(domains) + sum(map(len, domains.values()))
    limits.check('object_limit', objects, 'sorts and objects', ExitCode.INVALID_ARGUMENT)
    counts = {sort: len(found) for sort, found in domains.items()}
    features = sum(
        prod(counts.get(argument, 1) for argument in symbol.arguments)
        for symbol in feature_symbols(symbols)
    )
    what = 'features of objects in the formula'
    limits.check('feature_limit', features, what, ExitCode.INVALID_ARGUMENT)
