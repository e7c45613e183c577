"""From the symbols of a formula to the one stream of states that it is evaluated over (section V).

A symbol is grounded *semantically*, by the streams that the matching engine finds for its concept,
or *syntactically*, when it names a stream and a field: `uav1_power.power`,
`"/uav1/battery".voltage`, or `uav1_power` where the stream has one field only.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from itertools import chain, count

from dyknow_common import ExitCode, Symbol, SymbolKind
from dyknow_coordinator.errors import CoordinationError
from dyknow_stream_processing import Select, StreamDeclaration, UnitDeclaration, parse_specification


class Grounding(IntEnum):
    """How symbols find their streams; the numbers are those of EvaluateFormula."""

    AUTO = 0
    SYNTACTIC = 1
    SEMANTIC = 2


@dataclass(frozen=True, slots=True)
class FeatureSource:
    """A stream specification that delivers one ground feature as its only field.

    Args:
        feature: the ground feature, `Power[uav1]`.
        stream: the name that the specification declares.
        declaration: `stream NAME = ...`, canonical.
        units: the declarations of the computational units that it uses, canonical.
        grounding: how it was found: SYNTACTIC or SEMANTIC.
    """

    feature: str
    stream: str
    declaration: str
    units: tuple[str, ...] = ()
    grounding: Grounding = Grounding.SEMANTIC

    def __str__(self) -> str:
        return self.declaration.partition(' = ')[2]


@dataclass(frozen=True)
class Candidates:
    """The sources that were found for the features of a formula.

    Args:
        found: those of one feature after each other, the best first.
        nearest: for symbols without any, what came nearest.
    """

    found: tuple[FeatureSource, ...]
    nearest: Mapping[str, str] = field(default_factory=dict)

    def of(self, feature: str) -> tuple[FeatureSource, ...]:
        """The sources of a ground feature, the best first."""
        return tuple(source for source in self.found if source.feature == feature)

    def choose(
        self, needed: Iterable[str], *preferences: Callable[[FeatureSource], bool]
    ) -> tuple[FeatureSource, ...]:
        """A source for each ground feature, in the order of their names.

        Args:
            needed: the ground features.
            preferences: what is asked of a source; where no source of a feature fulfils all, the
                last ones are given up.

        Raises:
            CoordinationError: NOT_FOUND, naming every ground feature without a source.
        """
        ordered = sorted(needed)
        missing = [feature for feature in ordered if not self.of(feature)]
        if missing:
            raise self._missing(missing)
        return tuple(_preferred(self.of(feature), preferences) for feature in ordered)

    def _missing(self, missing: Sequence[str]) -> CoordinationError:
        names = {_feature_name(feature) for feature in missing}
        there = dict.fromkeys(source.feature for source in self.found)
        near = sorted(feature for feature in there if _feature_name(feature) in names)
        others = f' (there are streams for {", ".join(near)})' if near else ''
        reasons = [text for symbol, text in self.nearest.items() if _feature_name(symbol) in names]
        text = f'no stream carries {", ".join(missing)}{others}; annotate one that does'
        return CoordinationError('\n'.join([text, *reasons]), ExitCode.NOT_FOUND)


def _preferred(
    sources: Sequence[FeatureSource], preferences: Sequence[Callable[[FeatureSource], bool]]
) -> FeatureSource:
    if not preferences:
        return sources[0]
    for source in sources:
        if all(prefers(source) for prefers in preferences):
            return source
    return _preferred(sources, preferences[:-1])


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
        if grounding is Grounding.SYNTACTIC and not symbol.may_be_stream:
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


def sources(specifications: Iterable[str]) -> tuple[FeatureSource, ...]:
    """The ground features that the matching engine's specifications deliver, in the same order."""
    return tuple(source for text in specifications for source in _sources_of(text))


def _sources_of(text: str) -> Iterable[FeatureSource]:
    declarations = parse_specification(text).declarations
    units = tuple(str(each) for each in declarations if isinstance(each, UnitDeclaration))
    for declaration in declarations:
        if isinstance(declaration, StreamDeclaration) and isinstance(declaration.stream, Select):
            for selection in declaration.stream.selections:
                yield FeatureSource(selection.name, declaration.name, str(declaration), units)


def referenced(symbol: Symbol) -> FeatureSource:
    """The source of a symbol that names its stream and field itself."""
    stream, selected = _split_reference(symbol.name)
    return _reference(symbol, stream, selected)


def only_field(symbol: Symbol, fields: Sequence[str]) -> FeatureSource:
    """The source of a symbol that names a stream with these fields.

    Raises:
        CoordinationError: unless the stream has just one.
    """
    if len(fields) != 1:
        known = ', '.join(fields) or 'none that is known'
        raise CoordinationError(
            f"the stream '{symbol}' has several fields or none ({known}); write which one is "
            f'meant: {symbol}.field'
        )
    return _reference(symbol, symbol.name, fields[0])


def _reference(symbol: Symbol, stream: str, selected: str) -> FeatureSource:
    name = 'reference_to_' + re.sub('[^A-Za-z0-9]+', '_', symbol.name).strip('_')
    text = f'stream {name} = select {selected} as {json.dumps(symbol.name)} from {stream}'
    declaration = str(parse_specification(text))
    return FeatureSource(symbol.name, name, declaration, grounding=Grounding.SYNTACTIC)


def _split_reference(name: str) -> tuple[str, str]:
    if name.startswith('"'):
        end = name.index('"', 1) + 1
        return name[:end], name[end + 1 :]
    stream, _, selected = name.partition('.')
    return stream, selected


def state_specification(chosen: Sequence[FeatureSource]) -> str:
    """The specification of the stream of states: all sources, synchronised (step 6)."""
    distinct = _with_names_of_their_own(chosen)
    units = dict.fromkeys(unit for source in distinct for unit in source.units)
    declarations = dict.fromkeys(source.declaration for source in distinct)
    names = dict.fromkeys(source.stream for source in distinct)
    return ';\n'.join([*units, *declarations, f'sink sync({", ".join(names)})'])


def _with_names_of_their_own(chosen: Iterable[FeatureSource]) -> Sequence[FeatureSource]:
    """Sources of which no two declare different streams by one name."""
    declared: dict[str, str] = {}
    result = []
    for source in chosen:
        names = chain([source.stream], (f'{source.stream}_{number}' for number in count(2)))
        name = next(each for each in names if declared.get(each, str(source)) == str(source))
        declared[name] = str(source)
        result.append(replace(source, stream=name, declaration=f'stream {name} = {source}'))
    return result


def _feature_name(feature: str) -> str:
    return feature.partition('[')[0]
