"""The ontology: loading, changes, rollback, queries, storage."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import owlready2
import pytest

from dyknow_common import ExitCode, ValueType
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics import ALL_TRIPLES, FeatureSignature, Knowledge, Ontology, SemanticsError
from dyknow_semantics.ontology.queries import answer_query
from dyknow_semantics.ontology.store import Store
from dyknow_semantics.workers import Work

pytestmark = pytest.mark.long

RDF_TYPE = '<http://www.w3.org/1999/02/22-rdf-syntax-ns#type>'
RDFS_SUBCLASS = '<http://www.w3.org/2000/01/rdf-schema#subClassOf>'
OWL = 'http://www.w3.org/2002/07/owl#'


def ontology_text(name: str, *imports: str) -> str:
    """An N-Triples ontology with one class `Thing_NAME`."""
    iri = f'<http://www.example.org/{name}>'
    lines = [f'{iri} {RDF_TYPE} <{OWL}Ontology> .']
    lines += [f'{iri} <{OWL}imports> <http://www.example.org/{each}> .' for each in imports]
    lines += [f'<http://www.example.org/{name}#Thing_{name}> {RDF_TYPE} <{OWL}Class> .']
    return '\n'.join(lines) + '\n'


def snapshot(ontology: Ontology) -> set[tuple[str, ...]]:
    """Return all triples of an ontology."""
    return set(ontology.query(ALL_TRIPLES)[1])


def test_the_upper_ontology_is_there_from_the_start() -> None:
    with Ontology() as ontology:
        assert ontology.knowledge.subconcepts('Feature') == ('Feature', 'NullaryFeature')
        assert ontology.knowledge.subconcepts('Object') == ('Object',)
        assert ontology.knowledge.superconcepts('ontology:Object') == ('Object',)


def test_hierarchy_as_protege_writes_it(fleet: Ontology) -> None:
    assert fleet.knowledge.subconcepts('UAV') == ('Drone', 'Observer', 'UAV')
    assert fleet.knowledge.subconcepts('Machine') == (
        'Camera', 'Drone', 'Machine', 'Observer', 'UAV', 'UGV', 'Vehicle',
    )  # fmt: skip
    assert fleet.knowledge.superconcepts('Observer') == (
        'Drone', 'Machine', 'Object', 'Observer', 'UAV', 'Vehicle',
    )  # fmt: skip


def test_instances_are_those_of_subconcepts_too(fleet: Ontology) -> None:
    assert fleet.knowledge.instances('UAV') == ('uav1', 'uav2')
    assert fleet.knowledge.instances('vehicles:Drone') == ('uav1', 'uav2')
    assert fleet.knowledge.instances('Vehicle') == ('rover', 'uav1', 'uav2')
    assert fleet.knowledge.instances('http://www.example.org/vehicles#Observer') == ('uav2',)
    assert fleet.knowledge.instances('Feature') == ()


def test_concepts_of_an_instance_begin_with_the_most_specific(fleet: Ontology) -> None:
    assert fleet.knowledge.concepts('uav2') == (
        'Observer',
        'Drone',
        'UAV',
        'Vehicle',
        'Machine',
        'Object',
    )


def test_features(fleet: Ontology) -> None:
    assert fleet.knowledge.feature('XYDist') == FeatureSignature(
        'XYDist', ('UAV', 'Vehicle'), ValueType.FLOAT, 'm'
    )
    assert fleet.knowledge.feature('Daylight') == FeatureSignature(
        'Daylight', (), ValueType.BOOLEAN, ''
    )
    for name in ('BarometricAltitude', 'Height'):
        assert fleet.knowledge.feature(name) == FeatureSignature(
            name, ('Vehicle',), ValueType.FLOAT, 'm'
        )


def test_a_sort_is_no_feature(fleet: Ontology) -> None:
    with pytest.raises(SemanticsError, match="the concept 'UAV' is not a feature") as error:
        fleet.knowledge.feature('UAV')
    assert error.value.code is ExitCode.NOT_FOUND


@pytest.mark.parametrize('form', ['rdfxml', 'ntriples'])
def test_serialisations_of_owl_are_equivalent(
    fleet: Ontology, ontologies: Path, tmp_path: Path, form: str
) -> None:
    world = owlready2.World()
    loaded = world.get_ontology('http://www.example.org/vehicles')
    with (ontologies / 'vehicles.owl').open('rb') as file:
        loaded.graph.parse(file)
    loaded.save(str(tmp_path / 'again.owl'), format=form)
    world.close()
    with Ontology() as ontology:
        ontology.load(tmp_path / 'again.owl')
        assert ontology.knowledge.features == fleet.knowledge.features
        assert ontology.knowledge.subconcepts('Machine') == fleet.knowledge.subconcepts('Machine')


def test_loading_an_ontology_again_replaces_it_only(fleet: Ontology, ontologies: Path) -> None:
    before = snapshot(fleet)
    fleet.load(ontologies / 'fleet.owl')
    assert {row for row in snapshot(fleet) if not row[0].startswith('-')} == {
        row for row in before if not row[0].startswith('-')
    }
    fleet.create_instance('uav3', ['UAV'])
    fleet.load(ontologies / 'vehicles.owl')
    fleet.load(ontologies / 'fleet.owl')
    assert fleet.knowledge.instances('UAV') == ('uav1', 'uav2', 'uav3')


def test_a_reloaded_ontology_drops_removed_statements(tmp_path: Path) -> None:
    file = tmp_path / 'a.nt'
    with Ontology() as ontology:
        file.write_text(ontology_text('a'))
        ontology.load(file)
        ontology.create_instance('x', ['Thing_a'])
        ontology.destroy_instance('x')
        file.write_text(ontology_text('a').replace('Thing_a', 'Other'))
        ontology.load(file)
        assert 'Thing_a' not in ontology.knowledge.concept_names
        ontology.create_concept('a:Thing_a', ['Other'])
        ontology.create_instance('x', ['Thing_a'])
        assert ontology.knowledge.concepts('x') == ('Thing_a', 'Other', 'Object')


def test_imports_may_be_circular(tmp_path: Path) -> None:
    for name, imported in (('a', 'b'), ('b', 'c'), ('c', 'a')):
        (tmp_path / f'{name}.nt').write_text(ontology_text(name, imported))
    with Ontology() as ontology:
        ontology.load(tmp_path / 'a.nt')
        for name in 'abc':
            assert ontology.knowledge.subconcepts(f'Thing_{name}') == (f'Thing_{name}',)


def test_an_import_that_is_loaded_already_is_not_read(tmp_path: Path) -> None:
    (tmp_path / 'elsewhere').mkdir()
    (tmp_path / 'elsewhere' / 'b.nt').write_text(ontology_text('b'))
    (tmp_path / 'a.nt').write_text(ontology_text('a', 'b'))
    with Ontology() as ontology:
        ontology.load(tmp_path / 'elsewhere' / 'b.nt')
        ontology.load((tmp_path / 'a.nt').as_uri())
        assert ontology.knowledge.subconcepts('Thing_a') == ('Thing_a',)


def test_an_import_that_is_another_ontology(tmp_path: Path) -> None:
    (tmp_path / 'a.nt').write_text(ontology_text('a', 'b'))
    (tmp_path / 'b.nt').write_text(ontology_text('c'))
    with Ontology() as ontology:
        before = snapshot(ontology)
        with pytest.raises(SemanticsError) as error:
            ontology.load(tmp_path / 'a.nt')
        assert error.value.message == (
            f'{tmp_path / "b.nt"} holds the ontology <http://www.example.org/c#> '
            'instead of <http://www.example.org/b>'
        )
        assert snapshot(ontology) == before


def test_a_malformed_ontology_is_not_loaded_at_all(tmp_path: Path) -> None:
    (tmp_path / 'b.nt').write_text(ontology_text('b'))
    (tmp_path / 'a.nt').write_text(
        ontology_text('a', 'b')
        + f'<http://www.example.org/a#Thing_a> {RDFS_SUBCLASS} '
        + '<http://www.dyknow.org/ontology#Feature> .\n'
    )
    with Ontology() as ontology:
        ontology.create_concept('Vehicle', ['Object'])
        before = snapshot(ontology)
        with pytest.raises(SemanticsError, match="feature 'Thing_a' has no argument sorts"):
            ontology.load(tmp_path / 'a.nt')
        assert snapshot(ontology) == before
        ontology.load(tmp_path / 'b.nt')
        assert ontology.knowledge.subconcepts('Thing_b') == ('Thing_b',)


@pytest.mark.parametrize(
    'text',
    ['not an ontology', '<rdf:RDF', '<a></b>', '', '<html/>', '<http://a> a ' + '[ a ' * 5000],
)
def test_a_file_without_an_ontology(
    tmp_path: Path, text: str, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'a.owl'
    file.write_text(text)
    with Ontology() as ontology:
        before = snapshot(ontology)
        with pytest.raises(SemanticsError, match=re.escape(str(file))):
            ontology.load(file)
        assert snapshot(ontology) == before
    assert capfd.readouterr() == ('', '')


def test_a_missing_file() -> None:
    with Ontology() as ontology, pytest.raises(SemanticsError) as error:
        ontology.load('/no/such.owl')
    assert error.value.code is ExitCode.NOT_FOUND
    assert error.value.message == (
        "cannot read the ontology '/no/such.owl': No such file or directory"
    )


def test_names_of_created_entities(fleet: Ontology) -> None:
    fleet.create_concept('Glider', ['UAV'])
    fleet.create_concept('vehicles:Balloon', ['Glider', 'Observer'])
    fleet.create_instance('http://www.example.org/other#uav3', ['Balloon', 'Camera'])
    assert fleet.knowledge.concept_names.iri('Glider') == 'http://www.dyknow.org/runtime#Glider'
    assert fleet.knowledge.concept_names.iri('Balloon').startswith('http://www.example.org/vehi')
    assert fleet.knowledge.instances('Glider') == ('uav3',)
    assert fleet.knowledge.instances('Camera') == ('eye', 'uav3')


def test_features_may_be_created_below_others(fleet: Ontology) -> None:
    fleet.create_concept('LaserAltitude', ['Altitude'])
    assert fleet.knowledge.feature('LaserAltitude') == FeatureSignature(
        'LaserAltitude', ('Vehicle',), ValueType.FLOAT, 'm'
    )


@pytest.mark.parametrize(
    ('change', 'code', 'message'),
    [
        (lambda o: o.create_concept('UAV'), ExitCode.ALREADY_EXISTS, "'UAV' already exists"),
        (
            lambda o: o.create_instance('UAV', ['UAV']),
            ExitCode.ALREADY_EXISTS,
            "'UAV' already exists",
        ),
        (
            lambda o: o.create_concept('A', ['Vehicel']),
            ExitCode.NOT_FOUND,
            "unknown concept 'Vehicel'; did you mean 'Vehicle'?",
        ),
        (
            lambda o: o.create_concept('vehicle:A', ['UAV']),
            ExitCode.NOT_FOUND,
            "no ontology with the prefix 'vehicle' is loaded; did you mean 'vehicles'?",
        ),
        (
            lambda o: o.create_concept('2D', ['UAV']),
            ExitCode.INVALID_ARGUMENT,
            (
                "'2D' is not a valid name; it must begin with an ASCII letter or _, "
                'followed by ASCII letters, digits, _ . or -'
            ),
        ),
        (
            lambda o: o.create_instance('x', []),
            ExitCode.INVALID_ARGUMENT,
            "the instance 'x' needs a concept to be an instance of",
        ),
        (
            lambda o: o.create_instance('x', ['UAV', 'Power']),
            ExitCode.INVALID_ARGUMENT,
            "the concept 'Power' is a feature; features have no instances",
        ),
        (
            lambda o: o.create_concept('Weight', ['Feature']),
            ExitCode.INVALID_ARGUMENT,
            (
                "feature 'Weight' has no argument sorts; give it argument1, argument2, "
                '..., or place it below NullaryFeature'
            ),
        ),
        (
            lambda o: o.destroy_concept('UAV'),
            ExitCode.INVALID_ARGUMENT,
            (
                "the concept 'UAV' cannot be destroyed: it has the subconcepts Drone, Observer; "
                'it has the instances uav1, uav2; it is an argument of the features XYDist'
            ),
        ),
        (
            lambda o: o.destroy_concept('NullaryFeature'),
            ExitCode.INVALID_ARGUMENT,
            (
                "the concept 'NullaryFeature' cannot be destroyed: it belongs to the upper "
                'ontology; it has the subconcepts Daylight'
            ),
        ),
        (
            lambda o: o.destroy_instance('uav9'),
            ExitCode.NOT_FOUND,
            "unknown instance 'uav9'; did you mean 'uav2' or 'uav1'?",
        ),
    ],
)
def test_refused_changes_change_nothing(
    fleet: Ontology, change: Callable[[Ontology], None], code: ExitCode, message: str
) -> None:
    before = snapshot(fleet)
    with pytest.raises(SemanticsError) as error:
        change(fleet)
    assert (error.value.code, error.value.message) == (code, message)
    assert snapshot(fleet) == before


def test_destroyed_entities_leave_no_statements(fleet: Ontology) -> None:
    before = snapshot(fleet)
    fleet.create_concept('Glider', ['UAV'])
    fleet.create_instance('uav3', ['Glider'])
    fleet.destroy_instance('uav3')
    assert fleet.knowledge.instances('Glider') == ()
    fleet.destroy_concept('Glider')
    assert 'Glider' not in fleet.knowledge.concept_names
    gone = {row for row in snapshot(fleet) - before if 'Glider' in str(row) or 'uav3' in str(row)}
    assert not gone


def test_an_entity_that_is_both_a_concept_and_an_instance(tmp_path: Path) -> None:
    file = tmp_path / 'a.nt'
    thing = '<http://www.example.org/a#Thing_a>'
    file.write_text(ontology_text('a') + f'{thing} {RDF_TYPE} <{OWL}NamedIndividual> .\n')
    with Ontology() as ontology:
        ontology.load(file)
        with pytest.raises(SemanticsError, match="the instance 'Thing_a' is a concept too"):
            ontology.destroy_instance('Thing_a')
        ontology.destroy_concept('Thing_a')
        assert 'Thing_a' not in ontology.knowledge.instance_names


def test_a_query_returns_names(fleet: Ontology) -> None:
    variables, rows = fleet.query(
        'PREFIX v: <http://www.example.org/vehicles#> '
        'SELECT ?who ?kind ?p WHERE { ?who ?p ?kind . ?kind rdfs:subClassOf v:Vehicle . '
        '?who rdf:type ?kind . }'
    )
    assert variables == ('who', 'kind', 'p')
    assert set(rows) == {
        ('uav1', 'UAV', 'http://www.w3.org/1999/02/22-rdf-syntax-ns#type'),
        ('rover', 'UGV', 'http://www.w3.org/1999/02/22-rdf-syntax-ns#type'),
    }


def test_a_query_returns_texts_of_values_and_nothing_for_unbound_variables(fleet: Ontology) -> None:
    _, rows = fleet.query(
        'PREFIX d: <http://www.dyknow.org/ontology#> '
        'SELECT ?feature ?unit (1 + 1 AS ?two) WHERE { ?feature d:value_type ?type . '
        'OPTIONAL { ?feature d:unit ?unit . } }'
    )
    assert {('Power', 'W', '2'), ('Daylight', '', '2')} <= set(rows)


@pytest.mark.parametrize(
    ('query', 'message'),
    [
        ('SELECT', 'the SPARQL query cannot be answered: '),
        ('nonsense', 'the SPARQL query cannot be answered: '),
        ('SELECT ?x { ?x a <http://no.org#X> }', 'the SPARQL query cannot be answered: '),
        ('SELECT ?x { ?x a no:X }', 'the SPARQL query cannot be answered: '),
        ('DELETE { ?x a owl:Class } WHERE { ?x a owl:Class }', 'only SELECT queries are answered'),
    ],
)
def test_queries_that_are_not_answered(fleet: Ontology, query: str, message: str) -> None:
    before = snapshot(fleet)
    with pytest.raises(SemanticsError, match=message):
        fleet.query(query)
    assert snapshot(fleet) == before


@pytest.mark.parametrize('answer', ['?x', '(COUNT(?x) AS ?number)'])
def test_a_query_that_does_not_end(tmp_path: Path, answer: str) -> None:
    file = tmp_path / 'a.nt'
    thing, other = '<http://www.example.org/a#Thing_a>', '<http://www.example.org/a#Other>'
    file.write_text(
        ontology_text('a')
        + f'{other} {RDF_TYPE} <{OWL}Class> .\n'
        + f'{other} {RDFS_SUBCLASS} {thing} .\n{thing} {RDFS_SUBCLASS} {other} .\n'
    )
    with Ontology() as ontology:
        ontology.load(file)
        assert ontology.knowledge.superconcepts('Other') == ('Object', 'Other', 'Thing_a')
        sparql = f'SELECT {answer} {{ ?x rdfs:subClassOf+ {thing} }}'
        with (
            WorkerPool(1, memory=2**29) as workers,
            pytest.raises(SemanticsError, match=r'the query (has more|did not finish)'),
        ):
            Work(
                answer_query, (ontology.write_copy(), sparql, 10**7), 'the query', 1.0, 'ask less'
            ).run(workers)
        assert ontology.query(f'SELECT ?x {{ ?x a owl:Class . FILTER(?x = {thing}) }}')[1] == (
            ('Thing_a',),
        )


def test_a_query_returns_all_knowledge(fleet: Ontology) -> None:
    triples = [
        (subject, predicate, value) for subject, predicate, value in fleet.query(ALL_TRIPLES)[1]
    ]
    mirrored = Knowledge(triples)
    assert mirrored.features == fleet.knowledge.features
    assert mirrored.sorts == fleet.knowledge.sorts
    for sort in mirrored.sorts:
        assert mirrored.instances(sort) == fleet.knowledge.instances(sort)


def test_the_store_returns_the_solutions_of_the_query(tmp_path: Path, ontologies: Path) -> None:
    with Ontology(tmp_path / 'store') as ontology:
        ontology.load(ontologies / 'fleet.owl')
        ontology.load(ontologies / 'harbour.ttl')
        asked = Counter(ontology.query(ALL_TRIPLES)[1])
    store = Store(tmp_path / 'store')
    assert Counter(store.triples()) == asked
    store.close()


def test_a_store_survives(tmp_path: Path, ontologies: Path) -> None:
    store = tmp_path / 'store.sqlite'
    with Ontology(store) as ontology:
        ontology.load(ontologies / 'fleet.owl')
        ontology.create_concept('Glider', ['UAV'])
        ontology.create_instance('uav3', ['Glider'])
        with pytest.raises(SemanticsError):
            ontology.create_concept('Weight', ['Feature'])
        before = snapshot(ontology)
    with Ontology(store) as ontology:
        assert {row for row in snapshot(ontology) ^ before if not row[0].startswith('-')} == set()
        assert ontology.knowledge.instances('UAV') == ('uav1', 'uav2', 'uav3')
        assert ontology.knowledge.feature('Height').unit == 'm'
        ontology.load(ontologies / 'fleet.owl')
        ontology.destroy_instance('uav3')
        ontology.destroy_concept('Glider')
    with Ontology(store) as ontology:
        assert ontology.knowledge.instances('UAV') == ('uav1', 'uav2')
        assert 'Glider' not in ontology.knowledge.concept_names


def test_a_change_is_stored_before_the_method_returns(tmp_path: Path) -> None:
    store, copy = tmp_path / 'store', tmp_path / 'copy'
    with Ontology(store) as ontology:
        ontology.create_concept('Vehicle', ['Object'])
        copy.write_bytes(store.read_bytes())
    with Ontology(copy) as ontology:
        assert ontology.knowledge.subconcepts('Object') == ('Object', 'Vehicle')


def test_stores_that_cannot_be_opened(tmp_path: Path) -> None:
    (tmp_path / 'text').write_text('This is no store. ' * 100)
    for store in (tmp_path / 'text', tmp_path / 'no' / 'folder'):
        with pytest.raises(
            SemanticsError, match=f"cannot open the ontology store '{store}'"
        ) as error:
            Ontology(store)
        assert error.value.code is ExitCode.UNAVAILABLE


def test_a_store_that_is_in_use(tmp_path: Path) -> None:
    with (
        Ontology(tmp_path / 'store'),
        pytest.raises(SemanticsError, match='database is locked') as error,
    ):
        Ontology(tmp_path / 'store')
    assert error.value.code is ExitCode.UNAVAILABLE


def test_nothing_is_printed(fleet: Ontology, capfd: pytest.CaptureFixture[str]) -> None:
    fleet.create_concept('Glider', ['UAV', 'Observer', 'Vehicle'])
    fleet.create_instance('uav3', ['Glider', 'Camera', 'Object'])
    fleet.query('SELECT ?x { ?x a owl:Class }')
    fleet.destroy_instance('uav3')
    assert capfd.readouterr() == ('', '')


def test_ontologies_are_independent_of_each_other(fleet: Ontology) -> None:
    with Ontology() as other:
        other.create_concept('UAV', ['Object'])
        assert other.knowledge.subconcepts('UAV') == ('UAV',)
        assert other.knowledge.instances('UAV') == ()
        assert fleet.knowledge.instances('UAV') == ('uav1', 'uav2')
