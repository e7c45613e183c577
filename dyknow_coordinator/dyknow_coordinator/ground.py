"""What formulas are evaluated over: sources for their features, objects for their sorts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dyknow_coordinator.evaluation_status import SymbolGrounding

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dyknow_coordinator.grounding import Candidates, Grounding, Source, Symbol
    from dyknow_stream_processing import StreamConstraints


@dataclass(frozen=True)
class Ground:
    """What a formula is evaluated over.

    Args:
        symbols: of the formula, before its domains were fixed.
        grounding: how its symbols find their streams.
        features: the ground features that each state must hold.
        candidates: the sources found for them.
        domains: the objects of each sort.
        constraints: of the state stream.
    """

    symbols: tuple[Symbol, ...]
    grounding: Grounding
    features: tuple[str, ...]
    candidates: Candidates
    domains: Mapping[str, tuple[str, ...]]
    constraints: StreamConstraints


def groundings(candidates: Candidates, chosen: tuple[Source, ...]) -> tuple[SymbolGrounding, ...]:
    """How each ground feature found its stream."""
    return tuple(
        SymbolGrounding(
            symbol=source.feature,
            grounding=source.grounding,
            stream=str(source),
            stand_ins=tuple(
                str(other)
                for other in candidates.of(source.feature)
                if other.declaration != source.declaration
            ),
        )
        for source in chosen
    )
