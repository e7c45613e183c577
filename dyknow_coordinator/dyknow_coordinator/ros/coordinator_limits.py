"""Limits of the coordinator, which are parameters of the node."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Final

from dyknow_common import ExitCode, Symbol
from dyknow_common.ros import DyKnowNode, ParameterLimits
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.grounding.symbols import feature_symbols

_MAX_NAME: Final = 1000
"""The characters of the name of an evaluation or a plan."""

_PARAMETERS: Final = {
    'evaluation_limit': (500, 'Formulas that are evaluated at once, for all clients together.'),
    'plan_limit': (50, 'Plans that are monitored at once.'),
    'plan_part_limit': (1000, 'Actions and formulas of a plan.'),
    'object_limit': (10_000, 'Sorts and objects for which a formula is evaluated.'),
    'feature_limit': (1000, 'Ground features of a formula, which are the fields of its states.'),
    'ended_limit': (200, 'Formulas that are reported to operators after their end.'),
    'verdict_topic_limit': (200, 'Topics with the verdicts of formulas that have names.'),
}


class CoordinatorLimits(ParameterLimits):
    """The parameters of a node that limit requests; each error names one."""

    def __init__(self, node: DyKnowNode) -> None:
        super().__init__(node, _PARAMETERS, 10_000_000)

    def check(
        self, parameter: str, count: int, what: str, code: ExitCode = ExitCode.INVALID_ARGUMENT
    ) -> None:
        """Check a number.

        Raises:
            CoordinationError: if it exceeds the limit.
        """
        limit = self[parameter]
        if count > limit:
            remedy = (
                'try again when others have ended, or raise the parameter'
                if code is ExitCode.UNAVAILABLE
                else 'request less, or raise the parameter'
            )
            raise CoordinationError(
                f"there would be {count} {what}, more than {limit} (the limit '{parameter}' of the "
                f'coordinator); {remedy}',
                code,
            )

    def check_domains(
        self, symbols: Sequence[Symbol], domains: Mapping[str, Sequence[str]]
    ) -> None:
        """Check the objects of a formula, and the number of its ground features.

        Args:
            symbols: of the formula.
            domains: the objects of each of its sorts.

        Raises:
            CoordinationError: if there are too many.
        """
        objects = len(domains) + sum(map(len, domains.values()))
        self.check('object_limit', objects, 'sorts and objects')
        counts = {sort: len(found) for sort, found in domains.items()}
        features = sum(
            prod(counts.get(argument, 1) for argument in symbol.arguments)
            for symbol in feature_symbols(symbols)
        )
        self.check('feature_limit', features, 'features of objects in the formula')


def check_name(name: str) -> None:
    """Check the length of the name of an evaluation or a plan.

    Raises:
        CoordinationError: if it is too long.
    """
    if len(name) > _MAX_NAME:
        raise CoordinationError(
            f'the name has {len(name)} characters, more than {_MAX_NAME}; shorten it'
        )
