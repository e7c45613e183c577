"""State streams: the sources of all ground features of a formula, synchronised."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

from dyknow_common import NumberedNames, StreamConstraints, Symbol
from dyknow_coordinator.grounding.feature_sources import Candidates, FeatureSource, Grounding
from dyknow_stream_processing import Selection


@dataclass(frozen=True)
class FormulaInputs:
    """Inputs of the evaluation of a formula.

    Args:
        grounding: how its symbols find their streams.
        features: the ground features that each state must hold.
        candidates: the sources found for them.
        domains: the objects of each sort.
        constraints: the constraints of the state stream.
        unknown: the features that may be unknown, with the bounds of their values.
    """

    symbols: tuple[Symbol, ...]
    grounding: Grounding
    features: tuple[str, ...]
    candidates: Candidates
    domains: Mapping[str, tuple[str, ...]]
    constraints: StreamConstraints
    unknown: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PreparedFormula:
    """A formula in a group of its own, and its inputs.

    Args:
        name: the name of the group, and of the state stream that the engine has subscribed to.
        group_id: at the reasoning engine.
        formula_id: in the group.
        formula: its text there, with all sorts, and the units of its features.
        inputs: the inputs of its evaluation.
    """

    name: str
    group_id: int
    formula_id: int
    formula: str
    inputs: FormulaInputs


def state_specification(sources: Iterable[FeatureSource]) -> str:
    """Return the specification of the state stream: all sources, synchronised (step 6)."""
    distinct = _with_distinct_names(_shared(sources))
    units = dict.fromkeys(unit for source in distinct for unit in source.units)
    declarations = dict.fromkeys(source.declaration for source in distinct)
    names = dict.fromkeys(source.stream for source in distinct)
    return ';\n'.join([*units, *declarations, f'sink sync({", ".join(names)})'])


def _shared(sources: Iterable[FeatureSource]) -> Iterator[FeatureSource]:
    """Yield sources; features of the same samples of a stream share one select.

    So a sync of the distances of 100 robots to 50 regions has 100 inputs, not 5,000.
    """
    groups: dict[object, list[FeatureSource]] = {}
    for source in sources:
        key: object = source
        if source.select is not None:
            key = source.units, replace(source.select, selections=())
        groups.setdefault(key, []).append(source)
    for group in groups.values():
        first, *others = group
        if first.select is not None and others:
            chosen = dict.fromkeys(part for each in group for part in _selections(each))
            select = replace(first.select, selections=tuple(chosen))
            first = replace(first, declaration=f'stream {first.stream} = {select}')
        yield first


def _selections(source: FeatureSource) -> tuple[Selection, ...]:
    return () if source.select is None else source.select.selections


def _with_distinct_names(sources: Iterable[FeatureSource]) -> Sequence[FeatureSource]:
    """Rename sources, to give different streams different names."""
    declared: dict[str, str] = {}
    names: dict[tuple[str, str], str] = {}
    untried = NumberedNames()
    result = []
    for source in sources:
        stream, text = source.stream, str(source)
        if (stream, text) not in names:
            names[stream, text] = next(
                each for each in untried[stream] if declared.get(each, text) == text
            )
        name = names[stream, text]
        declared[name] = text
        result.append(replace(source, stream=name, declaration=f'stream {name} = {text}'))
    return result
