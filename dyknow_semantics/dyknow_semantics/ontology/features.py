"""Features and their signatures, as the annotations of the upper ontology state them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from dyknow_common import DyKnowError, ValueType, check_unit, unit_conversion
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.names import Names
from dyknow_semantics.ontology.taxonomy import Taxonomy
from dyknow_semantics.ontology.vocabulary import (
    ARGUMENT,
    FEATURE,
    NULLARY_FEATURE,
    UNIT,
    VALUE_TYPE,
)


@dataclass(frozen=True, slots=True)
class FeatureSignature:
    """A property of an object or a relation between several (paper, section V).

    Args:
        name: the shortest name that only this feature bears.
        argument_sorts: the sort of each argument; none for a feature of the world as a whole.
        value_type: the type of its values.
        unit: what its values are measured in, such as `m/s`; empty without one.
    """

    name: str
    argument_sorts: tuple[str, ...]
    value_type: ValueType
    unit: str = ''


class SignatureReader:
    """Reads the signatures of features; what one leaves out it takes from those above it.

    Args:
        taxonomy: the order of all concepts.
        annotations: for each class, the values of each of its annotation properties.
        concepts: the names of all concepts.
    """

    def __init__(
        self,
        taxonomy: Taxonomy,
        annotations: Mapping[str, Mapping[str, list[str]]],
        concepts: Names,
    ) -> None:
        self._taxonomy = taxonomy
        self._annotations = annotations
        self._concepts = concepts

    def read(self, features: Iterable[str]) -> dict[str, FeatureSignature]:
        """The feature that each IRI stands for.

        Raises:
            SemanticsError: with a line for each feature whose signature is incomplete or
                contradicts one above it.
        """
        found: dict[str, FeatureSignature] = {}
        faults: list[str] = []
        for iri in sorted(features):
            try:
                found[iri] = self._feature(iri)
            except SemanticsError as error:
                faults.append(error.message)
        faults += self._contradictions(found)
        if faults:
            raise SemanticsError('\n'.join(faults))
        return found

    def _feature(self, iri: str) -> FeatureSignature:
        name = self._concepts.name(iri)
        sorts, value_type = self._sorts(iri, name), self._value_type(iri, name)
        return FeatureSignature(name, sorts, value_type, self._unit(iri, name))

    def _sorts(self, iri: str, name: str) -> tuple[str, ...]:
        above = self._taxonomy.specific_first(self._taxonomy.above(iri))
        for concept in (iri, *above):
            if stated := self._own_sorts(concept, name):
                return stated
        if NULLARY_FEATURE in above:
            return ()
        raise SemanticsError(
            f"feature '{name}' has no argument sorts; annotate it with argument1, argument2, ..., "
            'or place it below NullaryFeature'
        )

    def _own_sorts(self, concept: str, name: str) -> tuple[str, ...]:
        stated = {
            place.removeprefix(ARGUMENT): sorts
            for place, sorts in self._annotations.get(concept, {}).items()
            if place.startswith(ARGUMENT)
        }
        places = [str(number) for number in range(1, len(stated) + 1)]
        if set(stated) != set(places) or any(len(sorts) > 1 for sorts in stated.values()):
            raise SemanticsError(
                f"feature '{name}' must number its arguments argument1, argument2, ... "
                'without gaps, with one sort each'
            )
        return tuple(self._sort(stated[place][0], name, place) for place in places)

    def _sort(self, concept: str, name: str, place: str) -> str:
        try:
            iri = self._concepts.iri(concept)
        except SemanticsError as error:
            raise SemanticsError(
                f"argument{place} of feature '{name}' must be a class below Object: {error}"
            ) from None
        if FEATURE in self._taxonomy.above(iri):
            raise SemanticsError(
                f"argument{place} of feature '{name}' must be a class below Object, "
                f"but '{self._concepts.name(iri)}' is a feature"
            )
        return self._concepts.name(iri)

    def _value_type(self, iri: str, name: str) -> ValueType:
        stated = self._nearest(iri, name, VALUE_TYPE)
        if stated not in list(ValueType):
            fault = f"has the value_type '{stated}'" if stated else 'has no value_type'
            raise SemanticsError(
                f"feature '{name}' {fault}; annotate it with one of {', '.join(ValueType)}"
            )
        return ValueType(stated)

    def _unit(self, iri: str, name: str) -> str:
        unit = self._nearest(iri, name, UNIT)
        try:
            if unit:
                check_unit(unit)
        except DyKnowError as error:
            raise SemanticsError(f"feature '{name}': {error}") from None
        return unit

    def _nearest(self, iri: str, name: str, annotation: str) -> str:
        """What a feature, or else the most specific one above it, states once; or nothing."""
        above = self._taxonomy.specific_first(self._taxonomy.above(iri))
        for concept in (iri, *above):
            stated = self._annotations.get(concept, {}).get(annotation, [])
            if len(stated) > 1:
                raise SemanticsError(
                    f"feature '{name}' has several annotations {annotation.rpartition('#')[2]}: "
                    f'{", ".join(sorted(stated))}; leave one'
                )
            if stated:
                return stated[0]
        return ''

    def _contradictions(self, features: Mapping[str, FeatureSignature]) -> list[str]:
        """Why some feature may not stand in for one above it."""
        return [
            f"feature '{feature.name}' {fault} as '{features[above].name}' above it"
            for iri, feature in features.items()
            for above in sorted(self._taxonomy.above(iri) & features.keys())
            for fault in differences(feature, features[above])
        ]


def differences(feature: FeatureSignature, above: FeatureSignature) -> list[str]:
    """Why a feature may not stand in for another one."""
    faults: list[str] = []
    if len(feature.argument_sorts) != len(above.argument_sorts):
        faults.append('must have as many arguments')
    if feature.value_type != above.value_type and not (
        feature.value_type is ValueType.INT and above.value_type is ValueType.FLOAT
    ):
        faults.append(f'must have the same value_type ({above.value_type})')
    if not converts(feature.unit, above.unit):
        faults.append(f'must measure the same ({above.unit or "no unit"})')
    return faults


def converts(unit: str, other: str) -> bool:
    """Whether numbers of a unit can be told in another one; no unit is none."""
    if not (unit and other):
        return unit == other
    try:
        unit_conversion(unit, other)
    except DyKnowError:
        return False
    return True
