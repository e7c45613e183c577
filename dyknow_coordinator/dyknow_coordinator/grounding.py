"""From the symbols of a formula to the one stream of states that it is evaluated over (section V).

A symbol is grounded *semantically*, by the streams that the matching engine finds for its concept,
or *syntactically*, when it names a stream and a field: `uav1_power.power` or
`"/uav1/battery".voltage`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from dyknow_coordinator.errors import CoordinationError
from dyknow_stream_processing import (
    ExitCode,
    Select,
    StreamDeclaration,
    UnitDeclaration,
    parse_specification,
)

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence


class Grounding(IntEnum):
    """How symbols find their streams; the numbers are those of EvaluateFormula."""

    AUTO = 0
    SYNTACTIC = 1
    SEMANTIC = 2


class SymbolKind(IntEnum):
    """What a symbol stands for; the numbers are those of dyknow_interfaces/msg/Symbol."""

    FEATURE = 0
    SORT = 1
    OBJECT = 2


@dataclass(frozen=True, slots=True)
class Symbol:
    """A symbol of a formula.

    Args:
        arguments: of a feature, for each place an object or the sort that its variable ranges over.
    """

    kind: SymbolKind
    name: str
    arguments: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f'{self.name}[{", ".join(self.arguments)}]' if self.arguments else self.name

    @property
    def is_reference(self) -> bool:
        """Whether the symbol names a stream and a field itself."""
        return self.kind is SymbolKind.FEATURE and '.' in self.name


@dataclass(frozen=True, slots=True)
class Source:
    """A stream specification that delivers one ground feature as its only field.

    Args:
        feature: the ground feature, `Power[uav1]`.
        stream: the name that the specification declares.
        declaration: `stream NAME = ...`, canonical.
        units: the declarations of the computational units that it uses, canonical.
    """

    feature: str
    stream: str
    declaration: str
    units: tuple[str, ...] = ()


def features(symbols: Iterable[Symbol]) -> tuple[Symbol, ...]:
    """The features among symbols."""
    return tuple(symbol for symbol in symbols if symbol.kind is SymbolKind.FEATURE)


def sorts(symbols: Iterable[Symbol]) -> tuple[str, ...]:
    """The names of the sorts among symbols."""
    return tuple(symbol.name for symbol in symbols if symbol.kind is SymbolKind.SORT)


def check_grounding(symbols: Iterable[Symbol], grounding: Grounding) -> None:
    """Checks that every feature can be grounded in the way that was asked for.

    Raises:
        CoordinationError: names the first feature that cannot.
    """
    for symbol in features(symbols):
        if grounding is Grounding.SYNTACTIC and not symbol.is_reference:
            raise CoordinationError(
                f"'{symbol}' names no stream, as syntactic grounding asks; write stream.field or "
                f'"/topic".field, or ask for semantic grounding'
            )
        if grounding is Grounding.SEMANTIC and symbol.is_reference:
            raise CoordinationError(
                f"'{symbol}' names a stream; with semantic grounding write a feature of the "
                f'ontology, or ask for grounding AUTO'
            )


def concept_of(symbol: Symbol, sort_names: Collection[str]) -> str:
    """What the matching engine is asked for: `Power[a] for every a in UAV`."""
    names = [
        f'object{place}' if argument in sort_names else argument
        for place, argument in enumerate(symbol.arguments, start=1)
    ]
    ranges = [
        f'{name} in {argument}'
        for name, argument in zip(names, symbol.arguments, strict=True)
        if argument in sort_names
    ]
    concept = f'{symbol.name}[{", ".join(names)}]' if names else symbol.name
    return f'{concept} for every {", ".join(ranges)}' if ranges else concept


def sources(specifications: Iterable[str]) -> tuple[Source, ...]:
    """The ground features that the matching engine's specifications deliver, in the same order."""
    return tuple(source for text in specifications for source in _sources_of(text))


def _sources_of(text: str) -> Iterable[Source]:
    declarations = parse_specification(text).declarations
    units = tuple(str(each) for each in declarations if isinstance(each, UnitDeclaration))
    for declaration in declarations:
        if isinstance(declaration, StreamDeclaration) and isinstance(declaration.stream, Select):
            for selection in declaration.stream.selections:
                yield Source(selection.name, declaration.name, str(declaration), units)


def referenced(symbol: Symbol, number: int) -> Source:
    """The source of a symbol that names its stream and field itself."""
    stream, field = _split_reference(symbol.name)
    name = f'reference_{number}'
    declaration = f'stream {name} = select {field} as {json.dumps(symbol.name)} from {stream}'
    return Source(symbol.name, name, declaration)


def _split_reference(name: str) -> tuple[str, str]:
    if name.startswith('"'):
        end = name.index('"', 1) + 1
        return name[:end], name[end + 1 :]
    stream, _, field = name.partition('.')
    return stream, field


def choose(needed: Sequence[str], found: Iterable[Source]) -> tuple[Source, ...]:
    """The best source of each ground feature that a formula needs: the first that was found.

    Raises:
        CoordinationError: NOT_FOUND, naming every ground feature without a source.
    """
    best: dict[str, Source] = {}
    for source in found:
        best.setdefault(source.feature, source)
    missing = [feature for feature in needed if feature not in best]
    if missing:
        raise CoordinationError(
            f'no stream carries {", ".join(missing)}{_nearby(missing, best)}; '
            'annotate one that does',
            ExitCode.NOT_FOUND,
        )
    return tuple(best[feature] for feature in needed)


def _nearby(missing: Sequence[str], best: Mapping[str, Source]) -> str:
    names = {feature.partition('[')[0] for feature in missing}
    near = sorted(feature for feature in best if feature.partition('[')[0] in names)
    return f' (there are streams for {", ".join(near)})' if near else ''


def state_specification(chosen: Sequence[Source]) -> str:
    """The specification of the stream of states: all sources, synchronised (step 6)."""
    units = dict.fromkeys(unit for source in chosen for unit in source.units)
    declarations = dict.fromkeys(source.declaration for source in chosen)
    names = dict.fromkeys(source.stream for source in chosen)
    return ';\n'.join([*units, *declarations, f'sink sync({", ".join(names)})'])
