"""Features and their signatures, read from the annotation properties of the upper ontology."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from dyknow_common import DyKnowError, ValueType, check_unit, listed, shortened, unit_conversion
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology import vocabulary
from dyknow_semantics.ontology.names import Names
from dyknow_semantics.ontology.taxonomy import Taxonomy

_MAX_FAULTS: Final = 20
"""The number of faults that a message lists."""


@dataclass(frozen=True, slots=True)
class FeatureSignature:
    """A property of an object or a relation of several objects (paper, section V).

    Args:
        name: the shortest unambiguous name.
        argument_sorts: empty for a feature of the world as a whole.
        unit: the unit of the values, such as `m/s`; empty for a number without unit.
    """

    name: str
    argument_sorts: tuple[str, ...]
    value_type: ValueType
    unit: str = ''


@dataclass(frozen=True, slots=True)
class StatedSignature:
    """The parts of a signature that a new feature states itself; it inherits the empty ones.

    Args:
        argument_sorts: names of sorts, or their IRIs.
        value_type: one of the `ValueType`s.
        unit: the unit of the values.
    """

    argument_sorts: tuple[str, ...] = ()
    value_type: str = ''
    unit: str = ''

    def __bool__(self) -> bool:
        return bool(self.argument_sorts or self.value_type or self.unit)


INHERITED: Final = StatedSignature()
"""The signature of a sort, and of a feature that states nothing itself."""


class SignatureReader:
    """Reader of the signatures of features; a feature inherits what it does not state itself.

    Args:
        annotations: for each class, the values of each of its annotation properties.
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

    def read(
        self, features: Iterable[str], known: Mapping[str, FeatureSignature]
    ) -> dict[str, FeatureSignature]:
        """Return the signature of each feature, given and returned by IRI, perhaps a known one.

        Raises:
            SemanticsError: with a line for each feature whose signature is incomplete or
                contradicts a feature above it.
        """
        found: dict[str, FeatureSignature] = {}
        faults: list[str] = []
        for iri in sorted(features):
            try:
                found[iri] = known.get(iri) or self._signature(iri)
            except SemanticsError as error:
                faults.append(error.message)
        faults += [
            f"feature '{feature.name}' {fault} as '{found[above].name}' above it"
            for iri, feature in found.items()
            for above in sorted(self._taxonomy.above(iri) & found.keys())
            for fault in differences(feature, found[above])
        ]
        if faults:
            more = [f'and {len(faults) - _MAX_FAULTS:,} more'] if len(faults) > _MAX_FAULTS else []
            raise SemanticsError('\n'.join([*faults[:_MAX_FAULTS], *more]))
        return found

    def _signature(self, iri: str) -> FeatureSignature:
        name = self._concepts.name(iri)
        lineage = (iri, *self._taxonomy.specific_first(self._taxonomy.above(iri)))
        sorts = self._sorts(lineage, name)
        value_type = self._inherited(lineage, name, vocabulary.VALUE_TYPE)
        if value_type not in list(ValueType):
            fault = (
                f"has the value_type '{shortened(value_type)}'"
                if value_type
                else 'has no value_type'
            )
            raise SemanticsError(f"feature '{name}' {fault}; give it one of {', '.join(ValueType)}")
        unit = self._inherited(lineage, name, vocabulary.UNIT)
        try:
            if unit:
                check_unit(unit)
        except DyKnowError as error:
            raise SemanticsError(f"feature '{name}': {error}") from None
        return FeatureSignature(name, sorts, ValueType(value_type), unit)

    def _sorts(self, lineage: tuple[str, ...], name: str) -> tuple[str, ...]:
        """Return the sorts that the first concept of a lineage with any arguments states."""
        for concept in lineage:
            if sorts := self._stated_sorts(concept, name):
                return sorts
        if vocabulary.NULLARY_FEATURE in lineage:
            return ()
        raise SemanticsError(
            f"feature '{name}' has no argument sorts; give it argument1, argument2, ..., "
            'or place it below NullaryFeature'
        )

    def _stated_sorts(self, concept: str, name: str) -> tuple[str, ...]:
        stated = {
            key.removeprefix(vocabulary.ARGUMENT): sorts
            for key, sorts in self._annotations.get(concept, {}).items()
            if key.startswith(vocabulary.ARGUMENT)
        }
        numbers = [str(number) for number in range(1, len(stated) + 1)]
        if set(stated) != set(numbers) or any(len(sorts) > 1 for sorts in stated.values()):
            raise SemanticsError(
                f"feature '{name}' must number its arguments argument1, argument2, ... "
                'without gaps, with one sort each'
            )
        return tuple(self._sort(stated[number][0], name, number) for number in numbers)

    def _sort(self, concept: str, name: str, number: str) -> str:
        requirement = f"argument{number} of feature '{name}' must be a class below Object"
        try:
            iri = self._concepts.iri(concept)
        except SemanticsError as error:
            raise SemanticsError(f'{requirement}: {error}') from None
        sort = self._concepts.name(iri)
        if vocabulary.FEATURE in self._taxonomy.above(iri):
            raise SemanticsError(f"{requirement}, but '{sort}' is a feature")
        return sort

    def _inherited(self, lineage: Sequence[str], name: str, key: str) -> str:
        """Return the annotation of the nearest concepts of a lineage that have it, or ''."""
        above, found = self._taxonomy.above, dict[str, str]()
        for concept in lineage:
            stated = self._annotations.get(concept, {}).get(key, [])
            is_hidden = any(concept in above(x) and x not in above(concept) for x in found)
            if not stated or is_hidden:
                continue
            if len(stated) > 1:
                raise SemanticsError(
                    f"feature '{name}' has several annotations {key.rpartition('#')[2]}: "
                    f'{listed(sorted(stated))}; leave one'
                )
            found[concept] = stated[0]
            if concept == lineage[0]:
                break
        if len({*found.values()}) > 1:
            texts = [f'{each} of {self._concepts.name(iri)}' for iri, each in found.items()]
            raise SemanticsError(
                f"feature '{name}' inherits several annotations {key.rpartition('#')[2]}: "
                f'{listed(texts)}; give it one of its own'
            )
        return next(iter(found.values()), '')


def differences(feature: FeatureSignature, above: FeatureSignature) -> list[str]:
    """Return the reasons why a stream of one feature cannot replace a stream of another one."""
    faults: list[str] = []
    if len(feature.argument_sorts) != len(above.argument_sorts):
        number = len(above.argument_sorts)
        faults.append(f'must have as many arguments ({number})')
    if not above.value_type.accepts(feature.value_type):
        faults.append(f'must have the same value_type ({above.value_type})')
    if not converts(feature.unit, above.unit):
        faults.append(f'must measure the same ({above.unit or "no unit"})')
    return faults


def converts(unit: str, other: str) -> bool:
    """Return True if numbers of a unit convert to another one; '' converts to '' only."""
    if not (unit and other):
        return unit == other
    try:
        unit_conversion(unit, other)
    except DyKnowError:
        return False
    return True
