"""Semantic matching: the streams that carry a concept (paper, section V).

Example: `GpsAltitude` is a feature below `Altitude`, which is measured in m; `uav1` and `uav2` are
of the sort `UAV`. The streams have the annotations

    stream gps contains GpsAltitude[uav1] = alt [ft];
    stream "/fleet" contains Altitude[u] = z for every u in UAV where u = id;

The concept `Altitude[u] for every u in UAV` stands for the ground features `Altitude[uav1]` and
`Altitude[uav2]`. The answer has a stream for each ground feature of each annotated field. Streams
of the feature itself come first:

    select z as "Altitude[uav1]" from "/fleet" where id = "uav1"
    select z as "Altitude[uav2]" from "/fleet" where id = "uav2"
    select value as "Altitude[uav1]"
        from convert(select alt as value from gps, given = "ft", wanted = "m")
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from dyknow_common import LanguageError, ValueType
from dyknow_semantics.annotations.annotation import Annotation, Concept
from dyknow_semantics.annotations.checking import check_annotation, check_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.matching.index import FieldIndex
from dyknow_semantics.matching.near_misses import Explanation, near_misses, nearest
from dyknow_semantics.matching.patterns import Pattern, pattern_of
from dyknow_semantics.matching.specifications import (
    AnnotatedField,
    Match,
    MatchQuery,
    in_order,
    make_match,
)
from dyknow_semantics.ontology.features import converts
from dyknow_semantics.ontology.knowledge import Knowledge

MAX_MATCHES: Final = 10_000
"""The number of streams that may match a concept."""

_MAX_COMPARED: Final = 1_000_000
"""The number of combinations of objects that are compared for one field."""


def match(
    concept: Concept, annotations: Iterable[Annotation], knowledge: Knowledge
) -> tuple[Match, ...]:
    """Return the streams that carry a concept; for several concepts use `Matcher.match`."""
    matcher = Matcher(knowledge)
    matcher.set_annotations({str(each): each for each in annotations})
    return matcher.match(concept)


@dataclass(frozen=True, slots=True)
class _Entry:
    """An annotation with its fields, or with the reason why it is invalid."""

    annotation: Annotation
    carriers: tuple[AnnotatedField, ...]
    fault: str = ''


class Matcher:
    """Matches concepts with indexed annotations; an update processes only what has changed.

    An annotation matches nothing while it is invalid for the ontology, as after its object was
    destroyed, or while it does not fit its stream. A concept that is invalid for the ontology
    raises LanguageError in all methods.

    Args:
        knowledge: the ontologies, with the bridges between them.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        self.knowledge = knowledge
        self._object_names = ObjectNames(knowledge)
        self._entries: dict[str, _Entry] = {}
        self._annotations: Mapping[str, Annotation] = {}
        self._field_faults: Mapping[str, str] = {}
        self._mentions: dict[str, dict[str, None]] = defaultdict(dict)
        self.index = FieldIndex()

    @property
    def faults(self) -> Mapping[str, str]:
        """The reason why each invalid annotation is invalid, by its canonical text."""
        return {text: each.fault for text, each in self._entries.items() if each.fault}

    def set_annotations(
        self, annotations: Mapping[str, Annotation], faults: Mapping[str, str] | None = None
    ) -> None:
        """Replace all annotations.

        Args:
            annotations: the annotations by canonical text.
            faults: why streams do not fit their annotations, by canonical text.
        """
        faults = faults or {}
        if annotations is self._annotations and faults == self._field_faults:
            return
        changed = {text for text, _ in faults.items() ^ self._field_faults.items()}
        for text in self._entries.keys() - (annotations.keys() - changed):
            self.remove(text)
        self._field_faults = faults
        for text in annotations.keys() - self._entries.keys():
            self.add(text, annotations[text])
        self._annotations = annotations

    def add(self, text: str, annotation: Annotation) -> None:
        """Add an annotation with its canonical text."""
        entry = self._entries[text] = self._entry(annotation, self._field_faults.get(text, ''))
        for carrier in entry.carriers:
            self.index.add(carrier)
        for name in _mentioned(annotation):
            self._mentions[name][text] = None

    def remove(self, text: str) -> None:
        """Remove the annotation with a canonical text."""
        entry = self._entries.pop(text)
        for carrier in entry.carriers:
            self.index.remove(carrier)
        for name in _mentioned(entry.annotation):
            del self._mentions[name][text]
            if not self._mentions[name]:
                del self._mentions[name]

    def set_knowledge(self, knowledge: Knowledge) -> None:
        """Replace the ontologies; the argument is the same as of the class."""
        before = self.knowledge
        if before is knowledge:
            return
        self.knowledge = knowledge
        self._object_names = ObjectNames(knowledge)
        compared = {(before, knowledge), (before.stated, knowledge.stated)}
        changed = [
            name
            for name in self._mentions
            if any(old.meaning(name) != new.meaning(name) for old, new in compared)
        ]
        for text in dict.fromkeys(text for name in changed for text in self._mentions[name]):
            annotation = self._entries[text].annotation
            self.remove(text)
            self.add(text, annotation)

    def match(self, concept: Concept, max_matches: int = MAX_MATCHES) -> tuple[Match, ...]:
        """Return the streams that carry a concept.

        There is one for each ground feature of each annotated field. Exact matches come first, then
        matches with a shorter sample period, then with a shorter delay, then by name.

        Raises:
            SemanticsError: if there are more than `max_matches`.
        """
        requested = self._pattern(concept)
        unit = self.knowledge.feature(requested.feature).unit
        found: list[Match] = []
        for carried in self.knowledge.subconcepts(requested.feature):
            if carried in self.index.features:
                exact = requested.feature in self.knowledge.subconcepts(carried)
                query = MatchQuery(concept.feature.name, requested.feature, unit, exact)
                carriers = self.index.candidates(carried, requested)
                self._add_matches(query, requested, carriers, found, max_matches)
        return in_order(found)

    def nearest(self, concept: Concept) -> str:
        """Return a sentence about the field nearest to a concept without matches."""
        pattern, name = self._pattern(concept), concept.feature.name
        faults = [
            f'; the annotation of {each.annotation.stream} is invalid: {each.fault}'
            for each in self._entries.values()
            if each.fault and name in _mentioned(each.annotation)
        ]
        if faults and not self.index.features:
            return f'no stream carries {concept}{faults[0]}'
        return ''.join([nearest(concept, pattern, self.index, self.knowledge), *faults[:1]])

    def explain(self, concept: Concept) -> tuple[Explanation, ...]:
        """Return the matches of a concept in their order, then the near misses, with reasons."""
        matches = (
            Explanation(str(each.declaration), True, each.reason) for each in self.match(concept)
        )
        misses = near_misses(self._pattern(concept), self.index, self.knowledge)
        invalid = (Explanation(text, False, fault) for text, fault in self.faults.items())
        return (*matches, *misses, *invalid)

    def _pattern(self, concept: Concept) -> Pattern:
        """Return the requested ground features."""
        check_concept(concept, self.knowledge)
        known = self.knowledge
        return pattern_of(concept.feature, concept.ranges, known, known.identities)

    def _add_matches(
        self,
        query: MatchQuery,
        requested: Pattern,
        carriers: Iterable[AnnotatedField],
        found: list[Match],
        max_matches: int,
    ) -> None:
        """Append the matches of some fields to `found`, from their caches where possible."""
        unit, has_synonyms = query.unit, self.knowledge.has_synonyms
        for carrier in carriers:
            if carrier.unit != unit and carrier.unit and not converts(carrier.unit, unit):
                continue
            if carrier.pattern.number_in_common(requested) > max(max_matches, _MAX_COMPARED):
                raise _too_many(max_matches)
            for objects in carrier.pattern.common_objects(requested):
                matches = carrier.matches.setdefault(query, {})
                names = self._names(requested, objects) if has_synonyms else objects
                if names not in matches:
                    keys = self._keys(carrier.pattern, objects)
                    matches[names] = make_match(query, names, carrier, keys)
                made = matches[names]
                if made is not None:
                    found.append(made)
                if len(found) > max_matches:
                    raise _too_many(max_matches)

    def _names(self, requested: Pattern, objects: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of some objects in the ontology of the request."""
        return tuple(
            self._object_names.name(sort, each) if sort else name
            for each, name, sort in zip(objects, requested.names, requested.sorts, strict=True)
        )

    def _keys(self, pattern: Pattern, objects: tuple[str, ...]) -> dict[str, str]:
        """Return, for each variable of a pattern, the name of its object in samples."""
        triples = zip(pattern.arguments, pattern.sorts, objects, strict=True)
        return {
            argument.removeprefix('?'): self._object_names.key(sort, each)
            for argument, sort, each in triples
            if sort
        }

    def _entry(self, annotation: Annotation, field_fault: str) -> _Entry:
        try:
            check_annotation(annotation, self.knowledge.stated)
        except LanguageError as error:
            return _Entry(annotation, (), error.reason)
        if field_fault:
            return _Entry(annotation, (), field_fault)
        carriers: list[AnnotatedField] = []
        # A bridge into a sort extends requests, not the contents of a stream.
        identities = self._object_names.identities
        for content in annotation.contents:
            pattern = pattern_of(content.feature, annotation.ranges, self.knowledge, identities)
            feature = self.knowledge.stated.feature(pattern.feature)
            unit = content.unit or feature.unit
            is_number = feature.value_type in {ValueType.INT, ValueType.FLOAT}
            carriers.append(AnnotatedField(annotation, content, pattern, unit, is_number))
        return _Entry(annotation, tuple(carriers))


def _too_many(most: int) -> SemanticsError:
    return SemanticsError(
        f'more than {most:,} streams match the concept; name some of its objects, or increase '
        'max_matches'
    )


def _mentioned(annotation: Annotation) -> dict[str, None]:
    """Return the names of features, sorts and objects in an annotation."""
    names = dict.fromkeys(each.sort for each in annotation.ranges)
    for content in annotation.contents:
        names[content.feature.name] = None
        names |= dict.fromkeys(argument.name for argument in content.feature.arguments)
    return names


class ObjectNames:
    """The names of objects as instances of a sort.

    Example: the ontology `uav` has the object `uav2` of the sort `UAV`, the ontology `robot2` has
    `self` of the sort `Drone`, and the bridges say

        robot2:Drone into uav:UAV;
        robot2:self same uav:uav2;

    The two names have one identity, here `self` (the least IRI). Requests for `UAV` use the name
    `uav2`, and samples of a stream that is annotated `for every d in Drone` use `self`:

        name('UAV', 'self') == 'uav2'
        key('Drone', 'self') == 'self'

    Args:
        knowledge: the knowledge of the ontologies with bridges.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        self._knowledge = knowledge
        self._identities: dict[str, frozenset[str]] = {}
        self._names: dict[str, Mapping[str, str]] = {}

    def identities(self, sort: str) -> frozenset[str]:
        """Return the objects of a sort in its own ontology, without bridges into the sort."""
        if sort not in self._identities:
            objects = self._knowledge.stated.instances(sort)
            self._identities[sort] = frozenset(map(self._knowledge.identity, objects))
        return self._identities[sort]

    def name(self, sort: str, identity: str) -> str:
        """Return the name that an object of a sort has in `Knowledge.instances`."""
        if not self._knowledge.has_synonyms:
            return identity
        if sort not in self._names:
            names = self._knowledge.instances(sort)
            self._names[sort] = {self._knowledge.identity(each): each for each in names}
        return self._names[sort][identity]

    def key(self, sort: str, identity: str) -> str:
        """Return the name of an object in samples: its local name in the ontology of the sort.

        Only if objects of the sort share a local name, the name has a prefix.
        """
        name = self.name(sort, identity)
        local = self._knowledge.local_name(name)
        if local == name:
            return name
        domain = self._knowledge.stated.instances(sort)
        alike = [each for each in domain if self._knowledge.local_name(each) == local]
        return name if len(alike) > 1 else local
