"""The objects of sorts over bridges between ontologies, compared with a naive reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from random import Random

import pytest
from annotated import matcher_of

from dyknow_semantics import (
    ALL_TRIPLES,
    Bridge,
    Knowledge,
    Ontology,
    Relation,
    bridged,
    parse_annotations,
    parse_bridges,
    parse_concept,
)
from dyknow_semantics.ontology.vocabulary import CLASS, SUBCLASS_OF, TYPE, UPPER_ONTOLOGY

CASES = 100
ONTOLOGIES, SORTS, FEATURES = ('o1', 'o2', 'o3'), ('A', 'B', 'C'), ('f', 'g')
OBJECTS = ('x', 'y', 'z')

TURTLE = """
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix d: <http://www.dyknow.org/ontology#> .
@prefix {name}: <http://example.org/{name}#> .
<http://example.org/{name}> a owl:Ontology ; owl:imports <http://www.dyknow.org/ontology> .
{name}:{sort} a owl:Class ; rdfs:subClassOf d:Object .
{name}:{sort}1 a {name}:{sort} , owl:NamedIndividual .
"""


def iri(name: str) -> str:
    ontology, _, local = name.partition(':')
    return f'http://www.example.org/{ontology}#{local}'


@dataclass
class World:
    """Some ontologies; names have the prefix of their ontology."""

    below: set[tuple[str, str]] = field(default_factory=set)
    types: set[tuple[str, str]] = field(default_factory=set)
    argument_sorts: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    annotated: set[tuple[str, str]] = field(default_factory=set)
    rules: list[Bridge] = field(default_factory=list)
    stated: list[Bridge] = field(default_factory=list)

    @classmethod
    def random(cls, random: Random) -> World:
        """Return ontologies that may be bridged in chains and in circles."""
        world = cls()
        for ontology in ONTOLOGIES:
            own = {
                kind: [f'{ontology}:{each}' for each in names]
                for kind, names in (('sorts', SORTS), ('features', FEATURES), ('objects', OBJECTS))
            }
            for low, high in product(own['sorts'], own['sorts']):
                if low < high and random.random() < 0.3:
                    world.below.add((low, high))
            for each in own['objects'][: random.randint(1, 3)]:
                world.types |= {
                    (each, sort) for sort in random.sample(own['sorts'], random.randint(1, 2))
                }
            for feature in own['features']:
                world.argument_sorts[feature] = random.choice(own['sorts'])
                world.units[feature] = random.choice(('m', 'ft'))
        world._bridge(random)
        return world

    def _bridge(self, random: Random) -> None:
        objects = [name for name, _ in self.types]
        for _ in range(random.randint(0, 14)):
            relation = random.choice([*Relation])
            names = sorted({*objects} if relation is Relation.SAME else {*self.sorts})
            if relation is not Relation.SAME and random.random() < 0.4:
                names = sorted(self.argument_sorts)
            bridge = Bridge(random.choice(names), relation, random.choice(names))
            random.choice((self.rules, self.stated)).append(bridge)
        for feature, sort in self.argument_sorts.items():
            for name in sorted({*objects}):
                is_own = (name, sort) in self.closed_types([])
                if is_own and random.random() < 0.7:
                    self.annotated.add((feature, name))

    @property
    def sorts(self) -> list[str]:
        return [f'{ontology}:{sort}' for ontology in ONTOLOGIES for sort in SORTS]

    @property
    def bridges(self) -> list[Bridge]:
        return [*self.rules, *self.stated]

    def triples(self) -> list[tuple[str, str, str]]:
        """Return the ontologies as the ontology manager has them."""
        found = [(iri(each), TYPE, CLASS) for each in (*self.sorts, *self.argument_sorts)]
        found += [(iri(low), SUBCLASS_OF, iri(high)) for low, high in self.below]
        found += [(iri(name), TYPE, iri(sort)) for name, sort in self.types]
        for feature, sort in self.argument_sorts.items():
            found += [
                (iri(feature), SUBCLASS_OF, f'{UPPER_ONTOLOGY}Feature'),
                (iri(feature), f'{UPPER_ONTOLOGY}value_type', 'float'),
                (iri(feature), f'{UPPER_ONTOLOGY}unit', self.units[feature]),
                (iri(feature), f'{UPPER_ONTOLOGY}argument1', iri(sort)),
            ]
        return found + [
            (iri(each.source), f'{UPPER_ONTOLOGY}{each.relation}', iri(each.target))
            for each in self.stated
        ]

    def closure(
        self, pairs: set[tuple[str, str]], *relations: Relation, bridges: list[Bridge] | None = None
    ) -> set[tuple[str, str]]:
        """Return the reflexive and transitive closure of pairs and some bridges, step by step."""
        found = set(pairs)
        for each in self.bridges if bridges is None else bridges:
            if each.relation in relations:
                found.add((each.source, each.target))
                if each.relation is not Relation.INTO:
                    found.add((each.target, each.source))
        found |= {(each, each) for pair in found for each in pair}
        while more := {(a, d) for a, b in found for c, d in found if b == c} - found:
            found |= more
        return found

    def closed_types(self, chosen: list[Bridge] | None = None) -> set[tuple[str, str]]:
        """Return each name with all its sorts, over some bridges; by default over all."""
        above = self.closure(self.below, Relation.INTO, Relation.EQUIVALENT, bridges=chosen) | {
            (each, each) for each in self.sorts
        }
        same = self.closure({(name, name) for name, _ in self.types}, Relation.SAME, bridges=chosen)
        return {
            (other, high)
            for name, sort in self.types
            for one, other in same
            for low, high in above
            if one == name and low == sort
        }

    def domain(self, sort: str) -> set[frozenset[str]]:
        """Return the objects of a sort, each as the set of its names."""
        same = self.closure({(name, name) for name, _ in self.types}, Relation.SAME)
        return {
            frozenset(other for one, other in same if one == name)
            for name, kind in self.closed_types()
            if kind == sort
        }

    def carried(self, feature: str) -> set[frozenset[str]]:
        """Return the objects for which a stream carries a feature or one below it."""
        below = self.closure(
            {(each, each) for each in self.argument_sorts}, Relation.INTO, Relation.EQUIVALENT
        )
        return {
            objects
            for objects in self.domain(self.argument_sorts[feature])
            if any((low, feature) in below and name in objects for low, name in self.annotated)
        }


def prefixed(knowledge: Knowledge, name: str) -> str:
    namespace, _, local = knowledge.instance_names.iri(name).rpartition('#')
    return f'{namespace.rpartition("/")[2]}:{local}'


@pytest.mark.parametrize('seed', range(CASES))
def test_random_ontologies_and_bridges(seed: int) -> None:
    world = World.random(Random(seed))  # noqa: S311 - for test cases
    found = bridged(world.triples(), world.rules)
    assert not found.faults
    known = found.known
    for sort in world.sorts:
        names = [prefixed(known, each) for each in known.instances(sort)]
        expected = world.domain(sort)
        assert len(names) == len(expected)
        for objects in expected:
            (name,) = objects & {*names}
            # Who asks is answered by a name of the own ontology, if there is one.
            own = {each for each in objects if (each, sort) in world.closed_types([])}
            assert name in own or not own
        # Names are qualified where two ontologies have them, and only there.
        for name, short in zip(names, known.instances(sort), strict=True):
            local = name.partition(':')[2]
            alike = {each for each, _ in world.types if each.partition(':')[2] == local}
            assert short == (name if len(alike) > 1 else local)
    _check_matches(world, known)


def _check_matches(world: World, known: Knowledge) -> None:
    """Each object of a sort finds the streams of all its names, converted, by its one name."""
    texts = (
        f'stream "{feature} of {name}" contains {feature}[{name}] = data'
        for feature, name in world.annotated
    )
    matcher = matcher_of((each for text in texts for each in parse_annotations(text)), known)
    assert not matcher.faults
    for feature, sort in world.argument_sorts.items():
        names = {
            frozenset(objects): name
            for name in known.instances(sort)
            for objects in world.domain(sort)
            if prefixed(known, name) in objects
        }
        matches = matcher.match(parse_concept(f'{feature}[u] for every u in {sort}'))
        assert {each.ground_feature for each in matches} == {
            f'{feature}[{names[objects]}]' for objects in world.carried(feature)
        }
        for each in matches:
            carried = each.specification.rpartition(' from "')[2].partition(' of ')[0]
            is_converted = 'convert' in each.specification
            assert is_converted == (world.units[carried] != world.units[feature])


def domain(ontology: Ontology, sort: str = 'UAV') -> tuple[str, ...]:
    return ontology.knowledge.instances(sort)


def test_bridges_of_an_ontology_follow_its_changes() -> None:
    rules = parse_bridges('robot2:Drone into uav:UAV; robot3:Kopter equivalent robot2:Drone')
    with Ontology(bridges=rules) as ontology:
        ontology.load_text(TURTLE.format(name='uav', sort='UAV'))
        assert (domain(ontology), len(ontology.bridge_faults)) == (('UAV1',), 2)
        ontology.load_text(TURTLE.format(name='robot2', sort='Drone'))
        assert (domain(ontology), len(ontology.bridge_faults)) == (('Drone1', 'UAV1'), 1)
        ontology.load_text(TURTLE.format(name='robot3', sort='Kopter'))
        assert (domain(ontology), ontology.bridge_faults) == (('Drone1', 'Kopter1', 'UAV1'), ())
        # A new object changes the sorts that its sort is bridged into.
        assert {'UAV', 'Drone', 'Kopter'} <= {*ontology.create_instance('k2', ['Kopter'])}
        # Other nodes, and queries, have the same bridges.
        assert bridged(ontology.triples).known.instances('UAV') == domain(ontology)
        triples = [(s, p, o) for s, p, o in ontology.query(ALL_TRIPLES)[1]]
        assert {*triples} == {*ontology.triples}
        # A bridge never protects what it names.
        for name in ('Kopter1', 'k2'):
            ontology.destroy_instance(name)
        ontology.destroy_concept('Kopter')
        assert (domain(ontology), len(ontology.bridge_faults)) == (('Drone1', 'UAV1'), 1)


def test_bridges_in_an_ontology(tmp_path: Path) -> None:
    store = tmp_path / 'ontology.sqlite3'
    with Ontology(store, parse_bridges('uav:UAV1 same robot2:Drone1')) as ontology:
        ontology.load_text(TURTLE.format(name='uav', sort='UAV'))
        ontology.load_text(
            '@prefix uav: <http://example.org/uav#> .'
            f'{TURTLE.format(name="robot2", sort="Drone")}'
            'robot2:Drone d:into uav:UAV , uav:Boat .'
        )
        assert domain(ontology) == ('UAV1',)
        assert domain(ontology, 'Drone') == ('Drone1',)
        (fault,) = ontology.bridge_faults
        assert "unknown concept 'http://example.org/uav#Boat'" in fault
    # The rules of an earlier start are forgotten, the ontologies in the store are not.
    with Ontology(store) as ontology:
        assert domain(ontology) == ('Drone1', 'UAV1')
