"""Inputs of an evaluation that stay the same while it changes from one state stream to another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from dyknow_common import listed
from dyknow_reasoning.errors import ReasoningError


@dataclass(frozen=True, slots=True)
class FixedInputs:
    """The domains of a group, and the topic of its results.

    Args:
        domains: the objects of each sort.
        result_topic: the topic of the results; empty before the evaluation.
    """

    domains: Mapping[str, Sequence[str]] = field(default_factory=dict)
    result_topic: str = ''

    def check(self, domains: Mapping[str, Sequence[str]], result_topic: str) -> None:
        """Check that a request gives the same ones, or none.

        Raises:
            ReasoningError: naming the sort with other objects, or the topic.
        """
        for sort, objects in domains.items():
            if objects != self.domains.get(sort):
                was = listed(self.domains.get(sort, ())) or 'none'
                raise ReasoningError(
                    f"domains: the objects of the sort '{sort}' are fixed while the group is "
                    f'evaluated ({was}); make a new group for others'
                )
        if result_topic not in {'', self.result_topic}:
            raise ReasoningError(
                f"result_topic: the group publishes its results on '{self.result_topic}' as long "
                f"as it is evaluated, not on '{result_topic}'"
            )
