"""Two robots whose ontologies share no name: the words of one find the streams of the other."""

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

from services import LATCHED, PACKAGES, Nodes

ONTOLOGY = """\
<http://example.org/{prefix}> <{rdf}type> <{owl}Ontology> .
<{here}{sort}> <{rdf}type> <{owl}Class> .
<{here}{sort}> <{rdfs}subClassOf> <{dyknow}Object> .
<{here}{feature}> <{rdf}type> <{owl}Class> .
<{here}{feature}> <{rdfs}subClassOf> <{dyknow}Feature> .
<{here}{feature}> <{dyknow}argument1> <{here}{sort}> .
<{here}{feature}> <{dyknow}value_type> "float" .
<{here}{feature}> <{dyknow}unit> "{unit}" .
<{here}{name}> <{rdf}type> <{owl}NamedIndividual> .
<{here}{name}> <{rdf}type> <{here}{sort}> .
"""
WORDS = {
    'rdf': 'http://www.w3.org/1999/02/22-rdf-syntax-ns#',
    'rdfs': 'http://www.w3.org/2000/01/rdf-schema#',
    'owl': 'http://www.w3.org/2002/07/owl#',
    'dyknow': 'http://www.dyknow.org/ontology#',
}
FIRST = {'prefix': 'uav', 'sort': 'UAV', 'feature': 'Altitude', 'name': 'uav2', 'unit': 'm'}
SECOND = {'prefix': 'robot2', 'sort': 'Drone', 'feature': 'height', 'name': 'self', 'unit': 'ft'}
BRIDGES = """
robot2:height equivalent uav:Altitude;
robot2:Drone into uav:UAV;
robot2:self same uav:uav2;
"""
SSL = 'stream "/robot2/height" contains height[self] = data;'


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """All nodes, and the height of the second robot, which is 1,000 ft."""
    folder = tmp_path_factory.mktemp('robots')
    for robot in (FIRST, SECOND):
        here = f'http://example.org/{robot["prefix"]}#'
        text = ONTOLOGY.format(here=here, **robot, **WORDS)
        (folder / f'{robot["prefix"]}.nt').write_text(text)
    with Nodes(folder, **_parameters(folder)) as nodes:
        node = nodes.client.node
        heights = node.create_publisher(Float64, '/robot2/height', 10)
        node.create_timer(0.02, lambda: heights.publish(Float64(data=1000.0)))
        said = nodes.collect(DiagnosticStatus, '/stream_reasoning_coordinator/status', LATCHED)
        nodes.client.spin_until(
            lambda: any(each.message == 'running' for each in said), 'the coordinator runs'
        )
        yield nodes


def _parameters(folder: Path) -> dict[str, dict[str, Any]]:
    (folder / 'robots.bridges').write_text(BRIDGES)
    (folder / 'robot2.ssl').write_text(SSL)
    parameters: dict[str, dict[str, Any]] = {executable: {} for executable in PACKAGES}
    files = [str(folder / f'{robot["prefix"]}.nt') for robot in (FIRST, SECOND)]
    parameters['ontology_manager'] = {'ontologies': files}
    parameters['stream_semantics_manager'] = {'annotations': [str(folder / 'robot2.ssl')]}
    parameters['semantic_matching_engine'] = {'bridges': [str(folder / 'robots.bridges')]}
    return parameters


def evaluate(nodes: Nodes, formula: str) -> Any:
    return nodes.call(
        'stream_reasoning_coordinator',
        srv.EvaluateFormula,
        formula=formula,
        timeout=Duration(sec=10),
    )


def test_a_formula_of_one_robot_is_evaluated_over_streams_of_the_other(nodes: Nodes) -> None:
    answer = evaluate(nodes, 'forall u in UAV: always[0 s, 0.2 s] Altitude[u] > 304.7')
    assert answer.exit_status.code == ExitStatus.SUCCESS, answer.exit_status.message
    assert answer.verdict == FormulaResult.TRUE


def test_the_explanation_speaks_as_the_one_who_asks(nodes: Nodes) -> None:
    answer = evaluate(nodes, 'forall u in UAV: always Altitude[u] < 304.7')
    assert answer.verdict == FormulaResult.FALSE, answer
    assert 'Altitude[uav2] = 304.8' in answer.explanation
    assert 'height' not in answer.explanation


def test_each_robot_has_its_own_words(nodes: Nodes) -> None:
    answer = evaluate(nodes, 'forall d in Drone: eventually height[d] = 1000')
    assert answer.verdict == FormulaResult.TRUE, answer
