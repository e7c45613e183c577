"""What formulas are evaluated over: sources for their features, objects for their sorts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dyknow_common import StreamConstraints, Symbol
from dyknow_coordinator.grounding.grounding import Candidates, FeatureSource, Grounding


@dataclass(frozen=True)
class GroundedFormula:
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


@dataclass(frozen=True, slots=True)
class SymbolGrounding:
    """How a symbol of a formula found its stream.

    Args:
        symbol: a ground feature, `Power[uav1]`, or a reference, `"/uav1/battery".voltage`.
        grounding: SYNTACTIC or SEMANTIC.
        stream: the specification of the stream in use, without its name.
        stand_ins: others that match, best first: one of them is taken when that one fails.
    """

    symbol: str
    grounding: Grounding
    stream: str
    stand_ins: tuple[str, ...] = ()


def symbol_groundings(
    candidates: Candidates, chosen: tuple[FeatureSource, ...]
) -> tuple[SymbolGrounding, ...]:
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
