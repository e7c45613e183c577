"""The concepts, instances and features of an ontology, derived from its RDF triples.

Example, with shortened IRIs. The first two triples declare concepts, the third orders them:

    ('#UAV', 'rdf:type', 'owl:Class')
    ('#Vehicle', 'rdf:type', 'owl:Class')
    ('#UAV', 'rdfs:subClassOf', '#Vehicle')
    ('#uav1', 'rdf:type', '#UAV')

Then `subconcepts('Vehicle') == ('UAV', 'Vehicle')` and `instances('Vehicle') == ('uav1',)`.

The ontology manager reads the triples from its store; other nodes get them by `ALL_TRIPLES`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from functools import cache, partial
from typing import Final

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology import vocabulary
from dyknow_semantics.ontology.features import FeatureSignature, SignatureReader
from dyknow_semantics.ontology.names import Names, Prefixes, split_iri
from dyknow_semantics.ontology.taxonomy import Taxonomy

Triple = tuple[str, str, str]
"""Subject, predicate and object: an IRI, the text of a literal, or a number < 0 (a blank node)."""

ALL_TRIPLES: Final = """
    SELECT (COALESCE(STR(?s), STORID(?s)) AS ?subject)
           (STR(?p) AS ?predicate)
           (COALESCE(STR(?o), STORID(?o)) AS ?object)
    WHERE { ?s ?p ?o . }
"""
"""The SPARQL query, in the dialect of owlready2, whose solutions are all triples."""

TRIPLE_VARIABLES: Final = ('subject', 'predicate', 'object')
"""The variables of this query."""


class Knowledge:
    """The concepts, instances and features of an ontology.

    Concepts are ordered by subclasses, equivalent classes, and the parts of intersections and
    unions. Consequences of restrictions are known only if a reasoner has added them to the triples.
    Each sort lies below `Object`, also if it is not stated.

    Methods accept short names, prefixed names and IRIs. They return the shortest unambiguous names,
    sorted unless stated otherwise, and raise SemanticsError (NOT_FOUND if the name is unknown,
    INVALID_ARGUMENT if it is ambiguous).

    Args:
        triples: the whole ontology with its imports.
        stated: the same without the consequences of bridges; `None` if there are no bridges.

    Raises:
        SemanticsError: if the signature of a feature is incomplete or contradictory.
    """

    def __init__(self, triples: Iterable[Triple], stated: Knowledge | None = None) -> None:
        self.stated = stated or self
        index = _TripleIndex(triples)
        self._concepts = {
            iri
            for iri, kind in index.by_predicate[vocabulary.TYPE]
            if kind == vocabulary.CLASS and _is_named(iri)
        }
        self._taxonomy = self._with_sorts_below_object(list(index.order()))
        self._types = index.types_of_instances(self._concepts)
        self.prefixes = Prefixes(index.by_predicate[vocabulary.PREFIX])
        self.concept_names = Names('concept', self._concepts, self.prefixes)
        self._names_of = cache(partial(_sorted_names, self.concept_names, self._concepts))
        self.instance_names = Names('instance', self._types, self.prefixes)
        self._identities = self._unify(Taxonomy(index.symmetric(vocabulary.SAME_AS)))
        reader = SignatureReader(self._taxonomy, index.by_subject, self.concept_names)
        below = self._taxonomy.below(vocabulary.FEATURE) & self._concepts
        own = below - {vocabulary.FEATURE, vocabulary.NULLARY_FEATURE}
        # A bridge does not change what a feature inherits.
        known = stated._features if stated else {}  # noqa: SLF001 - of the same class
        self._features: Mapping[str, FeatureSignature] = reader.read(own, known)
        self._instances = self._instances_of_concepts()
        self._identities_of: dict[str, frozenset[str]] = {}

    @property
    def features(self) -> tuple[FeatureSignature, ...]:
        """All features, by name."""
        return tuple(sorted(self._features.values(), key=lambda feature: feature.name))

    @property
    def sorts(self) -> tuple[str, ...]:
        """All concepts that are not features."""
        return self._names_of(frozenset(self._concepts) - self._taxonomy.below(vocabulary.FEATURE))

    @property
    def counts(self) -> dict[str, int]:
        """The numbers of concepts, features and objects outside the upper ontology."""
        concepts = {iri for iri in self._concepts if not iri.startswith(vocabulary.UPPER_ONTOLOGY)}
        return {
            'concepts': len(concepts),
            'features': len(concepts & self._features.keys()),
            'objects': len(self._types),
        }

    def feature(self, name: str) -> FeatureSignature:
        """Return a feature.

        Raises:
            SemanticsError: NOT_FOUND also for a concept that is not a feature.
        """
        iri = self.concept_names.iri(name)
        if iri not in self._features:
            raise SemanticsError(
                f"the concept '{name}' is not a feature; the features lie below Feature",
                ExitCode.NOT_FOUND,
            )
        return self._features[iri]

    def is_feature(self, concept: str) -> bool:
        """Return True if a concept is a feature."""
        return self.concept_names.iri(concept) in self._features

    def subconcepts(self, concept: str) -> tuple[str, ...]:
        """Return a concept, its equivalent concepts, and all below it."""
        return self._names_of(self._taxonomy.below(self.concept_names.iri(concept)))

    def superconcepts(self, concept: str) -> tuple[str, ...]:
        """Return a concept, its equivalent concepts, and all above it."""
        return self._names_of(self._taxonomy.above(self.concept_names.iri(concept)))

    def instances(self, concept: str) -> tuple[str, ...]:
        """Return the instances of a concept and of all concepts below it, each once.

        If an instance has several names, a name stated for the concept itself is returned.
        """
        return self._instances.get(self.concept_names.iri(concept), ())

    def concepts(self, instance: str) -> tuple[str, ...]:
        """Return the concepts of an instance, each before all that lie above it, else by name."""
        found = self._concepts_of(self.instance_names.iri(instance))
        return tuple(map(self.concept_names.name, self._taxonomy.specific_first(found)))

    def instance(self, name: str) -> str:
        """Return the shortest name of an instance."""
        return self.instance_names.name(self.instance_names.iri(name))

    def meaning(self, name: str) -> tuple[object, ...]:
        """Return all facts about a name; two ontologies with equal facts agree about it."""
        found: list[object] = []
        for names, queries in (
            (self.concept_names, (self.feature,)),
            (self.concept_names, (self.superconcepts, self.instances, self.identities)),
            (self.instance_names, (self.instance, self.concepts)),
        ):
            if name not in names:
                found.append(None)
                continue
            try:
                found += [query(name) for query in queries]
            except SemanticsError as error:
                found.append(error.code)
        return (*found, self.identity(name))

    @property
    def has_synonyms(self) -> bool:
        """True if owl:sameAs gives an instance several names."""
        return bool(self._identities)

    def identity(self, instance: str) -> str:
        """Return the representative of the synonyms of an instance, given by its shortest name."""
        return self._identities.get(instance, instance)

    def identities(self, concept: str) -> frozenset[str]:
        """Return the instances of a concept, each by its representative name."""
        iri = self.concept_names.iri(concept)
        if iri not in self._identities_of:
            self._identities_of[iri] = frozenset(map(self.identity, self.instances(concept)))
        return self._identities_of[iri]

    def local_name(self, instance: str) -> str:
        """Return the name of an instance without any prefix."""
        return split_iri(self.instance_names.iri(instance))[1]

    def name(self, iri: str) -> str:
        """Return the shortest name of a concept or an instance; the IRI of anything else."""
        if iri in self._concepts:
            return self.concept_names.name(iri)
        return self.instance_names.name(iri) if iri in self._types else iri

    def _with_sorts_below_object(self, order: list[tuple[str, str]]) -> Taxonomy:
        """Return the order of concepts; each concept that is not a feature is a sort in it."""
        taxonomy = Taxonomy(order)
        others = {vocabulary.THING, vocabulary.NOTHING, *taxonomy.above(vocabulary.OBJECT)}
        others |= taxonomy.below(vocabulary.FEATURE) | taxonomy.above(vocabulary.FEATURE)
        sorts = sorted(self._concepts - others - taxonomy.below(vocabulary.OBJECT))
        return Taxonomy([*order, *((sort, vocabulary.OBJECT) for sort in sorts)])

    def _unify(self, same: Taxonomy) -> dict[str, str]:
        """Give synonyms the same types. Return the representative of each synonym."""
        identities: dict[str, str] = {}
        for iri in list(self._types):
            synonyms = same.above(iri) & self._types.keys()
            if len(synonyms) > 1:
                self._types[iri] = set().union(*(self._types[each] for each in synonyms))
                identities[self.instance_names.name(iri)] = self.instance_names.name(min(synonyms))
        return identities

    def _concepts_of(self, instance: str) -> set[str]:
        above = (self._taxonomy.above(kind) for kind in self._types[instance])
        return self._concepts & set().union(*above)

    def _instances_of_concepts(self) -> dict[str, tuple[str, ...]]:
        found: dict[str, list[str]] = defaultdict(list)
        for iri in self._types:
            for concept in self._concepts_of(iri):
                found[concept].append(self.instance_names.name(iri))
        return {concept: self._each_once(concept, names) for concept, names in found.items()}

    def _each_once(self, concept: str, names: list[str]) -> tuple[str, ...]:
        """Return one name of each of some instances of a concept, sorted."""
        if not self.has_synonyms:
            return tuple(sorted(names))
        stated = frozenset() if self.stated is self else {*self.stated.instances(concept)}
        chosen: dict[str, str] = {}

        def preference(name: str) -> tuple[bool, bool, str]:
            return name not in stated, name != self.identity(name), name

        for name in sorted(names, key=preference):
            chosen.setdefault(self.identity(name), name)
        return tuple(sorted(chosen.values()))


class _TripleIndex:
    """Triples by subject, and pairs of subject and object by predicate."""

    def __init__(self, triples: Iterable[Triple]) -> None:
        self.by_subject: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
        self.by_predicate: dict[str, list[tuple[str, str]]] = defaultdict(list)
        for subject, predicate, value in triples:
            self.by_subject[subject][predicate].append(value)
            self.by_predicate[predicate].append((subject, value))

    def symmetric(self, predicate: str) -> Iterator[tuple[str, str]]:
        """Yield the subjects and objects of a predicate in both directions."""
        for subject, value in self.by_predicate[predicate]:
            yield subject, value
            yield value, subject

    def order(self) -> Iterator[tuple[str, str]]:
        """Yield each class, named or not, with each class that is stated to lie above it."""
        yield from self.by_predicate[vocabulary.SUBCLASS_OF]
        yield from self.symmetric(vocabulary.EQUIVALENT_CLASS)
        yield from self._parts(vocabulary.INTERSECTION_OF)
        for predicate in (vocabulary.UNION_OF, vocabulary.DISJOINT_UNION_OF):
            for whole, part in self._parts(predicate):
                yield part, whole

    def types_of_instances(self, concepts: set[str]) -> dict[str, set[str]]:
        """Return the stated classes, named or not, of each instance."""
        types: dict[str, set[str]] = defaultdict(set)
        for subject, kind in self.by_predicate[vocabulary.TYPE]:
            if _is_named(subject) and (
                kind in concepts or kind == vocabulary.NAMED_INDIVIDUAL or not _is_named(kind)
            ):
                types[subject].add(kind)
        for enumeration, member in self._parts(vocabulary.ONE_OF):
            # Enumerations of values have members too, but these members are not instances.
            if member in types:
                types[member].add(enumeration)
        return dict(types)

    def _parts(self, predicate: str) -> Iterator[tuple[str, str]]:
        """Yield the subjects of a predicate with each element of their RDF lists."""
        for whole, first in self.by_predicate[predicate]:
            seen: set[str] = set()
            cell = first
            while cell in self.by_subject and cell not in seen:
                seen.add(cell)
                for part in self.by_subject[cell].get(vocabulary.FIRST, []):
                    yield whole, part
                cell = next(iter(self.by_subject[cell].get(vocabulary.REST, [])), vocabulary.NIL)


def _sorted_names(names: Names, known: set[str], concepts: frozenset[str]) -> tuple[str, ...]:
    return tuple(sorted(map(names.name, concepts & known)))


def _is_named(node: str) -> bool:
    return not node.startswith('-')
