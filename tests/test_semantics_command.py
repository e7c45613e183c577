"""The semantics command, as people run it."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from dyknow_interfaces import srv

from commands import command, output_of
from dyknow_bringup.resources import share
from services import Nodes

ONTOLOGY = 'ontology_manager'
SEMANTICS = 'stream_semantics_manager'


@pytest.fixture(scope='module')
def nodes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """An ontology with one vehicle, and a stream of its power."""
    with Nodes(
        tmp_path_factory.mktemp('semantics'),
        ontology_manager={'ontologies': [str(share() / 'ontology' / 'uav.owl')]},
        stream_semantics_manager={},
    ) as nodes:
        nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='uav1', concept_names=['UAV'])
        ssl = 'stream uav1_power contains Power[uav1] = power [kW];'
        nodes.obtain(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=ssl)
        yield nodes


def semantics(nodes: Nodes, *arguments: str) -> Any:
    return output_of(command('semantics', *arguments), nodes.environment)


def test_the_hierarchies(nodes: Nodes) -> None:
    shown = semantics(nodes)
    assert shown.returncode == 0, shown.stderr
    assert 'uav1_power carries Power[uav1]' in shown.stdout
    assert '(no stream)' in shown.stdout
    concepts = {
        each['name']: each for each in json.loads(semantics(nodes, '--json').stdout)['concepts']
    }
    assert concepts['Power']['streams'] == ['uav1_power carries Power[uav1]']
    assert not concepts['Altitude']['is_provided']


def test_why_a_stream_matches(nodes: Nodes) -> None:
    shown = semantics(nodes, '--explain', 'Power[u] for every u in UAV', '--json')
    assert shown.returncode == 0, shown.stderr
    (found,) = json.loads(shown.stdout)
    assert found['matches']
    assert found['reason'] == 'exact match: uav1_power carries Power[uav1]; kW is converted to W'


def test_a_concept_that_is_unknown(nodes: Nodes) -> None:
    shown = semantics(nodes, '--explain', 'Powr')
    assert shown.returncode == 2
    assert "unknown concept 'Powr'" in shown.stderr


def test_a_node_that_is_not_there(nodes: Nodes) -> None:
    shown = semantics(nodes, '--ontology-manager', 'nobody', '--timeout', '0.5 s')
    assert shown.returncode == 2
    assert '/nobody' in shown.stderr
