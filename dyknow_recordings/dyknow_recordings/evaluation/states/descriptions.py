"""Texts about the states of a group, which are those of the coordinator."""

from __future__ import annotations

from collections.abc import Iterable

from dyknow_coordinator import FeatureSource, describe_violation
from dyknow_stream_processing import Violation


def violation_text(violation: Violation) -> str:
    """Return the description of a violation."""
    return describe_violation(
        violation.message, violation.constraint, violation.observed, violation.allowed
    )


def sources_text(chosen: Iterable[FeatureSource]) -> str:
    """Return the sources that states are made of."""
    return f'states are made of {", ".join(sorted(map(str, chosen)))}'
