"""Feature sources: streams that deliver the ground features of a formula.

A symbol is grounded *semantically*, by the streams that the matching engine finds for its concept,
or *syntactically*, when it names a stream and a field: `uav1_power.power`,
`"/uav1/battery".voltage`, or `uav1_power` if the stream has only one field.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import Final

from dyknow_common import (
    NOT_CALIBRATED,
    ExitCode,
    Symbol,
    listed,
    quoted,
    without_generated_text,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_stream_processing import (
    Select,
    StreamDeclaration,
    StreamReference,
    UnitDeclaration,
    parse_specification,
)


class Grounding(IntEnum):
    """Method to find streams for symbols; numbers as in EvaluateFormula."""

    AUTO = 0
    SYNTACTIC = 1
    SEMANTIC = 2


@dataclass(frozen=True, slots=True)
class SymbolGrounding:
    """The stream for one symbol of a formula.

    Args:
        symbol: a ground feature, `Power[uav1]`, or a reference, `"/uav1/battery".voltage`.
        grounding: SYNTACTIC or SEMANTIC.
        stream: the specification of the stream in use, without its name.
        stand_ins: matching streams that can replace it, best first.
    """

    symbol: str
    grounding: Grounding
    stream: str
    stand_ins: tuple[str, ...] = ()


def with_caveat(explanation: str, groundings: Iterable[SymbolGrounding]) -> str:
    """Return an explanation that says which of its features are forecasts without calibration."""
    found = [each.symbol for each in groundings if NOT_CALIBRATED in each.stream]
    if not found:
        return explanation
    return f'{explanation} (not calibrated: {listed(sorted(found))})'.strip()


@dataclass(frozen=True, slots=True)
class FeatureSource:
    """A stream specification that delivers one ground feature as its only field.

    Args:
        feature: the ground feature, `Power[uav1]`.
        stream: the name that the specification declares.
        declaration: `stream NAME = ...`, canonical.
        units: the declarations of its computational units, canonical.
        grounding: how it was found: SYNTACTIC or SEMANTIC.
        select: the declared stream, if features of the same stream may share it.
    """

    feature: str
    stream: str
    declaration: str
    units: tuple[str, ...] = ()
    grounding: Grounding = Grounding.SEMANTIC
    select: Select | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return self.declaration.partition(' = ')[2]


_OF_TWO: Final = (
    'inside', 'crosses', 'in_sight', 'ahead_of', 'left_of', 'facing', 'bearing_to',
    'longitudinal_distance', 'lateral_distance',
)  # fmt: skip
"""The relations of positions, which are features only if they are not of two objects."""

_POSITION: Final = 'beside the position in the robot.yaml'

_MENDS: Final = {
    'swept_distance': f"state 'moves: straight' {_POSITION}",
    'yaw': f"state 'orientation' or 'yaw' {_POSITION}",
    'sight_distance': f"state 'walls' {_POSITION}",
    **{name: f'the relation is of two objects: {name}(a, b)' for name in _OF_TWO},
}
"""The mends by the features that positions may give."""


@dataclass(frozen=True)
class Candidates:
    """The sources found for the features of a formula.

    Args:
        found: sources; the sources of one feature are in descending order of quality.
        nearest: for symbols without a source, the nearest matches as text.
    """

    found: tuple[FeatureSource, ...]
    nearest: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def _by_feature(self) -> Mapping[str, tuple[FeatureSource, ...]]:
        found: dict[str, list[FeatureSource]] = {}
        for source in self.found:
            found.setdefault(source.feature, []).append(source)
        return {feature: tuple(sources) for feature, sources in found.items()}

    def of(self, feature: str) -> tuple[FeatureSource, ...]:
        """Return the sources of a ground feature, best first."""
        return self._by_feature.get(feature, ())

    def choose(
        self, features: Iterable[str], *preferences: Callable[[FeatureSource], bool]
    ) -> tuple[FeatureSource, ...]:
        """Return a source for each ground feature, ordered by feature.

        Args:
            features: the ground features.
            preferences: conditions in order of importance. If no source of a feature meets all,
                the last ones are ignored.

        Raises:
            CoordinationError: NOT_FOUND, naming every ground feature without a source.
        """
        ordered = sorted(features)
        missing = [feature for feature in ordered if not self.of(feature)]
        if missing:
            raise self._not_found(missing)
        return tuple(_preferred(self.of(feature), preferences) for feature in ordered)

    def symbol_groundings(self, chosen: Iterable[FeatureSource]) -> tuple[SymbolGrounding, ...]:
        """Return the grounding of each ground feature, given the chosen sources."""
        return tuple(
            SymbolGrounding(
                symbol=source.feature,
                grounding=source.grounding,
                stream=str(source),
                stand_ins=tuple(
                    str(other)
                    for other in self.of(source.feature)
                    if other.declaration != source.declaration
                ),
            )
            for source in chosen
        )

    def _not_found(self, missing: Sequence[str]) -> CoordinationError:
        names = {_feature_name(feature) for feature in missing}
        found = dict.fromkeys(source.feature for source in self.found)
        similar = sorted(feature for feature in found if _feature_name(feature) in names)
        others = f' (there are streams for {listed(similar)})' if similar else ''
        reasons = [text for symbol, text in self.nearest.items() if _feature_name(symbol) in names]
        faults = [without_generated_text(each) for each in reasons]
        mend = next((_MENDS[name] for name in sorted(names) if name in _MENDS), '')
        if mend or faults == reasons:  # The feature and its objects are known.
            text = (
                f'no stream carries {listed(missing)}{others}; {mend or "annotate one that does"}'
            )
            faults = [text, *(reasons if faults == reasons else ())]
        return CoordinationError('\n'.join(dict.fromkeys(faults)), ExitCode.NOT_FOUND)


def _feature_name(feature: str) -> str:
    return feature.partition('[')[0]


def _preferred(
    sources: Sequence[FeatureSource], preferences: Sequence[Callable[[FeatureSource], bool]]
) -> FeatureSource:
    if len(sources) == 1:
        return sources[0]  # A formula may have thousands of features.
    return next(
        source
        for count in range(len(preferences), -1, -1)
        for source in sources
        if all(prefers(source) for prefers in preferences[:count])
    )


def parse_sources(specifications: Iterable[str]) -> tuple[FeatureSource, ...]:
    """Return the sources declared in specifications of the matching engine, in their order."""
    return tuple(source for text in specifications for source in _sources_in(text))


def _sources_in(specification: str) -> Iterable[FeatureSource]:
    declarations = parse_specification(specification).declarations
    units = tuple(str(each) for each in declarations if isinstance(each, UnitDeclaration))
    for declaration in declarations:
        if isinstance(declaration, StreamDeclaration) and isinstance(declaration.stream, Select):
            for selection in declaration.stream.selections:
                yield FeatureSource(
                    selection.name,
                    declaration.name,
                    str(declaration),
                    units,
                    select=declaration.stream if _has_all_fields(declaration.stream) else None,
                )


def _has_all_fields(select: Select) -> bool:
    """Return True if all samples have what is selected; messages of topics may lack some of it."""
    return isinstance(select.source, StreamReference) and not select.source.is_topic


def referenced_source(symbol: Symbol) -> FeatureSource:
    """Return the source of a symbol that names its stream and field."""
    return _syntactic_source(symbol, *symbol.reference)


def single_field_source(symbol: Symbol, fields: Sequence[str]) -> FeatureSource:
    """Return the source of a symbol that names a stream with the given fields.

    Raises:
        CoordinationError: if the stream does not have exactly one field.
    """
    if len(fields) != 1:
        known = ', '.join(fields) or 'none is known'
        raise CoordinationError(
            f"'{symbol}' names a stream but not which of its fields ({known}); write {symbol}.field"
        )
    return _syntactic_source(symbol, symbol.name, fields[0])


def _syntactic_source(symbol: Symbol, stream: str, selected: str) -> FeatureSource:
    name = 'reference_to_' + re.sub('[^A-Za-z0-9]+', '_', symbol.name).strip('_')
    renaming = quoted(symbol.name.replace('%', '%%'))
    text = f'stream {name} = select {selected} as {renaming} from {stream}'
    declaration = str(parse_specification(text))
    return FeatureSource(symbol.name, name, declaration, grounding=Grounding.SYNTACTIC)
