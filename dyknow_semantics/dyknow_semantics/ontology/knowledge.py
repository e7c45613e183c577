"""What an ontology says of objects, sorts and features.

An ontology arrives here as RDF triples, from wherever it is kept: whoever holds it reads them from
its store, others ask for them with the query `ALL_TRIPLES`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.features import FeatureSignature, SignatureReader
from dyknow_semantics.ontology.names import Names, Prefixes, split_iri
from dyknow_semantics.ontology.taxonomy import Taxonomy
from dyknow_semantics.ontology.vocabulary import (
    CLASS,
    DISJOINT_UNION_OF,
    EQUIVALENT_CLASS,
    FEATURE,
    FIRST,
    INTERSECTION_OF,
    NAMED_INDIVIDUAL,
    NIL,
    NULLARY_FEATURE,
    ONE_OF,
    PREFIX,
    REST,
    SAME_AS,
    SUBCLASS_OF,
    TYPE,
    UNION_OF,
)

Triple = tuple[str, str, str]
"""Subject, predicate and object: an IRI, the text of a literal, or a number < 0 (a blank node)."""


class Knowledge:
    """The concepts, instances and features of an ontology, and what follows from their order.

    Concepts are ordered by subclasses, equivalent classes, the parts of intersections and the
    parts of unions. That is all: for what follows from restrictions, run a reasoner where the
    ontology is written and save what it infers.

    Names are short, prefixed or full; those given back are as short as they are unambiguous, and
    sorted unless the method says otherwise.

    Args:
        triples: the whole ontology, with all that it imports.

    Raises:
        SemanticsError: if a feature is not as the upper ontology wants it.
    """

    def __init__(self, triples: Iterable[Triple]) -> None:
        statements = _Statements(triples)
        self._concepts = {
            iri for iri, kind in statements.pairs(TYPE) if kind == CLASS and _is_named(iri)
        }
        self._taxonomy = Taxonomy(statements.order())
        self._types = statements.types_of_instances(self._concepts)
        self.prefixes = Prefixes(statements.pairs(PREFIX))
        self.concept_names = Names('concept', self._concepts, self.prefixes)
        self.instance_names = Names('instance', self._types, self.prefixes)
        self._identities = self._unite(Taxonomy(statements.same()))
        reader = SignatureReader(self._taxonomy, statements.of, self.concept_names)
        below = self._taxonomy.below(FEATURE) & self._concepts
        self._features = reader.read(below - {FEATURE, NULLARY_FEATURE})
        self._instances = self._instances_of_concepts()
        self._subconcepts: dict[str, tuple[str, ...]] = {}
        self._superconcepts: dict[str, tuple[str, ...]] = {}
        self._identities_of: dict[str, frozenset[str]] = {}

    @property
    def features(self) -> tuple[FeatureSignature, ...]:
        """All features."""
        return tuple(sorted(self._features.values(), key=lambda feature: feature.name))

    @property
    def sorts(self) -> tuple[str, ...]:
        """All concepts that are no features."""
        return self._named(frozenset(self._concepts) - self._taxonomy.below(FEATURE))

    def feature(self, name: str) -> FeatureSignature:
        """The feature of a name.

        Raises:
            SemanticsError: if no feature bears the name.
        """
        iri = self.concept_names.iri(name)
        if iri not in self._features:
            raise SemanticsError(
                f"the concept '{name}' is no feature; the features lie below Feature",
                ExitCode.NOT_FOUND,
            )
        return self._features[iri]

    def is_feature(self, concept: str) -> bool:
        """Whether a concept is a feature.

        Raises:
            SemanticsError: if there is no such concept.
        """
        return self.concept_names.iri(concept) in self._features

    def subconcepts(self, concept: str) -> tuple[str, ...]:
        """A concept, those equivalent to it, and all below it.

        Raises:
            SemanticsError: if there is no such concept.
        """
        iri = self.concept_names.iri(concept)
        if iri not in self._subconcepts:
            self._subconcepts[iri] = self._named(self._taxonomy.below(iri))
        return self._subconcepts[iri]

    def superconcepts(self, concept: str) -> tuple[str, ...]:
        """A concept, those equivalent to it, and all above it.

        Raises:
            SemanticsError: if there is no such concept.
        """
        iri = self.concept_names.iri(concept)
        if iri not in self._superconcepts:
            self._superconcepts[iri] = self._named(self._taxonomy.above(iri))
        return self._superconcepts[iri]

    def instances(self, concept: str) -> tuple[str, ...]:
        """The instances of a concept and of all concepts below it.

        Raises:
            SemanticsError: if there is no such concept.
        """
        return self._instances.get(self.concept_names.iri(concept), ())

    def concepts(self, instance: str) -> tuple[str, ...]:
        """The concepts of an instance, each before all that lie above it, else by name.

        Raises:
            SemanticsError: if there is no such instance.
        """
        found = self._concepts_of(self.instance_names.iri(instance))
        return tuple(map(self.concept_names.name, self._taxonomy.specific_first(found)))

    def instance(self, name: str) -> str:
        """The shortest name of an instance.

        Raises:
            SemanticsError: if there is no such instance.
        """
        return self.instance_names.name(self.instance_names.iri(name))

    def meaning(self, name: str) -> tuple[object, ...]:
        """What follows from a name: the same as long as nothing that bears on it has changed."""
        found: list[object] = []
        for names, meanings in (
            (self.concept_names, (self.feature,)),
            (self.concept_names, (self.superconcepts, self.instances, self.identities)),
            (self.instance_names, (self.instance, self.concepts)),
        ):
            if name not in names:
                found.append(None)
                continue
            try:
                found += [meaning(name) for meaning in meanings]
            except SemanticsError as error:
                found.append(error.code)
        return (*found, self.identity(name))

    @property
    def has_synonyms(self) -> bool:
        """Whether some instance has several names, which owl:sameAs states."""
        return bool(self._identities)

    def identity(self, instance: str) -> str:
        """The one of the shortest names of an instance that stands for it, where it has several."""
        return self._identities.get(instance, instance)

    def identities(self, concept: str) -> frozenset[str]:
        """The instances of a concept, each by the one name that stands for it.

        Raises:
            SemanticsError: if there is no such concept.
        """
        iri = self.concept_names.iri(concept)
        if iri not in self._identities_of:
            self._identities_of[iri] = frozenset(map(self.identity, self.instances(concept)))
        return self._identities_of[iri]

    def local_name(self, instance: str) -> str:
        """The name of an instance without any prefix.

        Raises:
            SemanticsError: if there is no such instance.
        """
        return split_iri(self.instance_names.iri(instance))[1]

    def name(self, iri: str) -> str:
        """The shortest name of a concept or an instance; the IRI of anything else."""
        for things, names in (
            (self._concepts, self.concept_names),
            (self._types, self.instance_names),
        ):
            if iri in things:
                return names.name(iri)
        return iri

    def _unite(self, same: Taxonomy) -> dict[str, str]:
        """Gives all names of an instance the same types; the name that stands for each name."""
        identities: dict[str, str] = {}
        for iri in list(self._types):
            names = same.above(iri) & self._types.keys()
            if len(names) > 1:
                self._types[iri] = set().union(*(self._types[each] for each in names))
                identities[self.instance_names.name(iri)] = self.instance_names.name(min(names))
        return identities

    def _concepts_of(self, instance: str) -> set[str]:
        above = (self._taxonomy.above(kind) for kind in self._types[instance])
        return self._concepts & set().union(*above)

    def _instances_of_concepts(self) -> dict[str, tuple[str, ...]]:
        found: dict[str, list[str]] = defaultdict(list)
        for iri in self._types:
            for concept in self._concepts_of(iri):
                found[concept].append(self.instance_names.name(iri))
        return {concept: tuple(sorted(names)) for concept, names in found.items()}

    def _named(self, concepts: frozenset[str]) -> tuple[str, ...]:
        return tuple(sorted(map(self.concept_names.name, concepts & self._concepts)))


class _Statements:
    """Triples, indexed by subject and by predicate."""

    def __init__(self, triples: Iterable[Triple]) -> None:
        self.of: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        self._pairs: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for subject, predicate, value in triples:
            self.of[subject][predicate].append(value)
            self._pairs[predicate].append((subject, value))

    def pairs(self, predicate: str) -> list[tuple[str, str]]:
        """The subjects and objects of a predicate."""
        return self._pairs.get(predicate, [])

    def order(self) -> Iterator[tuple[str, str]]:
        """Each class, named or not, with those stated to lie above it."""
        yield from self.pairs(SUBCLASS_OF)
        for one, other in self.pairs(EQUIVALENT_CLASS):
            yield one, other
            yield other, one
        for whole, part in self._parts(INTERSECTION_OF):
            yield whole, part
        for predicate in (UNION_OF, DISJOINT_UNION_OF):
            for whole, part in self._parts(predicate):
                yield part, whole

    def same(self) -> Iterator[tuple[str, str]]:
        """The individuals that are stated to be the same, in both directions."""
        for one, other in self.pairs(SAME_AS):
            yield one, other
            yield other, one

    def types_of_instances(self, concepts: set[str]) -> dict[str, set[str]]:
        """Each instance with the classes, named or not, that it is stated to belong to."""
        types: dict[str, set[str]] = defaultdict(set)
        for subject, kind in self.pairs(TYPE):
            is_class = kind in concepts or kind == NAMED_INDIVIDUAL or not _is_named(kind)
            if is_class and _is_named(subject):
                types[subject].add(kind)
        for enumeration, member in self._parts(ONE_OF):
            # What is enumerated may also be a value: only instances are known already.
            if member in types:
                types[member].add(enumeration)
        return dict(types)

    def _parts(self, predicate: str) -> Iterator[tuple[str, str]]:
        for whole, parts in self.pairs(predicate):
            seen: set[str] = set()
            while parts in self.of and parts not in seen:
                seen.add(parts)
                for part in self.of[parts].get(FIRST, []):
                    yield whole, part
                parts = next(iter(self.of[parts].get(REST, [])), NIL)  # noqa: PLW2901


def _is_named(node: str) -> bool:
    return not node.startswith('-')
