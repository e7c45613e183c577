"""Robots with an ontology each: the words of one find the objects and streams of the others."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus, FormulaResult
from std_msgs.msg import Float64

from evaluations import Monitored
from services import LATCHED, PACKAGES, Nodes

ONTOLOGY_MANAGER, INSTANCES = 'ontology_manager', srv.ConceptGetInstances
ONTOLOGY = """\
<http://example.org/{prefix}> <{rdf}type> <{owl}Ontology> .
<{here}{sort}> <{rdf}type> <{owl}Class> .
<{here}{sort}> <{rdfs}subClassOf> <{dyknow}Object> .
<{here}{feature}> <{rdf}type> <{owl}Class> .
<{here}{feature}> <{rdfs}subClassOf> <{dyknow}Feature> .
<{here}{feature}> <{dyknow}argument1> <{here}{sort}> .
<{here}{feature}> <{dyknow}value_type> "float" .
<{here}{feature}> <{dyknow}unit> "{unit}" .
"""
INDIVIDUAL = """\
<{here}{name}> <{rdf}type> <{owl}NamedIndividual> .
<{here}{name}> <{rdf}type> <{here}{sort}> .
"""
BRIDGE = '<http://example.org/{}> <{dyknow}into> <http://example.org/{}> .\n'
WORDS = {
    'rdf': 'http://www.w3.org/1999/02/22-rdf-syntax-ns#',
    'rdfs': 'http://www.w3.org/2000/01/rdf-schema#',
    'owl': 'http://www.w3.org/2002/07/owl#',
    'dyknow': 'http://www.dyknow.org/ontology#',
}
FIRST = {'prefix': 'uav', 'sort': 'UAV', 'feature': 'Altitude', 'unit': 'm'}
SECOND = {'prefix': 'robot2', 'sort': 'Drone', 'feature': 'height', 'unit': 'ft'}
THIRD = {'prefix': 'robot3', 'sort': 'Kopter', 'feature': 'Hoehe', 'unit': 'm'}
OBJECTS = {'uav': ('uav2', 'scout'), 'robot2': ('self', 'scout'), 'robot3': ('kopter',)}
BRIDGES = """
robot2:height equivalent uav:Altitude;
robot2:Drone into uav:UAV;
robot2:self same uav:uav2;
"""
# A busy machine delivers late.
TIMING = 'with max_delay = 5 s'
SSL = f"""
stream "/robot2/height" contains height[self] = data {TIMING};
stream "/robot2/scout/height" contains height[robot2:scout] = data {TIMING};
stream "/scout/altitude" contains Altitude[uav:scout] = data {TIMING}
"""
DATA = {'/robot2/height': 1000.0, '/robot2/scout/height': 500.0, '/scout/altitude': 10.0}


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """All nodes, and the heights of the robots."""
    folder = tmp_path_factory.mktemp('robots')
    for robot in (FIRST, SECOND):
        (folder / f'{robot["prefix"]}.nt').write_text(ontology_of(robot))
    with Nodes(folder, **_parameters(folder)) as nodes:
        node = nodes.client.node
        topics = (*DATA, '/robot3/hoehe')
        publishers = {topic: node.create_publisher(Float64, topic, 10) for topic in topics}

        def publish() -> None:
            for topic, value in DATA.items():
                publishers[topic].publish(Float64(data=value))

        node.create_timer(0.02, publish)
        said = nodes.collect(DiagnosticStatus, '/stream_reasoning_coordinator/_status', LATCHED)
        nodes.client.spin_until(
            lambda: any(each.message == 'running' for each in said), 'the coordinator runs'
        )
        yield nodes


def ontology_of(robot: dict[str, str]) -> str:
    words = {'here': f'http://example.org/{robot["prefix"]}#', **robot, **WORDS}
    objects = (INDIVIDUAL.format(name=each, **words) for each in OBJECTS[robot['prefix']])
    return ONTOLOGY.format(**words) + ''.join(objects)


def _parameters(folder: Path) -> dict[str, dict[str, Any]]:
    (folder / 'robots.bridges').write_text(BRIDGES)
    (folder / 'robot2.ssl').write_text(SSL)
    parameters: dict[str, dict[str, Any]] = {executable: {} for executable in PACKAGES}
    files = [str(folder / f'{robot["prefix"]}.nt') for robot in (FIRST, SECOND)]
    bridges = [str(folder / 'robots.bridges')]
    parameters['ontology_manager'] = {'ontologies': files, 'bridges': bridges}
    parameters['stream_semantics_manager'] = {'annotations': [str(folder / 'robot2.ssl')]}
    return parameters


def evaluate(nodes: Nodes, formula: str) -> Any:
    return nodes.call(
        'stream_reasoning_coordinator',
        srv.EvaluateFormula,
        formula=formula,
        timeout=Duration(sec=10),
    )


def test_a_formula_of_one_robot_is_evaluated_over_streams_of_the_other(nodes: Nodes) -> None:
    formula = 'forall u in UAV: always[0 s, 0.2 s] (Altitude[u] < 20 or Altitude[u] > 150)'
    answer = evaluate(nodes, formula)
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    assert answer.verdict == FormulaResult.TRUE
    objects = ['robot2:scout', 'uav2', 'uav:scout']
    assert nodes.obtain(ONTOLOGY_MANAGER, INSTANCES, concept_name='UAV').instances == objects
    assert sorted(each.symbol for each in answer.groundings) == [
        f'Altitude[{each}]' for each in objects
    ]


def test_the_explanation_speaks_as_the_one_who_asks(nodes: Nodes) -> None:
    answer = evaluate(nodes, 'forall u in UAV: always Altitude[u] < 304.7')
    assert answer.verdict == FormulaResult.FALSE, answer
    assert 'Altitude[uav2] = 304.8' in answer.explanation
    assert 'height' not in answer.explanation


def test_each_robot_has_its_own_words(nodes: Nodes) -> None:
    answer = evaluate(nodes, 'forall d in Drone: eventually height[d] = 1000 or height[d] = 500')
    assert answer.verdict == FormulaResult.TRUE, answer
    assert {each.symbol for each in answer.groundings} == {'height[robot2:scout]', 'height[self]'}


def test_an_object_of_another_ontology_breaks_a_limit(nodes: Nodes) -> None:
    answer = evaluate(nodes, 'forall u in UAV: Altitude[u] < 20 or always Altitude[u] > 160')
    assert answer.verdict == FormulaResult.FALSE, answer
    assert 'Altitude[robot2:scout] = 152.4' in answer.explanation


def test_a_bridge_is_added_while_a_formula_runs(nodes: Nodes) -> None:
    formula = 'forall u in UAV: always Altitude[u] < 1000'
    following = Monitored(nodes.client, formula, restart_on_change=True)
    nodes.client.spin_until(lambda: following.feedback[-1:], 'states')
    links = ''.join(
        BRIDGE.format(f'robot3#{source}', f'uav#{target}', **WORDS)
        for source, target in (('Kopter', 'UAV'), ('Hoehe', 'Altitude'))
    )
    nodes.obtain(ONTOLOGY_MANAGER, srv.OntologyLoad, content=ontology_of(THIRD) + links)
    said = lambda word: any(word in each for each in following.events)  # noqa: E731
    nodes.client.spin_until(
        lambda: said('Altitude[kopter]'), 'the object has no stream', instead=following.told
    )
    DATA['/robot3/hoehe'] = 2000.0
    statement = 'stream "/robot3/hoehe" contains Hoehe[kopter] = data ' + TIMING
    nodes.obtain('stream_semantics_manager', srv.AddSemanticSpecification, ssl_statement=statement)
    result = following.result()
    assert result.verdict == FormulaResult.FALSE, result
    assert 'Altitude[kopter] = 2000' in result.explanation
    assert said('restarted with UAV: kopter')
