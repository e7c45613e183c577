"""Changes that the semantic nodes have confirmed survive their sudden death."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from dyknow_interfaces import srv
from dyknow_interfaces.msg import ExitStatus

from dyknow_bringup.resources import share
from services import Nodes, assert_refused

ONTOLOGY = 'ontology_manager'
SEMANTICS = 'stream_semantics_manager'


def instances(nodes: Nodes) -> list[str]:
    """The UAVs that the ontology knows."""
    answer = nodes.obtain(ONTOLOGY, srv.ConceptGetInstances, concept_name='UAV')
    return list(answer.instances)


def annotations(nodes: Nodes) -> list[str]:
    """The annotations that there are."""
    return list(nodes.obtain(SEMANTICS, srv.ListSemanticSpecifications).ssl_statements)


def written_until_killed(
    nodes: Nodes, node: str, requests: list[tuple[Any, dict[str, str]]], answers: int
) -> list[int]:
    """The requests, sent all at once, that a node has answered before it was killed.

    Args:
        nodes: the nodes.
        node: the one to ask and to kill.
        requests: the types of the services and what they are asked.
        answers: after how many the node is killed.
    """
    futures = [nodes.request(node, service, **fields) for service, fields in requests]
    nodes.client.spin_until(
        lambda: sum(future.done() for future in futures) >= answers, 'some answers'
    )
    nodes.kill(node)
    done = [number for number, future in enumerate(futures) if future.done()]
    for number in done:
        status = futures[number].result().exit_status
        assert status.code == ExitStatus.SUCCESS, status
    assert len(done) < len(futures), 'it was killed too late to tell'
    return done


@pytest.mark.parametrize('answers', [1, 7])
def test_no_answered_change_of_the_ontology_is_lost(tmp_path: Path, answers: int) -> None:
    parameters = {'store': str(tmp_path / 'ontology.sqlite')}
    requests: list[tuple[Any, dict[str, Any]]] = [
        (srv.InstanceCreate, {'instance_name': f'uav{number}', 'concept_names': ['UAV']})
        for number in range(1000, 1200)
    ]
    with Nodes(tmp_path, **{ONTOLOGY: parameters}) as nodes:
        nodes.obtain(ONTOLOGY, srv.OntologyLoad, path_or_iri=str(share() / 'ontology' / 'uav.owl'))
        nodes.obtain(ONTOLOGY, srv.ConceptCreate, concept_name='Kite', parent_concepts=['UAV'])
        done = written_until_killed(nodes, ONTOLOGY, requests, answers)
    with Nodes(tmp_path, **{ONTOLOGY: parameters}) as nodes:
        # More may have been written, but not answered.
        assert set(instances(nodes)) >= {f'uav{1000 + number}' for number in done}
        nodes.obtain(ONTOLOGY, srv.ConceptDestroy, concept_name='Kite')
        nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='last', concept_names=['UAV'])


@pytest.mark.parametrize('answers', [1, 30])
def test_no_answered_annotation_is_lost(tmp_path: Path, answers: int) -> None:
    executables: dict[str, dict[str, Any]] = {
        ONTOLOGY: {
            'ontologies': [str(share() / 'ontology' / 'uav.owl')],
            'store': str(tmp_path / 'ontology.sqlite'),
        },
        SEMANTICS: {'store': str(tmp_path / 'annotations.sqlite')},
    }
    texts = [f'stream s{number} contains Power[kite] = w{number};' for number in range(300)]
    with Nodes(tmp_path, **executables) as nodes:
        nodes.obtain(ONTOLOGY, srv.InstanceCreate, instance_name='kite', concept_names=['UAV'])
        requests: list[tuple[Any, dict[str, str]]] = [
            (srv.AddSemanticSpecification, {'ssl_statement': text}) for text in texts
        ]
        done = written_until_killed(nodes, SEMANTICS, requests, answers)
    with Nodes(tmp_path, **executables) as nodes:
        kept = annotations(nodes)
        assert set(kept) >= {texts[number] for number in done}
        text = texts[done[0]]
        answer = nodes.call(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
        assert_refused(answer.exit_status, ExitStatus.ALREADY_EXISTS, text)
        nodes.obtain(SEMANTICS, srv.RemoveSemanticSpecification, stream_name=f's{done[0]}')
        nodes.obtain(SEMANTICS, srv.AddSemanticSpecification, ssl_statement=text)
        assert sorted(annotations(nodes)) == sorted(kept)
